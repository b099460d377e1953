"""Surfaces that contacts act between: friction, rolling friction, restitution and a material of their own."""

from typing import Annotated

from pydantic import Field

from labbook.scene.material import OwnMaterial, OwnModulus, OwnRatio, OwnStiffness
from labbook.scene.model import Model
from labbook.scene.quantities import Coefficient, Ratio

Restitution = Annotated[Ratio, Field(gt=0, le=1)]


class Surface(Model):
    """Friction, rolling friction and restitution of the contacts of two surfaces, all stated."""

    friction: Coefficient
    """Coulomb coefficient μ."""
    rolling_friction: Coefficient
    """Rolling friction coefficient μ_r."""
    restitution: Restitution
    """Coefficient of normal restitution, in (0, 1]."""

    def changed(self, change: "ContactChange") -> "Surface":
        """Replace values of the surface.

        Args:
            change: Values of its own, None where it has none.

        Returns:
            The surface with the values of `change` in place of its own.
        """
        values = change.friction, change.rolling_friction, change.restitution
        if values == (None, None, None):
            return self
        changes = zip(("friction", "rolling_friction", "restitution"), values, strict=True)
        return self.model_copy(update={key: value for key, value in changes if value is not None})


class ContactChange(Model):
    """Contact parameters of some contacts; a parameter that is None is that of the law."""

    friction: Coefficient | None = None
    """Coulomb coefficient."""
    rolling_friction: Coefficient | None = None
    """μ_r."""
    restitution: Restitution | None = None
    """Coefficient of normal restitution, in (0, 1]."""


class SurfaceChange(ContactChange, OwnMaterial):
    """Contact parameters and material of a wall; None: as between grains, and as in `contact`."""

    friction: Coefficient | None = None
    """Friction coefficient at this wall."""
    rolling_friction: Coefficient | None = None
    """Rolling friction coefficient μ_r at this wall."""
    restitution: Restitution | None = None
    """Coefficient of normal restitution at this wall, in (0, 1]."""
    youngs_modulus: OwnModulus = None
    """Young's modulus E of this wall's material, instead of `shear_modulus`."""
    shear_modulus: OwnModulus = None
    """Shear modulus G of this wall's material (laws by Hertz); none: as in `contact`."""
    poisson_ratio: OwnRatio = None
    """Poisson's ratio ν of this wall's material, only with a modulus; none: as in `contact`."""
    normal_stiffness: OwnStiffness = None
    """Normal stiffness k_n at this wall (law linear)."""


class Between(ContactChange):
    """Contact parameters between two kinds of grains; the same kind twice: of its grains with each other."""

    kinds: tuple[str, str]
    """Names of the two kinds, from `grains.kinds`."""
    friction: Coefficient | None = None
    """Friction coefficient between these kinds; for one kind named twice also at walls without their own."""
    rolling_friction: Coefficient | None = None
    """Rolling friction coefficient μ_r between these kinds; at walls as for `friction`."""
    restitution: Restitution | None = None
    """Coefficient of normal restitution between these kinds, in (0, 1]; at walls as for `friction`."""
    normal_stiffness: OwnStiffness = None
    """Normal stiffness k_n between these kinds (law linear); at walls as for `friction`."""
