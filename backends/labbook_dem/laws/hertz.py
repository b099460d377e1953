"""What the laws after Hertz share: F_n = K delta - C_n sqrt(6 m* K) v_n with K = (4/3) E* sqrt(R* delta).

No law by itself: they differ in friction, and name this module in NEEDS.
"""

from labbook.scene import Surface
from labbook.scene.contact import Hertz
from labbook_dem.words import coefs, func, real, sqrt


def coefficients(
    law: Hertz, surface: Surface, stiffness_scale: float = 1.0, wall: bool = False
) -> coefs:  # fmt: skip
    """(4/3) E* [Pa], C_n, C_t, kappa, mu, mu_r of a contact between equal materials with this surface; and the least
    normal force [N]: 0, or next to minus infinity where it may pull.

    wall: whether it is of a grain and a wall; Hertz's laws have the same coefficients for both.
    """
    nu = law.poisson_ratio
    c_n = law.damping_ratio(surface.restitution)
    modulus = 4 / 3 * law.effective_modulus * stiffness_scale
    kappa = (2 - nu) / (2 * (1 - nu))
    least = -1e30 if law.pulls else 0.0
    return (
        modulus, c_n, law.tangential_damping * c_n, kappa, surface.friction, surface.rolling_friction, least, 0.0,
    )  # fmt: skip


@func
def hertz(c: coefs, rs: real, ms: real, delta: real, vn: real):
    """Normal force, K [N/m] and sqrt(6 m* K) [kg/s]."""
    stiff = c[0] * sqrt(rs * delta)
    root = sqrt(real(6.0) * ms * stiff)
    return max(stiff * delta - c[1] * root * vn, c[6]), stiff, root


@func
def normal(c: coefs, rs: real, ms: real, delta: real, vn: real):
    """Normal force alone, for contacts without friction."""
    fn, _, _ = hertz(c, rs, ms, delta, vn)
    return fn
