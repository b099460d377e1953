"""A contact law: a linear spring and dashpot, and friction that grows with the sliding velocity.

F_n = max(k_n delta - gamma_n v_n, 0); F_t = -gamma_t v_t, at most mu F_n. There is no friction spring.
"""

import math
from typing import ClassVar, Literal, Self

from labbook_dem.coefficients import C_N, MU, MU_R, OWN, row
from labbook_dem.contact import cut
from labbook_dem.words import coefs, func, real, sqrt, vec3

from labbook.scene import Surface, damping
from labbook.scene.contact import ContactLaw
from labbook.scene.quantities import Coefficient, Stiffness


class Viscous(ContactLaw):
    """The law as studies state it: its keys with their units, and what follows from them."""

    physics: ClassVar[str] = __name__  # the module of the formulas: this one
    usual_step: ClassVar[str] = "0.02 collision"
    honours: ClassVar[frozenset[str]] = frozenset({"friction", "rolling_friction", "restitution"})
    source: ClassVar[str] = ""  # the publication of the law, for `labbook cite`

    law: Literal["viscous"] = "viscous"
    normal_stiffness: Stiffness
    """Normal stiffness k_n."""
    tangential_damping: Coefficient = 1.0
    """Ratio γ_t/γ_n of tangential to normal damping."""

    def stiffened(self, factor: float) -> Self:
        """The law with `factor` times the stiffness."""
        return self.model_copy(update={"normal_stiffness": self.normal_stiffness * factor})

    def damping_ratio(self, restitution: float) -> float:
        """gamma_n/(2 sqrt(k_n m*)) that gives `restitution` if the normal force never pulls."""
        return damping.linear_ratio(restitution)

    def collision_time(self, mass: float, radius: float, speed: float) -> float:
        """pi sqrt(m*/k_n) [s], at any speed."""
        return math.pi * math.sqrt(mass / self.normal_stiffness)

    def stability(self, rods: bool) -> tuple[float, float]:
        """A and B as for the law `linear`, without its friction spring."""
        return 1.8, (6.5 if rods else 5.7) * max(1.0, self.tangential_damping)


K_N, GAMMA_RATIO = OWN[:2]
"""k_n [N/m]; gamma_t/gamma_n."""


def coefficients(law: Viscous, surface: Surface, stiffness_scale: float = 1.0, wall: bool = False) -> coefs:
    """The numbers that the formulas take, for contacts with this surface."""
    return row(
        {
            K_N: law.normal_stiffness * stiffness_scale,
            C_N: 2 * law.damping_ratio(surface.restitution),
            GAMMA_RATIO: law.tangential_damping,
            MU: surface.friction,
            MU_R: surface.rolling_friction,
        }
    )


@func
def respond(c: coefs, rs: real, ms: real, delta: real, vn: real, s: vec3, vt: vec3):
    """Normal force [N], tangential force [N] and friction spring [m]; see `labbook_dem.laws`."""
    gamma = c[C_N] * sqrt(c[K_N] * ms)
    fn = max(c[K_N] * delta - gamma * vn, real(0.0))
    ft = cut(-(vt * (c[GAMMA_RATIO] * gamma)), c[MU] * fn)
    return fn, ft, s * real(0.0)


@func
def normal(c: coefs, rs: real, ms: real, delta: real, vn: real):
    """Normal force [N] alone, for contacts without friction."""
    gamma = c[C_N] * sqrt(c[K_N] * ms)
    return max(c[K_N] * delta - gamma * vn, real(0.0))
