"""Contact laws and the surfaces that they act between."""

from typing import Annotated, Literal, Self

from pydantic import Field

from labbook.scene.model import Model
from labbook.scene.quantities import Coefficient, Pressure, Ratio, Stiffness

Restitution = Annotated[Ratio, Field(gt=0, le=1)]
PoissonRatio = Annotated[Ratio, Field(gt=-1, le=0.5)]
Damping = Literal["clamped", "textbook", "printed"]
Rolling = Literal["full", "rolling"]


class Surface(Model):
    """Where a wall differs from the grains; what is not given is as between grains."""

    friction: Coefficient | None = None
    """Coulomb coefficient at this wall."""
    rolling_friction: Coefficient | None = None
    """μ_r at this wall."""
    restitution: Restitution | None = None
    """Coefficient of normal restitution at this wall, in (0, 1]."""

    def over(self, below: "Surface") -> "Surface":
        """This surface with its gaps filled from `below`."""
        given = {key: getattr(self, key) for key in Surface.model_fields if getattr(self, key) is not None}
        return below.model_copy(update=given)


class Between(Surface):
    """Where contacts of two kinds of grains differ from all others; one kind twice: of its grains with each other."""

    kinds: tuple[str, str]
    """Names of the two kinds, of `grains.kinds`."""
    friction: Coefficient | None = None
    """Coulomb coefficient between these kinds, and, of one kind twice, of its grains at walls that state no other."""
    rolling_friction: Coefficient | None = None
    """μ_r between these kinds, and likewise at walls."""
    restitution: Restitution | None = None
    """Coefficient of normal restitution between these kinds, in (0, 1], and likewise at walls."""


class _Frictional(Model):
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


class HertzMindlin(_Frictional):
    """Hertz normal force with Mindlin's friction spring (Fan et al. 2023, eqs 6-8)."""

    law: Literal["hertz-mindlin"] = "hertz-mindlin"
    shear_modulus: Pressure
    """G of the grains' material."""
    poisson_ratio: PoissonRatio
    """ν of the grains' material, in (-1, 1/2]."""
    tangential_damping: Coefficient = 1.0
    """C_t / C_n (the paper does not give C_t)."""

    def stiffened(self, factor: float) -> Self:
        """The law with `factor` times the stiffness."""
        return self.model_copy(update={"shear_modulus": self.shear_modulus * factor})


class LinearSpringDashpot(_Frictional):
    """Linear springs and dashpots (Pongo et al. 2022)."""

    law: Literal["linear"] = "linear"
    normal_stiffness: Stiffness
    """k_n [N/m]."""
    tangential_stiffness: Annotated[Ratio, Field(gt=0, le=10)] = 2 / 7
    """k_t / k_n."""
    tangential_damping: Coefficient = 1.0
    """γ_t / γ_n."""

    def stiffened(self, factor: float) -> Self:
        """The law with `factor` times the stiffness."""
        return self.model_copy(update={"normal_stiffness": self.normal_stiffness * factor})


ContactLaw = Annotated[HertzMindlin | LinearSpringDashpot, Field(discriminator="law")]
