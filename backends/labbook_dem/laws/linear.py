"""Linear springs and dashpots (Pongo et al. 2022; Cundall & Strack 1979).

F_n = k_n delta - gamma_n v_n, never attractive; F_t = -k_t s - gamma_t v_t with |F_t| <= mu F_n, and when the limit is
hit the spring is shortened so that the total tangential force equals mu F_n. gamma_n = c sqrt(k_n m*), where c is twice
the damping ratio; gamma_t is a multiple of gamma_n.
"""

import math

from labbook.scene import LinearSpringDashpot, Surface
from labbook_dem.contact import cut
from labbook_dem.words import coefs, func, real, sqrt, vec3


def coefficients(
    law: LinearSpringDashpot, surface: Surface, stiffness_scale: float = 1.0, wall: bool = False
) -> coefs:  # fmt: skip
    """k_n [N/m], gamma_n / sqrt(k_n m*), gamma_t / gamma_n, k_t / k_n, mu, mu_r.

    wall: whether it is of a grain and a wall, whose m* is twice that of two grains.
    """
    ratio = law.damping_ratio(surface.restitution)
    if wall and law.damping == "printed":
        ratio /= math.sqrt(2)  # the same gamma_n as between grains
    k_n = law.normal_stiffness * stiffness_scale
    return (
        k_n, 2 * ratio, law.tangential_damping, law.tangential_stiffness, surface.friction, surface.rolling_friction,
        0.0, 0.0,
    )  # fmt: skip


@func
def respond(c: coefs, rs: real, ms: real, delta: real, vn: real, s: vec3, vt: vec3):
    """Normal force, tangential force on i and the spring; see `labbook_dem.laws`."""
    one = real(1.0)
    gamma = c[1] * sqrt(c[0] * ms)
    fn = max(c[0] * delta - gamma * vn, real(0.0))
    k_t = c[3] * c[0]
    gamma_t = c[2] * gamma
    drag = vt * gamma_t
    ft = -(s * k_t) - drag
    ft = cut(ft, c[4] * fn)
    kept = (ft + drag) * (-(one / k_t))
    return fn, ft, kept


@func
def normal(c: coefs, rs: real, ms: real, delta: real, vn: real):
    """Normal force alone, for contacts without friction."""
    gamma = c[1] * sqrt(c[0] * ms)
    return max(c[0] * delta - gamma * vn, real(0.0))
