"""Hertz normal force, Mindlin friction spring (Fan et al. 2023, eqs 6 and 7), Coulomb friction where a contact slides.

With K = (4/3) E* sqrt(R* delta): F_n^e = K delta and F_n^v = C_n sqrt(6 m* K) v_n. With kappa = (2 - nu)/(2 (1 - nu)),
delta_max = mu kappa delta, u = 1 - |s|/delta_max and K_t = K/kappa, a contact that sticks, |s| < delta_max, follows
eq 7, which without cancellation or division by the spring is F_t^e = K_t s (1 + u + u^2)/(1 + u^{3/2}) and
F_t^v = C_t sqrt(6 m* K_t sqrt(u)) v_t, together at most mu F_n. The spring is cut at delta_max. A contact whose spring
is cut slides: it has no dashpot, and friction is mu F_n along the spring, with the total normal force
F_n = F_n^e + F_n^v.

Friction so jumps by mu F_n^v where a contact begins to slide. Version 1 of the law had no jump: it kept
mu F_n^e, cut by mu F_n, which is mu min(F_n^e, F_n) and passes on less than Coulomb's friction while grains approach. A
limit without a jump would scale eq 7 by F_n/F_n^e; the stiffness of a sticking contact would then depend on the normal
velocity, and a spring loaded while grains part could be unloaded while they approach, which can give energy away.
"""

from labbook_dem.contact import cut, length
from labbook_dem.laws import hertz as shared
from labbook_dem.laws.hertz import coefficients, hertz, normal
from labbook_dem.words import coefs, func, real, sqrt, vec3

__all__ = ["coefficients", "normal", "respond"]

NEEDS = (shared,)


@func
def respond(c: coefs, rs: real, ms: real, delta: real, vn: real, s: vec3, vt: vec3):
    """Normal force, tangential force on i and the spring; see `labbook_dem.laws`."""
    zero = real(0.0)
    one = real(1.0)
    six = real(6.0)
    fn, stiff, _ = hertz(c, rs, ms, delta, vn)
    stiff_t = stiff / c[3]
    s_max = c[4] * c[3] * delta
    size = length(s)
    slides = size >= s_max
    u = zero if slides else max(one - size / s_max, zero)  # an approximate quotient may exceed one
    root = sqrt(u)
    limit = c[4] * fn
    k_t = (limit / size) if slides else stiff_t * (one + u + u * u) / (one + u * root)
    damp_t = c[2] * sqrt(six * ms * stiff_t * root)  # 0 of a contact that slides
    ft = -(s * k_t) - vt * damp_t
    return fn, cut(ft, limit), cut(s, s_max)
