"""Contact laws and the surfaces that they act between."""

import math
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, NamedTuple, Self

from pydantic import Field

from labbook.scene import damping
from labbook.scene.model import Choice, Model
from labbook.scene.quantities import Coefficient, Pressure, Ratio, Stiffness

Restitution = Annotated[Ratio, Field(gt=0, le=1)]
PoissonRatio = Annotated[Ratio, Field(gt=-1, le=0.5)]
Damping = Literal["clamped", "textbook", "printed"]
Rolling = Literal["full", "rolling"]


# The duration of an undamped collision by Hertz's law in units of (m_eff^2 / (R_eff E*^2 v))^{1/5}: twice the integral
# of dx / sqrt(1 - x^{5/2}) from 0 to 1, times (15/16)^{2/5}.
_HERTZ_DURATION = 0.8 * math.gamma(0.4) * math.gamma(0.5) / math.gamma(0.9) * (15 / 16) ** 0.4


class Surface(Model):
    """What decides a contact besides the law, of grains with one another or with a wall; nothing is left open."""

    friction: Coefficient
    """Coulomb coefficient μ."""
    rolling_friction: Coefficient
    """Rolling friction coefficient μ_r."""
    restitution: Restitution
    """Coefficient of normal restitution, in (0, 1]."""

    def changed(self, change: "SurfaceChange") -> "Surface":
        """This surface with the values that `change` gives in place of its own."""
        values = {key: getattr(change, key) for key in Surface.model_fields}
        return self.model_copy(update={key: value for key, value in values.items() if value is not None})


class SurfaceChange(Model):
    """Where a wall differs from the grains; what is not given is as between grains."""

    friction: Coefficient | None = None
    """Coulomb coefficient at this wall."""
    rolling_friction: Coefficient | None = None
    """μ_r at this wall."""
    restitution: Restitution | None = None
    """Coefficient of normal restitution at this wall, in (0, 1]."""


class Between(SurfaceChange):
    """Where contacts of two kinds of grains differ from all others; one kind twice: of its grains with each other."""

    kinds: tuple[str, str]
    """Names of the two kinds, of `grains.kinds`."""
    friction: Coefficient | None = None
    """Coulomb coefficient between these kinds, and, of one kind twice, of its grains at walls that state no other."""
    rolling_friction: Coefficient | None = None
    """μ_r between these kinds, and likewise at walls."""
    restitution: Restitution | None = None
    """Coefficient of normal restitution between these kinds, in (0, 1], and likewise at walls."""


class Softer(NamedTuple):
    """A stiffness that a bed asks for: its key in `contact`, its unit, its value there, and what would do."""

    key: str
    unit: str
    stated: float
    enough: float


class ContactLaw(Model, ABC):
    """What every contact law has: parameters, and what follows from them before anything moves."""

    physics: ClassVar[str]
    """The module of its formulas, as kernels take them; see `labbook_dem.laws`."""
    usual_step: ClassVar[str]
    """The time step where a study states none: a part of a time scale."""

    if TYPE_CHECKING:  # a field of each law, which stands in stored records where it always stood
        law: str
        """Its name."""
    friction: Coefficient = 0.0
    """Coulomb coefficient μ between grains, and at walls that state no other."""
    rolling_friction: Coefficient = 0.0
    """μ_r: the resisting torque is at most μ_r R F_n."""
    restitution: Restitution = 1.0
    """Coefficient of normal restitution e that is asked for, in (0, 1]."""
    damping: Damping = "clamped"
    """`clamped`: the damping is solved so that the never-attractive law gives back e; `textbook`: the papers'
    formula; `printed`: that with the damping of two grains at walls too, as Pongo et al. do (law linear)."""
    rolling: Rolling = "full"
    """`full`: rolling friction resists all relative rotation, twist too (Fan eq 8 taken literally);
    `rolling`: its tangential part only."""
    # where there are no kinds it is left out of what is stored and hashed
    between: Annotated[tuple[Between, ...], Field(exclude_if=lambda between: not between)] = ()
    """Pairs of kinds whose contacts differ; contacts of all others are as stated for the law."""

    @abstractmethod
    def stiffened(self, factor: float) -> Self:
        """The law with `factor` times the stiffness."""

    @abstractmethod
    def damping_ratio(self, restitution: float) -> float:
        """Normal dashpot of a contact over the critical one, for a coefficient of restitution in (0, 1]."""

    @abstractmethod
    def collision_time(self, mass: float, radius: float, speed: float) -> float:
        """Duration [s] of an undamped head-on collision.

        mass: effective mass [kg]; radius: effective radius [m]; speed: relative velocity before it [m/s].
        """

    @abstractmethod
    def stability(self, rods: bool) -> tuple[float, float]:
        """A and B of `labbook.scene.timescales.largest_stable_step`, measured in beds of spheres or of rods."""

    def rayleigh_time(self, radius: float, density: float) -> float:
        """Rayleigh time [s] of a grain of this radius [m] and density [kg/m^3]. Raises ValueError if it has none."""
        raise ValueError("the Rayleigh time needs a shear modulus: it belongs to the law hertz-mindlin")

    def softer(self, pressure: float, overlap: float, diameter: float) -> Softer | None:
        """The stiffness at which grains of the diameter d [m] overlap by `overlap` d where p d^2, p the pressure [Pa],
        presses them together; None where a law cannot tell."""
        return None


class HertzMindlin(ContactLaw):
    """Hertz normal force with Mindlin's friction spring (Fan et al. 2023, eqs 6-8)."""

    physics: ClassVar[str] = "labbook_dem.laws.hertz_mindlin"
    usual_step: ClassVar[str] = "0.1 rayleigh"  # the paper's: at most so much

    law: Literal["hertz-mindlin"] = "hertz-mindlin"
    shear_modulus: Pressure
    """G of the grains' material."""
    poisson_ratio: PoissonRatio
    """ν of the grains' material, in (-1, 1/2]."""
    tangential_damping: Coefficient = 1.0
    """C_t / C_n (the paper does not give C_t)."""

    @property
    def effective_modulus(self) -> float:
        """E* [Pa] of two equal bodies: 1/E* = 2 (1 - nu^2)/E with E = 2 G (1 + nu)."""
        return self.shear_modulus / (1 - self.poisson_ratio)

    def stiffened(self, factor: float) -> Self:
        """The law with `factor` times the shear modulus."""
        return self.model_copy(update={"shear_modulus": self.shear_modulus * factor})

    def damping_ratio(self, restitution: float) -> float:
        """C_n sqrt(6 m* K)/(2 sqrt(m* dF/d delta)) = C_n, as dF/d delta = 3/2 K."""
        if self.damping == "clamped":
            return damping.hertz_c_n(restitution)
        return damping.hertz_textbook(restitution)

    def collision_time(self, mass: float, radius: float, speed: float) -> float:
        """2.868 (m_eff^2 / (R_eff E*^2 v))^{1/5} [s]; 2.868 is 4/5 B(2/5, 1/2) (15/16)^{2/5} (Hertz 1882)."""
        return _HERTZ_DURATION * (mass**2 / (radius * self.effective_modulus**2 * speed)) ** 0.2

    def stability(self, rods: bool) -> tuple[float, float]:
        """Measured by benchmarks/step_limit.py; stronger tangential dashpots are taken to count in proportion."""
        return 2.5, 3.5 * max(1.0, self.tangential_damping)

    def rayleigh_time(self, radius: float, density: float) -> float:
        """pi r sqrt(rho/G) / (0.163 nu + 0.8766) [s] (Fan et al. 2023, eq 9)."""
        speed = math.sqrt(self.shear_modulus / density)
        return math.pi * radius / speed / (0.163 * self.poisson_ratio + 0.8766)

    def softer(self, pressure: float, overlap: float, diameter: float) -> Softer:
        """(delta/d)^{3/2} = 3 p/(2 E*), as F = (4/3) E* sqrt(d/4) delta^{3/2} = (2/3) E* d^2 (delta/d)^{3/2}."""
        modulus = 1.5 * pressure / overlap**1.5
        return Softer("shear_modulus", "Pa", self.shear_modulus, modulus * (1 - self.poisson_ratio))


class LinearSpringDashpot(ContactLaw):
    """Linear springs and dashpots (Pongo et al. 2022)."""

    physics: ClassVar[str] = "labbook_dem.laws.linear"
    usual_step: ClassVar[str] = "0.02 collision"  # the paper's: below so much

    law: Literal["linear"] = "linear"
    normal_stiffness: Stiffness
    """k_n [N/m]."""
    tangential_stiffness: Annotated[Ratio, Field(gt=0, le=10)] = 2 / 7
    """k_t / k_n."""
    tangential_damping: Coefficient = 1.0
    """γ_t / γ_n."""

    def stiffened(self, factor: float) -> Self:
        """The law with `factor` times the normal stiffness."""
        return self.model_copy(update={"normal_stiffness": self.normal_stiffness * factor})

    def damping_ratio(self, restitution: float) -> float:
        """gamma_n/(2 sqrt(k_n m*))."""
        if self.damping == "clamped":
            return damping.linear_ratio(restitution)
        return damping.linear_textbook(restitution)

    def collision_time(self, mass: float, radius: float, speed: float) -> float:
        """pi sqrt(m_eff/k_n) [s], at any speed."""
        return math.pi * math.sqrt(mass / self.normal_stiffness)

    def stability(self, rods: bool) -> tuple[float, float]:
        """Measured by benchmarks/step_limit.py with friction springs of 2/7 k_n; stiffer ones, and stronger tangential
        dashpots, are taken to count in proportion."""
        a, b = 1.8 * max(1.0, 3.5 * self.tangential_stiffness), 6.5 if rods else 5.7
        return a, b * max(1.0, self.tangential_damping)

    def softer(self, pressure: float, overlap: float, diameter: float) -> Softer:
        """delta/d = p d/k_n."""
        return Softer("normal_stiffness", "N/m", self.normal_stiffness, pressure * diameter / overlap)


CONTACT_LAWS = Choice("law", "labbook.contact_laws", ContactLaw, (HertzMindlin, LinearSpringDashpot))
"""The laws that a study can name under `contact.law`."""

AnyLaw = Annotated[ContactLaw, CONTACT_LAWS]
"""One of them, as a field of a scene."""
