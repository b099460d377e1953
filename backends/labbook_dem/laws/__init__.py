"""Contact laws, one a module, each with the same two faces.

`respond(c, rs, ms, delta, vn, s, vt) -> (fn, ft, s)` is compiled by backends: coefficients c, effective radius rs [m]
and mass ms [kg], overlap delta [m], approach velocity vn [m/s] along n (negative when approaching), trial friction
spring s [m] in the contact plane and tangential velocity vt [m/s]; it gives the normal force [N], the tangential force
on i [N] and the spring as it may stay. `normal` is the normal force alone. `coefficients(law, surface, scale, wall)` is
the host's: the eight numbers c; friction is c[4] and rolling friction c[5] in every law.
"""

from labbook_dem.laws import hertz_mindlin, linear

LAWS = {"hertz-mindlin": hertz_mindlin, "linear": linear}
