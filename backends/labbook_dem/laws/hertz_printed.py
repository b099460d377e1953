"""Hertz and Mindlin as printed (Fan et al. 2023, eqs 6 and 7): nothing is cut.

In the words of `hertz_mindlin`: F_t^e = K_t s' (1 + u + u^2)/(1 + u^{3/2}), where s' is the spring s shortened to
delta_max and u = 1 - |s'|/delta_max; F_t^v = C_t sqrt(6 m* K_t sqrt(u)) v_t. The spring itself is kept whole.
"""

from labbook_dem.coefficients import MU
from labbook_dem.contact import length
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
    s_max = c[MU] * c[KAPPA] * delta
    size = length(s)
    u = unslid(size, s_max)
    short = (s_max / size) if size > s_max else real(1.0)
    return fn, mindlin(c, ms, stiff_t, stiff_t * short, u, s, vt), s
