"""Elastic materials: of grains of a kind and of walls that differ from the rest, and what two unlike ones come to."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, ClassVar, NamedTuple, Self

from pydantic import Field, model_validator

from labbook.scene.model import Fault, Model, refuse
from labbook.scene.quantities import Pressure, Ratio, Stiffness

PoissonRatio = Annotated[Ratio, Field(gt=-1, le=0.5)]

# what is not stated is left out of what is stored and hashed
_optional = Field(exclude_if=lambda value: value is None)
OwnModulus = Annotated[Pressure | None, _optional]
OwnRatio = Annotated[PoissonRatio | None, _optional]
OwnStiffness = Annotated[Stiffness | None, _optional]

TWICE = "E and G are both given, but one follows from the other", "keep one of youngs_modulus and shear_modulus"
"""Reason against a material that states both, and the remedy."""


class Material(NamedTuple):
    """Elastic material: shear modulus G [Pa] and Poisson's ratio."""

    shear_modulus: float
    poisson_ratio: float

    def beside(self, partner: "Material") -> "Material":
        """Compute the material that stands for a contact of unlike bodies.

        Unlike bodies have 1/E* = sum (1 - nu_i^2)/E_i = sum (1 - nu_i)/(2 G_i) and 1/G* = sum (2 - nu_i)/G_i (Johnson,
        Contact Mechanics, 1985, eqs 4.24 and 7.43). Two like ones with G = 2/(1/G_1 + 1/G_2), and with the mean of the
        nu_i weighted by 1/G_i, have the same E* and G*; so (2 - nu)/(2 (1 - nu)) is E*/(4 G*) of the unlike bodies.

        Args:
            partner: Material of the other body.

        Returns:
            Material of two like bodies with the same contact stiffness.
        """
        if self == partner:  # to the last bit
            return self
        first, second = 1 / self.shear_modulus, 1 / partner.shear_modulus
        nu = (self.poisson_ratio * first + partner.poisson_ratio * second) / (first + second)
        return Material(2 / (first + second), nu)


def shear_modulus(youngs_modulus: float, poisson_ratio: float) -> float:
    """Compute the shear modulus G = E/(2 (1 + nu)) [Pa]."""
    return youngs_modulus / (2 * (1 + poisson_ratio))


class OwnMaterial(Model):
    """Base of bodies that may be of a material of their own."""

    KEYS: ClassVar[tuple[str, ...]] = ("youngs_modulus", "shear_modulus", "poisson_ratio")
    """Keys of its material."""
    if TYPE_CHECKING:  # fields of each, in its own words
        youngs_modulus: float | None
        shear_modulus: float | None
        poisson_ratio: float | None

    def material(self, common: Material) -> Material:
        """Complete the material.

        Args:
            common: Material of the other bodies.

        Returns:
            Material of the body: constants that it does not state are those of `common`.
        """
        nu = common.poisson_ratio if self.poisson_ratio is None else self.poisson_ratio
        if self.youngs_modulus is not None:
            return Material(shear_modulus(self.youngs_modulus, nu), nu)
        return Material(common.shear_modulus if self.shear_modulus is None else self.shear_modulus, nu)

    @property
    def has_own(self) -> bool:
        """True if the body states a constant of its material."""
        return any(getattr(self, key) is not None for key in self.KEYS)

    @model_validator(mode="after")
    def _is_a_material(self) -> Self:
        refuse(self._faults_of_material())
        return self

    def _faults_of_material(self) -> Iterator[Fault]:
        if self.youngs_modulus is not None and self.shear_modulus is not None:
            yield Fault("youngs_modulus", *TWICE)
        elif self.poisson_ratio is not None and self.youngs_modulus is None and self.shear_modulus is None:
            reason = "a Poisson's ratio alone does not define the material"
            yield Fault("poisson_ratio", reason, "state youngs_modulus or shear_modulus beside it")
