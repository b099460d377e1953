"""Hertz normal force, Mindlin friction spring (Fan et al. 2023, eqs 6 and 7), with the total normal force as its limit.

With K = (4/3) E* sqrt(R* delta): F_n^e = K delta and F_n^v = C_n sqrt(6 m* K) v_n, F_n = F_n^e + F_n^v. With
kappa = (2 - nu)/(2 (1 - nu)), delta_max = mu kappa F_n/K, u = 1 - min(|s|, delta_max)/delta_max and K_t = K/kappa, eq 7
reads without cancellation or division by the spring: F_t^e = K_t s (1 + u + u^2)/(1 + u^{3/2}), which is
mu F_n (1 - u^{3/2}), and F_t^v = C_t sqrt(6 m* K_t sqrt(u)) v_t. The spring is cut at delta_max; then |F_t| <= mu F_n.
A contact that slides, |s| >= delta_max, so carries mu F_n, without a dashpot.

The stiffness at small |s| is that of the area of contact; what limits the force is Coulomb's friction (Mindlin and
Deresiewicz 1953). At rest F_n = F_n^e and delta_max = mu kappa delta, as Fan et al. print it. Version 1 of the law took
F_n^e in eq 7 and cut the sum at mu F_n: mu min(F_n^e, F_n) where a contact slides, less than Coulomb's friction while
grains approach. Its spring with mu F_n where it is cut would jump by mu F_n^v at the onset of sliding, and contacts of
inelastic grains would alternate between both forces.
"""

from labbook_dem.coefficients import MU
from labbook_dem.contact import cut, length
from labbook_dem.laws import hertz as shared
from labbook_dem.laws.hertz import KAPPA, coefficients, hertz, mindlin, normal, unslid
from labbook_dem.words import coefs, func, real, vec3

__all__ = ["coefficients", "normal", "respond"]

NEEDS = (shared,)


@func
def respond(c: coefs, rs: real, ms: real, delta: real, vn: real, s: vec3, vt: vec3):
    """Normal force, tangential force on i and the spring; see `labbook_dem.laws`."""
    fn, stiff, _ = hertz(c, rs, ms, delta, vn)
    stiff_t = stiff / c[KAPPA]
    limit = c[MU] * fn
    s_max = limit / stiff_t
    u = unslid(length(s), s_max)
    s = cut(s, s_max)
    ft = mindlin(c, ms, stiff_t, stiff_t, u, s, vt)
    return fn, cut(ft, limit), s
