"""Linear springs and dashpots (Pongo et al. 2022; Cundall & Strack 1979).

F_n = k_n delta - gamma_n v_n, never attractive; F_t = -k_t s - gamma_t v_t with |F_t| <= mu F_n, and when the limit is
hit the spring is shortened so that the total tangential force equals mu F_n. gamma_n = C_n sqrt(k_n m*), where C_n is
twice the damping ratio; gamma_t is a multiple of gamma_n.
"""

import math

from labbook.scene import LinearSpringDashpot, Surface
from labbook_dem.coefficients import C_N, MU, MU_R, OWN, row
from labbook_dem.contact import cut
from labbook_dem.words import coefs, func, real, sqrt, vec3

K_N, GAMMA_RATIO, K_RATIO = OWN[:3]
"""k_n [N/m]; gamma_t / gamma_n; k_t / k_n."""


def coefficients(
    law: LinearSpringDashpot, surface: Surface, stiffness_scale: float = 1.0, wall: bool = False
) -> coefs:  # fmt: skip
    """Coefficients of a contact with this surface.

    Args:
        law: contact law of the scene.
        surface: friction and restitution.
        stiffness_scale: factor of the stiffness.
        wall: the contact is with a wall, whose m* is twice that of two grains.
    """
    ratio = law.damping_ratio(surface.restitution)
    if wall and law.damping == "printed":
        ratio /= math.sqrt(2)  # the same gamma_n as between grains
    return row(
        {
            K_N: law.normal_stiffness * stiffness_scale,
            C_N: 2 * ratio,
            GAMMA_RATIO: law.tangential_damping,
            K_RATIO: law.tangential_stiffness,
            MU: surface.friction,
            MU_R: surface.rolling_friction,
        }
    )


@func
def respond(c: coefs, rs: real, ms: real, delta: real, vn: real, s: vec3, vt: vec3):
    """Normal force, tangential force on i and the spring; see `labbook_dem.laws`."""
    unity = real(1.0)
    gamma = c[C_N] * sqrt(c[K_N] * ms)
    fn = max(c[K_N] * delta - gamma * vn, real(0.0))
    k_t = c[K_RATIO] * c[K_N]
    gamma_t = c[GAMMA_RATIO] * gamma
    drag = vt * gamma_t
    ft = -(s * k_t) - drag
    ft = cut(ft, c[MU] * fn)
    # the spring that gives the cut force; without a cut it is s up to rounding
    spring = (ft + drag) * (-(unity / k_t))
    return fn, ft, spring


@func
def normal(c: coefs, rs: real, ms: real, delta: real, vn: real):
    """Normal force alone, for contacts without friction."""
    gamma = c[C_N] * sqrt(c[K_N] * ms)
    return max(c[K_N] * delta - gamma * vn, real(0.0))
