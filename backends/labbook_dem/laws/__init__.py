"""Contact laws, one a module, each with the same two faces.

`respond(c, rs, ms, delta, vn, s, vt) -> (fn, ft, s)` is compiled by engines: coefficients c, effective radius rs [m]
and mass ms [kg], overlap delta [m], approach velocity vn [m/s] along n (negative when approaching), trial friction
spring s [m] in the contact plane and tangential velocity vt [m/s]; it gives the normal force [N], the tangential
force on i [N] and the spring as it may stay. `coefficients(law, surface, ...)` is the host's: the eight numbers c.
c[MU] and c[MU_ROLL] have the same place in every law.
"""
