"""Hertz with the friction of LIGGGHTS 3.8: `pair_style gran model hertz tangential history`.

As its source has it (normal_model_hertz.h, tangential_model_history.h): k_t = 8 G* sqrt(R* delta), which is
3/2 K/kappa in the words of `hertz_mindlin`; gamma_t = 2 sqrt(5/6) |beta| sqrt(k_t m*) = 2 C_n sqrt(k_t m*). Where
k_t |s| exceeds mu |F_n| the spring is cut to mu |F_n|/k_t and there is no dashpot; elsewhere
F_t = -k_t s - gamma_t v_t, which nothing limits.
"""

from labbook_dem.coefficients import MU
from labbook_dem.contact import length
from labbook_dem.laws import hertz as shared
from labbook_dem.laws.hertz import C_T, coefficients, hertz, normal, without_slip
from labbook_dem.words import coefs, func, real, sqrt, vec3

__all__ = ["coefficients", "normal", "respond"]

NEEDS = (shared,)


@func
def respond(c: coefs, rs: real, ms: real, delta: real, vn: real, s: vec3, vt: vec3):
    """Normal force, tangential force on i and the spring; see `labbook_dem.laws`."""
    zero = real(0.0)
    unity = real(1.0)
    fn, stiff, _ = hertz(c, rs, ms, delta, vn)
    k_t = without_slip(c, stiff)
    damp_t = real(2.0) * c[C_T] * sqrt(ms * k_t)
    pull = k_t * length(s)
    limit = c[MU] * abs(fn)
    slides = pull > limit
    s = s * ((limit / pull) if slides else unity)
    ft = -(s * k_t) - vt * (zero if slides else damp_t)
    return fn, ft, s
