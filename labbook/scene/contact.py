"""Contact laws: parameters, stiffness and time scales."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple, Self

from pydantic import Field, ValidationInfo, model_validator

from labbook.scene import damping
from labbook.scene.material import TWICE, Material, PoissonRatio, shear_modulus
from labbook.scene.model import Fault, Model, Required, TaggedModels, refuse
from labbook.scene.quantities import Coefficient, Duration, Length, Pressure, Ratio, Speed, Stiffness
from labbook.scene.surface import Between, Restitution

if TYPE_CHECKING:
    from labbook.scene.grains import Grains

Damping = Literal["clamped", "textbook", "printed"]
Rolling = Literal["full", "rolling"]
RollingModel = Literal["cdt", "epsd"]

COMMON = ("friction", "rolling_friction", "restitution", "damping")
"""Keys of all laws that a law may have no use for."""
_ROLLING_KEYS = ("rolling", "rolling_model", "rolling_stiffness", "rolling_damping")

ROLLING_STIFFNESS, ROLLING_DAMPING = 2.25, 0.3
"""Defaults of rolling springs: k_r/(k_n mu_r^2 R_r^2) of Ai et al. 2011, and the dashpot over the critical one."""

# The duration of an undamped collision by Hertz's law in units of (m_eff^2 / (R_eff E*^2 v))^{1/5}: twice the integral
# of dx / sqrt(1 - x^{5/2}) from 0 to 1, times (15/16)^{2/5}.
_HERTZ_DURATION = 0.8 * math.gamma(0.4) * math.gamma(0.5) / math.gamma(0.9) * (15 / 16) ** 0.4


class Softer(NamedTuple):
    """Stiffness of a law beside the lower one that a bed allows.

    Attributes:
        key: Key of the stiffness in `contact`.
        unit: SI unit of `value` and `required`.
        value: Stiffness of the law.
        required: Stiffness at which grains overlap as far as they may.
        alternative: Key that a study may state instead, and its value over that of `key`; None without one.
    """

    key: str
    unit: str
    value: float
    required: float
    alternative: tuple[str, float] | None = None


class ContactLaw(Model, ABC):
    """Base of all contact laws: their parameters, and the time scales and stiffness that follow from them.

    A law of another package derives from it; the formulas of its forces are in the module `physics`.
    """

    physics: ClassVar[str]
    """Module of its formulas, which a law of another package states; see `labbook_dem.laws`."""
    usual_step: ClassVar[str]
    """Default time step: a part of a time scale."""
    honours: ClassVar[frozenset[str]]
    """Keys among COMMON that its formulas use; a study that states another one is refused."""
    version: ClassVar[int] = 1
    """Version of its formulas, raised with each change of results: older runs and packings are then stale."""
    changes: ClassVar[Mapping[int, str]] = {}
    """Change by each version, in a few words; `plan` shows it."""

    if TYPE_CHECKING:  # a field of each law, which stands in stored records where it always stood
        law: str
        """Name of the law."""
    friction: Coefficient = 0.0
    """Friction coefficient μ between grains, and at walls without their own."""
    rolling_friction: Coefficient = 0.0
    """Rolling friction coefficient μ_r: the torque is at most μ_r R F_n; for R see `rolling_model`."""
    restitution: Restitution = 1.0
    """Coefficient of normal restitution e, in (0, 1]."""
    damping: Damping = "clamped"
    """`clamped`: damping that gives e with a normal force that never pulls; `textbook`: the papers'
    formula; `printed`: as `textbook`, but walls use the grain-grain damping, as in Pongó et al. (law linear)."""
    rolling: Rolling = "full"
    """`full`: rolling friction resists all relative rotation, also twist (Fan et al. 2023, eq 8, literally);
    `rolling`: only its tangential part."""
    # what is not stated is left out of what is stored and hashed
    rolling_model: Annotated[RollingModel, Field(exclude_if=lambda model: model == "cdt")] = "cdt"
    """`cdt`: constant directional torque (Fan et al. 2023, eq 8), with R the radius of the smaller grain; grains held
    by rolling friction alone creep. `epsd`: elastic-plastic spring-dashpot (Ai et al. 2011, model C), with effective
    radius R = r_i r_j/(r_i + r_j), at walls the grain radius; grains that it holds rest. Spheres only."""
    rolling_stiffness: Annotated[Ratio | None, Field(gt=0, exclude_if=lambda value: value is None)] = None
    """Stiffness of rolling springs as k_r/(k_n μ_r² R²), k_n = F_n/δ without damping; none: 2.25 (Ai et al. 2011)."""
    rolling_damping: Annotated[Coefficient | None, Field(exclude_if=lambda value: value is None)] = None
    """Damping ratio η_r of rolling springs; none: 0.3."""
    # where there are no kinds it is left out of what is stored and hashed
    between: Annotated[tuple[Between, ...], Field(exclude_if=lambda between: not between)] = ()
    """Pairs of kinds with their own contact parameters; all other pairs use those of the law."""

    @property
    def material(self) -> Material | None:
        """Elastic material of the grains, and of walls that state none.

        A law that has one takes `shear_modulus` and `poisson_ratio` of the `Material` that a contact comes to.

        Returns:
            The material; None for a law whose stiffness is of no material.
        """
        return None

    @classmethod
    def ignored(cls) -> tuple[str, ...]:
        """List the keys of all laws that this law has no use for.

        Returns:
            Names of fields; rolling keys are among them if the law has no rolling friction.
        """
        keys = tuple(key for key in COMMON if key not in cls.honours)
        return (*keys, *_ROLLING_KEYS) if "rolling_friction" in keys else keys

    @model_validator(mode="after")
    def _ignores_nothing_stated(self, info: ValidationInfo):
        required = (info.context or {}).get("units") == "required"
        explicit = self.model_fields_set if required else ()  # records have all keys, with their defaults
        fields = type(self).model_fields
        keys = [key for key in self.ignored() if key in explicit or getattr(self, key) != fields[key].default]
        refuse(Fault(key, useless(self.law, key), "leave it out") for key in keys)
        return self

    @model_validator(mode="after")
    def _rolling_fits(self):
        keys = [key for key in ("rolling_stiffness", "rolling_damping") if getattr(self, key) is not None]
        if self.rolling_model != "epsd":
            reason = "only the rolling model epsd has a spring and a dashpot for rolling"
            refuse(Fault(key, reason, f"leave {key} out, or use rolling_model: epsd") for key in keys)
        return self

    @property
    def rolling_spring(self) -> tuple[float, float]:
        """Stiffness k_r/(k_n mu_r^2 R_r^2) and damping ratio of rolling springs (Ai et al. 2011).

        `labbook_dem.contact.rolling_spring` has the formulas.
        """
        stiffness = ROLLING_STIFFNESS if self.rolling_stiffness is None else self.rolling_stiffness
        return stiffness, ROLLING_DAMPING if self.rolling_damping is None else self.rolling_damping

    @abstractmethod
    def stiffened(self, factor: float) -> Self:
        """Scale the stiffness.

        Args:
            factor: Factor on the stiffness, above 0.

        Returns:
            The law with `factor` times the stiffness, all else as it is.
        """

    @abstractmethod
    def damping_ratio(self, restitution: float) -> float:
        """Compute the normal dashpot of a contact over the critical one.

        Args:
            restitution: Coefficient of normal restitution, in (0, 1].

        Returns:
            Damping ratio, 0 without damping.
        """

    def damps(self, restitution: float) -> bool:
        """Decide if impacts may lose energy.

        Args:
            restitution: Coefficient of normal restitution, in (0, 1].

        Returns:
            True by default; False only if the law knows that no impact loses energy.
        """
        return True

    @abstractmethod
    def collision_time(self, mass: float, radius: float, speed: float) -> float:
        """Compute the duration of an undamped head-on collision.

        Args:
            mass: Effective mass m_1 m_2/(m_1 + m_2) [kg].
            radius: Effective radius r_1 r_2/(r_1 + r_2) [m].
            speed: Relative velocity before the collision [m/s].

        Returns:
            Duration [s].
        """

    @abstractmethod
    def stability(self, rods: bool) -> tuple[float, float]:
        """Give the coefficients of the stability limit A w^2 + 2 B z w > 1 of deep beds.

        `labbook.scene.timescales.largest_stable_step` has the formula. Values are measured in beds.

        Args:
            rods: The grains are rods, not spheres.

        Returns:
            A and B.
        """

    def rayleigh_time(self, radius: float, density: float) -> float:
        """Compute the Rayleigh time of a grain, in which a Rayleigh wave runs half round it.

        Args:
            radius: Radius of the grain [m].
            density: Density of its material [kg/m^3].

        Returns:
            Rayleigh time [s].

        Raises:
            ValueError: The law has no shear modulus; laws by Hertz have one.
        """
        raise ValueError("the Rayleigh time needs a shear modulus: it belongs to laws by Hertz")

    def overlap(self, pressure: float, diameter: float) -> float | None:
        """Compute the overlap of two equal grains at a pressure.

        Args:
            pressure: Pressure p [Pa]; the grains are pressed together by p d^2.
            diameter: Diameter d [m].

        Returns:
            Overlap over d; None if the law cannot tell.
        """
        return None

    def softer(self, pressure: float, overlap: float, diameter: float) -> Softer | None:
        """Compute the stiffness at which equal grains overlap by a part of their diameter.

        Args:
            pressure: Pressure p [Pa]; the grains are pressed together by p d^2.
            overlap: Overlap over d.
            diameter: Diameter d [m].

        Returns:
            That stiffness beside the law's own; None if the law cannot tell.
        """
        return None


def useless(law: str, key: str) -> str:
    """Word the reason against a key that the law ignores."""
    return f"the law {law} has no use for {key}"


class Dashpot(ContactLaw, ABC):
    """Base of laws with a normal dashpot that follows from the coefficient of restitution.

    A study states the coefficient: with the default of 1 no bed would come to rest.
    """

    honours: ClassVar[frozenset[str]] = frozenset(COMMON)

    restitution: Annotated[Restitution, Required()] = 1.0
    """Coefficient of normal restitution e, in (0, 1]; a law by Hertz may state `normal_damping` instead."""

    @model_validator(mode="after")
    def _damping_is_stated(self, info: ValidationInfo):
        required = (info.context or {}).get("units") == "required"
        if required and "restitution" not in self.model_fields_set and getattr(self, "normal_damping", None) is None:
            alternative = ", or state normal_damping" if "normal_damping" in type(self).model_fields else ""
            remedy = f"add it: a number in (0, 1], for example 0.5{alternative}; with 1 impacts lose no energy"
            refuse([Fault("restitution", "this key is missing", remedy)])
        return self

    def damps(self, restitution: float) -> bool:
        """True with any restitution below 1."""
        return restitution < 1


class YoungsModulus(Model):
    """Material by E, as a study may state it in `contact`; it is stored as its G."""

    youngs_modulus: Pressure
    """Young's modulus E of the grains' material, instead of `shear_modulus` = E/(2 (1 + ν))."""
    poisson_ratio: PoissonRatio
    """ν of the grains' material."""


class Hertz(Dashpot, ABC):
    """Hertz's normal force, F_n = K delta + C_n sqrt(6 m* K) v with K = (4/3) E* sqrt(R* delta), v the approach speed.

    Laws of this family differ in how friction is limited, and in whether the normal force may pull.
    """

    usual_step: ClassVar[str] = "0.1 rayleigh"  # of Fan et al. 2023: at most so much

    law: str
    """Name of the law; it stands before the other keys in records."""
    shear_modulus: Pressure
    """Shear modulus G of the grains' material; or state `youngs_modulus`."""
    poisson_ratio: PoissonRatio
    """Poisson's ratio ν of the grains' material, in (-1, 1/2]."""
    tangential_damping: Coefficient = 1.0
    """Ratio C_t/C_n of tangential to normal damping (Fan et al. do not give C_t)."""
    # what is not stated is left out of what is stored and hashed
    normal_damping: Annotated[Coefficient | None, Field(exclude_if=lambda value: value is None)] = None
    """Value of C_n, instead of one from the coefficient of restitution; none: as `damping` says."""

    spellings: ClassVar[type[Model] | None] = YoungsModulus

    @model_validator(mode="before")
    @classmethod
    def _by_youngs_modulus(cls, data: Any, info: ValidationInfo) -> Any:
        if not isinstance(data, Mapping) or "youngs_modulus" not in data:
            return data
        if "shear_modulus" in data:
            refuse([Fault("youngs_modulus", *TWICE)])
        constants = {key: data[key] for key in YoungsModulus.model_fields if key in data}
        young = YoungsModulus.model_validate(constants, context=info.context)
        rest = {key: value for key, value in data.items() if key != "youngs_modulus"}
        return rest | {"shear_modulus": f"{shear_modulus(young.youngs_modulus, young.poisson_ratio)!r} Pa"}

    @property
    def youngs_modulus(self) -> float:
        """Young's modulus E = 2 G (1 + nu) [Pa] of the grains' material."""
        return 2 * self.shear_modulus * (1 + self.poisson_ratio)

    @property
    def material(self) -> Material:
        """Material of the grains: G and nu."""
        return Material(self.shear_modulus, self.poisson_ratio)

    @property
    def pulls(self) -> bool:
        """True if the normal force may be attractive, as a dashpot is when grains part."""
        return False

    @property
    def effective_modulus(self) -> float:
        """Effective modulus E* [Pa] of two equal bodies: 1/E* = 2 (1 - nu^2)/E with E = 2 G (1 + nu)."""
        return self.shear_modulus / (1 - self.poisson_ratio)

    def stiffened(self, factor: float) -> Self:
        """Multiply the shear modulus by `factor`."""
        return self.model_copy(update={"shear_modulus": self.shear_modulus * factor})

    def damping_ratio(self, restitution: float) -> float:
        """Damping ratio of the dashpot C_n sqrt(6 m* K) v: C_n itself.

        C_n sqrt(6 m* K)/(2 sqrt(m* dF/d delta)) = C_n, as dF/d delta = 3/2 K.
        """
        if self.normal_damping is not None:
            return self.normal_damping
        if self.damping == "clamped":
            return damping.hertz_c_n(restitution)
        return damping.hertz_textbook(restitution)

    def damps(self, restitution: float) -> bool:
        """True if `normal_damping` is above 0; where it is not stated, if the restitution is below 1."""
        return restitution < 1 if self.normal_damping is None else self.normal_damping > 0

    def collision_time(self, mass: float, radius: float, speed: float) -> float:
        """Duration 2.868 (m_eff^2 / (R_eff E*^2 v))^{1/5} [s] (Hertz 1882).

        2.868 is 4/5 B(2/5, 1/2) (15/16)^{2/5}, with the beta function B.
        """
        return _HERTZ_DURATION * (mass**2 / (radius * self.effective_modulus**2 * speed)) ** 0.2

    def stability(self, rods: bool) -> tuple[float, float]:
        """Coefficients measured by benchmarks/step_limit.py.

        Stronger tangential dashpots are taken to count in proportion.
        """
        return 2.5, 3.5 * max(1.0, self.tangential_damping)

    def rayleigh_time(self, radius: float, density: float) -> float:
        """Rayleigh time pi r sqrt(rho/G) / (0.163 nu + 0.8766) [s] (Fan et al. 2023, eq 9)."""
        speed = math.sqrt(self.shear_modulus / density)
        return math.pi * radius / speed / (0.163 * self.poisson_ratio + 0.8766)

    def overlap(self, pressure: float, diameter: float) -> float:
        """Overlap over d: (delta/d)^{3/2} = 3 p/(2 E*).

        It follows from F = (4/3) E* sqrt(d/4) delta^{3/2} = (2/3) E* d^2 (delta/d)^{3/2} = p d^2.
        """
        return (1.5 * pressure / self.effective_modulus) ** (2 / 3)

    def softer(self, pressure: float, overlap: float, diameter: float) -> Softer:
        """Shear modulus from the overlap now, which is proportional to G^{-2/3}."""
        required = self.shear_modulus * (self.overlap(pressure, diameter) / overlap) ** 1.5
        alternative = "youngs_modulus", 2 * (1 + self.poisson_ratio)
        return Softer("shear_modulus", "Pa", self.shear_modulus, required, alternative)


class HertzMindlin(Hertz):
    """Hertz normal force with Mindlin's friction spring (Fan et al. 2023, eqs 6-8).

    The normal force never pulls. Eq 7 is taken with the total normal force F_n in place of its elastic part. The spring
    is cut where its force reaches mu F_n; there the contact slides. Spring and dashpot together are at most mu F_n.
    """

    version: ClassVar[int] = 2
    changes: ClassVar[Mapping[int, str]] = {2: "sliding contacts carry mu F_n"}

    law: Literal["hertz-mindlin"] = "hertz-mindlin"


class Tensile(Hertz, ABC):
    """Base of laws by Hertz whose normal force may pull, unless a study forbids it."""

    damping: Damping = "textbook"
    """`textbook`: C_n = sqrt(5/6) ln(1/e)/sqrt(pi^2 + ln^2 e), which gives e if the normal force may pull;
    `clamped`: damping that gives e if it may not."""
    tension: bool = True
    """The normal force may pull as grains separate, as in the paper or code of the law."""

    @property
    def pulls(self) -> bool:
        """True if the normal force may be attractive: as `tension` says."""
        return self.tension

    @model_validator(mode="after")
    def _damping_fits(self):
        if self.tension and self.damping == "clamped" and self.normal_damping is None:
            reason = "clamped damping assumes a normal force that never pulls, but contact.tension allows it to pull"
            refuse([Fault("damping", reason, "use textbook, or tension: false")])
        return self


class HertzPrinted(Tensile):
    """Fan et al. 2023, eqs 6 to 8, literally: no limit on the total friction force.

    Friction is F_t^e = mu F_n^e (1 - (1 - min(s, s_max)/s_max)^{3/2}) with a dashpot that vanishes at s_max. The spring
    keeps growing while the contact slides. A reversal must first undo this growth, and the spring pushes meanwhile.
    Without rolling resistance grains therefore never come to rest, and beds have to be filled by another law
    (`fill.contact`). The spring pushes with the present mu F_n^e, not with that during the sliding, which can add
    energy: a wedged grain may reach ten times the speed of free fall.
    """

    law: Literal["hertz-printed"] = "hertz-printed"


class HertzLiggghts(Tensile):
    """The model `hertz tangential history` of LIGGGHTS 3.8 (normal_model_hertz.h, tangential_model_history.h).

    Friction is a spring of 8 G* sqrt(R* delta) and a dashpot. The spring is cut at mu |F_n|, and a contact that slides
    has no dashpot; one that does not slide has both, together not limited.
    """

    law: Literal["hertz-liggghts"] = "hertz-liggghts"


class HertzLammps(Tensile):
    """`hertz/material` with `tangential mindlin` of LAMMPS' pair style granular (pair_granular.cpp, January 2022).

    Friction is a spring of 8 G* sqrt(R* delta) and a dashpot, which is `tangential_damping` times the normal one. Their
    sum is cut at mu |F_n|, and the spring shortened to what then is left of it.
    """

    law: Literal["hertz-lammps"] = "hertz-lammps"


class CollisionStiffness(Model):
    """Stiffness k_n by a collision of two equal grains, as a study may state it in `contact`."""

    KEYS: ClassVar[tuple[str, ...]] = ("contact_time", "largest_overlap", "impact_speed")

    contact_time: Duration | None = None
    """Duration t_c of a collision of two of the lightest grains."""
    largest_overlap: Length | None = None
    """Largest overlap in a collision of two of the heaviest grains without damping."""
    impact_speed: Annotated[Speed | None, Field(gt=0)] = None
    """Relative velocity of the grains in that collision."""
    restitution: Restitution = 1.0
    """Coefficient of normal restitution e."""

    @model_validator(mode="after")
    def _is_one_way(self):
        refuse(self._faults())
        return self

    def _faults(self) -> Iterator[Fault]:
        if self.contact_time is not None and self.largest_overlap is not None:
            keep = "keep one of contact_time and largest_overlap"
            yield Fault("contact_time", "the stiffness is stated twice", keep)
        elif self.contact_time is not None and self.impact_speed is not None:
            yield Fault("impact_speed", "a contact time does not depend on the speed", "leave it out")
        elif self.contact_time is None and (self.largest_overlap is None) != (self.impact_speed is None):
            missing_key = "largest_overlap" if self.largest_overlap is None else "impact_speed"
            reason = "an overlap follows from the speed of the grains"
            yield Fault(missing_key, reason, "state largest_overlap and impact_speed, such as 0.01 d and 1 m/s")

    def stiffness(self, grains: "Grains | None") -> float:
        """Compute k_n from a collision of two equal grains of the mass m, whose effective mass is m/2.

        Of the contact time t_c = pi sqrt(m/(2 k_n))/sqrt(1 - z^2) with z = |ln e|/sqrt(pi^2 + ln^2 e),
        k_n = m (pi^2 + ln^2 e)/(2 t_c^2). Of the overlap, from the energy m v^2/4 = k_n delta^2/2.

        Args:
            grains: Grains of the study; a contact time is that of the lightest ones, an overlap that of the heaviest.

        Returns:
            k_n [N/m].

        Raises:
            PydanticCustomError: There are no grains.
        """
        if grains is None:
            reason = "a stiffness by a collision needs the grains, which are known in a study"
            refuse([Fault("contact_time", reason, "state normal_stiffness")])
            raise AssertionError
        if self.contact_time is not None:
            mass = min(sphere.mass for sphere in grains.smallest())
            return mass * (math.pi**2 + math.log(self.restitution) ** 2) / (2 * self.contact_time**2)
        assert self.largest_overlap is not None
        assert self.impact_speed is not None
        mass = max(sphere.mass for sphere in grains.largest())
        return mass * (self.impact_speed / self.largest_overlap) ** 2 / 2


class LinearSpringDashpot(Dashpot):
    """Linear springs and dashpots (Pongó et al. 2022)."""

    usual_step: ClassVar[str] = "0.02 collision"  # the paper's: below so much

    law: Literal["linear"] = "linear"
    normal_stiffness: Stiffness
    """Normal stiffness k_n; or state `contact_time`, or `largest_overlap` with `impact_speed`."""
    tangential_stiffness: Annotated[Ratio, Field(gt=0, le=10)] = 2 / 7
    """Ratio k_t/k_n of tangential to normal stiffness."""
    tangential_damping: Coefficient = 1.0
    """Ratio γ_t/γ_n of tangential to normal damping."""
    # what is stored and hashed is the stiffness alone, so that a run is the same by whichever way it is stated
    contact_time: Annotated[Duration | None, Field(exclude=True)] = None
    """Duration t_c of a collision of two of the lightest grains, instead of `normal_stiffness`: k_n = m (π² + ln² e)/(2
    t_c²) with the mass m of a grain. This is the contact time of a spring and dashpot whose force may pull."""
    largest_overlap: Annotated[Length | None, Field(exclude=True)] = None
    """Largest overlap δ in a collision of two of the heaviest grains without damping, instead of `normal_stiffness`:
    k_n = m v²/(2 δ²) with the mass m of a grain and v the `impact_speed`."""
    impact_speed: Annotated[Speed | None, Field(gt=0, exclude=True)] = None
    """Relative velocity v of the grains in the collision that `largest_overlap` is for."""

    @model_validator(mode="before")
    @classmethod
    def _by_collision(cls, data: Any, info: ValidationInfo) -> Any:
        if not isinstance(data, Mapping) or not any(data.get(key) is not None for key in CollisionStiffness.KEYS):
            return data
        if "normal_stiffness" in data:
            key = next(key for key in CollisionStiffness.KEYS if data.get(key) is not None)
            refuse([Fault(key, "the stiffness is stated twice", f"keep one of normal_stiffness and {key}")])
        keys = {key: data[key] for key in CollisionStiffness.model_fields if key in data}
        collision = CollisionStiffness.model_validate(keys, context=info.context)
        return {**data, "normal_stiffness": f"{collision.stiffness((info.context or {}).get('grains')):.12g} N/m"}

    def stiffened(self, factor: float) -> Self:
        """Multiply the normal stiffness by `factor`."""
        return self.model_copy(update={"normal_stiffness": self.normal_stiffness * factor})

    def damping_ratio(self, restitution: float) -> float:
        """Damping ratio gamma_n/(2 sqrt(k_n m*))."""
        if self.damping == "clamped":
            return damping.linear_ratio(restitution)
        return damping.linear_textbook(restitution)

    def collision_time(self, mass: float, radius: float, speed: float) -> float:
        """Duration pi sqrt(m_eff/k_n) [s], at any speed."""
        return math.pi * math.sqrt(mass / self.normal_stiffness)

    def stability(self, rods: bool) -> tuple[float, float]:
        """Coefficients measured by benchmarks/step_limit.py with friction springs of 2/7 k_n.

        Stiffer ones, and stronger tangential dashpots, are taken to count in proportion.
        """
        a, b = 1.8 * max(1.0, 3.5 * self.tangential_stiffness), 6.5 if rods else 5.7
        return a, b * max(1.0, self.tangential_damping)

    def overlap(self, pressure: float, diameter: float) -> float:
        """Overlap over d: p d/k_n."""
        return pressure * diameter / self.normal_stiffness

    def softer(self, pressure: float, overlap: float, diameter: float) -> Softer:
        """Normal stiffness from the overlap now, which is proportional to 1/k_n."""
        required = self.normal_stiffness * self.overlap(pressure, diameter) / overlap
        return Softer("normal_stiffness", "N/m", self.normal_stiffness, required)


CONTACT_LAWS = TaggedModels(
    "law",
    "labbook.contact_laws",
    ContactLaw,
    (HertzMindlin, HertzPrinted, HertzLiggghts, HertzLammps, LinearSpringDashpot),
)
"""Laws that a study can name under `contact.law`."""

AnyLaw = Annotated[ContactLaw, CONTACT_LAWS]
"""Field of a scene for one of these laws."""
