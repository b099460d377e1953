"""Formulas that the laws after Hertz share: the normal force and Mindlin's friction spring.

F_n = K delta - C_n sqrt(6 m* K) v_n with K = (4/3) E* sqrt(R* delta). This is not a law: the laws differ in friction,
and list this module in NEEDS.
"""

from labbook.scene import Surface
from labbook.scene.contact import Hertz
from labbook_dem.coefficients import C_N, MU, MU_R, OWN, row
from labbook_dem.words import coefs, func, real, sqrt, vec3

MODULUS, C_T, KAPPA, LEAST = OWN[:4]
"""(4/3) E* [Pa]; C_t; kappa; the smallest normal force [N], hugely negative if it may pull."""


def coefficients(
    law: Hertz, surface: Surface, stiffness_scale: float = 1.0, wall: bool = False
) -> coefs:  # fmt: skip
    """Coefficients of a contact between equal materials with this surface.

    Args:
        law: contact law of the scene.
        surface: friction and restitution.
        stiffness_scale: factor of the modulus.
        wall: the contact is with a wall; the laws of Hertz have the same coefficients for both.
    """
    nu = law.poisson_ratio
    c_n = law.damping_ratio(surface.restitution)
    return row(
        {
            MODULUS: 4 / 3 * law.effective_modulus * stiffness_scale,
            C_N: c_n,
            C_T: law.tangential_damping * c_n,
            KAPPA: (2 - nu) / (2 * (1 - nu)),
            MU: surface.friction,
            MU_R: surface.rolling_friction,
            LEAST: -1e30 if law.pulls else 0.0,
        }
    )


@func
def hertz(c: coefs, rs: real, ms: real, delta: real, vn: real):
    """Normal force, K [N/m] and sqrt(6 m* K) [kg/s]."""
    stiff = c[MODULUS] * sqrt(rs * delta)
    root = sqrt(real(6.0) * ms * stiff)
    return max(stiff * delta - c[C_N] * root * vn, c[LEAST]), stiff, root


@func
def normal(c: coefs, rs: real, ms: real, delta: real, vn: real):
    """Normal force alone, for contacts without friction."""
    fn, _, _ = hertz(c, rs, ms, delta, vn)
    return fn


@func
def unslid(size: real, s_max: real):
    """Elastic part u = 1 - |s|/s_max of a spring of this size [m]; 0 from s_max [m] on, where it slides."""
    slides = size >= s_max
    return real(0.0) if slides else max(real(1.0) - size / s_max, real(0.0))  # an approximate quotient may exceed one


@func
def mindlin(c: coefs, ms: real, stiff_t: real, stiff_s: real, u: real, s: vec3, vt: vec3):
    """Friction force [N] of Mindlin's spring and its dashpot, F_t^e + F_t^v of `hertz_mindlin`.

    stiff_t: K/kappa [N/m]; stiff_s: the same, or less if only a part of s [m] counts; u: from `unslid`; vt: tangential
    velocity [m/s].
    """
    unity = real(1.0)
    root = sqrt(u)
    k_t = stiff_s * (unity + u + u * u) / (unity + u * root)
    damp_t = c[C_T] * sqrt(real(6.0) * ms * stiff_t * root)
    return -(s * k_t) - vt * damp_t


@func
def without_slip(c: coefs, stiff: real):
    """Tangential stiffness 8 G* sqrt(R* delta) [N/m] of a contact without slip: 3/2 K/kappa."""
    return real(1.5) * stiff / c[KAPPA]
