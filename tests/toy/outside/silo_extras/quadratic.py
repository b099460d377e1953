"""A contact law: springs whose force grows with the square of the overlap, and sliding friction without a spring."""

import math
from typing import ClassVar, Literal, Self

from labbook_dem.coefficients import MU, MU_R, OWN, row
from labbook_dem.words import coefs, dot, func, real, sqrt, vec3

from labbook.scene import Surface
from labbook.scene.contact import ContactLaw
from labbook.scene.quantities import Pressure

K = OWN[0]
"""k [Pa]."""


class Quadratic(ContactLaw):
    """F_n = k delta^2, without a dashpot: grains bounce back as fast as they came."""

    physics: ClassVar[str] = __name__
    usual_step: ClassVar[str] = "0.02 collision"
    honours: ClassVar[frozenset[str]] = frozenset({"friction", "rolling_friction"})

    law: Literal["quadratic"] = "quadratic"
    stiffness: Pressure
    """k in F_n = k delta^2."""

    def stiffened(self, factor: float) -> Self:
        """The law with `factor` times the stiffness."""
        return self.model_copy(update={"stiffness": self.stiffness * factor})

    def damping_ratio(self, restitution: float) -> float:
        """None."""
        return 0.0

    def collision_time(self, mass: float, radius: float, speed: float) -> float:
        """2 x/v times the integral of du/sqrt(1 - u^3) from 0 to 1, x = (3 m v^2/(2 k))^{1/3} the largest overlap."""
        deepest = (1.5 * mass * speed**2 / self.stiffness) ** (1 / 3)
        integral = math.gamma(1 / 3) * math.gamma(1 / 2) / math.gamma(5 / 6) / 3
        return 2 * deepest / speed * integral

    def stability(self, rods: bool) -> tuple[float, float]:
        """Of beds that nobody has measured: those of a linear spring."""
        return 1.8, 0.0


def coefficients(law: Quadratic, surface: Surface, stiffness_scale: float = 1.0, wall: bool = False) -> coefs:
    """Coefficients of a contact with this surface."""
    return row({K: law.stiffness * stiffness_scale, MU: surface.friction, MU_R: surface.rolling_friction})


@func
def respond(c: coefs, rs: real, ms: real, delta: real, vn: real, s: vec3, vt: vec3):
    """Normal force, tangential force on i and the spring; see `labbook_dem.laws`."""
    zero = real(0.0)
    fn = c[K] * delta * delta
    speed = sqrt(dot(vt, vt))
    drag = c[MU] * fn / speed if speed > zero else zero
    return fn, -(vt * drag), s * zero


@func
def normal(c: coefs, rs: real, ms: real, delta: real, vn: real):
    """Normal force alone, for contacts without friction."""
    return c[K] * delta * delta
