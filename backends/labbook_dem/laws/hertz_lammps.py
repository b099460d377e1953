"""Hertz with the friction of LAMMPS: `pair_style granular`, `hertz/material` with `tangential mindlin`.

As its source has it (pair_granular.cpp, January 2022): k_t = 8 G* sqrt(R* delta), which is 3/2 K/kappa in the words of
`hertz_mindlin`; gamma_t is a multiple of the normal dashpot, x_t C_n sqrt(6 m* K). Where |k_t s + gamma_t v_t| exceeds
mu |F_n| it is cut to that, and the spring becomes what then is left of it: -(F_t + gamma_t v_t)/k_t.
"""

from labbook_dem.coefficients import MU
from labbook_dem.contact import cut, length
from labbook_dem.laws import hertz as shared
from labbook_dem.laws.hertz import C_T, coefficients, hertz, normal, without_slip
from labbook_dem.words import coefs, func, real, vec3

__all__ = ["coefficients", "normal", "respond"]

NEEDS = (shared,)


@func
def respond(c: coefs, rs: real, ms: real, delta: real, vn: real, s: vec3, vt: vec3):
    """Normal force, tangential force on i and the spring; see `labbook_dem.laws`."""
    unity = real(1.0)
    fn, stiff, root = hertz(c, rs, ms, delta, vn)
    k_t = without_slip(c, stiff)
    drag = vt * (c[C_T] * root)
    ft = -(s * k_t) - drag
    limit = c[MU] * abs(fn)
    slides = length(ft) > limit
    ft = cut(ft, limit)
    # only where it slides: without a cut the spring keeps its bits
    spring = ((ft + drag) * (-(unity / k_t))) if slides else s
    return fn, ft, spring
