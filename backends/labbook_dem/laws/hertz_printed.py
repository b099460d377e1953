"""Hertz and Mindlin as printed (Fan et al. 2023, eqs 6 and 7): nothing is cut.

In the words of `hertz_mindlin`: F_t^e = K_t s' (1 + u + u^2)/(1 + u^{3/2}), where s' is the spring s shortened to
delta_max and u = 1 - |s'|/delta_max; F_t^v = C_t sqrt(6 m* K_t sqrt(u)) v_t. The spring itself is kept whole.
"""

from labbook_dem.contact import length
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
    short = (s_max / size) if size > s_max else one
    root = sqrt(u)
    k_t = stiff_t * short * (one + u + u * u) / (one + u * root)
    damp_t = c[2] * sqrt(six * ms * stiff_t * root)
    ft = -(s * k_t) - vt * damp_t
    return fn, ft, s
