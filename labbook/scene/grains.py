"""Bodies that flow: spheres, equal or of several sizes and kinds, or equal rods.

Every shape knows its mass, its inertia and the segment that its surface is at a radius from: that of a sphere has the
half length 0, and so a sphere is the spherocylinder whose length is its diameter.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from labbook.scene.material import OwnMaterial, OwnModulus, OwnRatio
from labbook.scene.model import Fault, Model, refuse
from labbook.scene.quantities import Density, GrainLength, Length, Ratio, Whole, percent
from labbook.scene.sizes import SMALLEST_PART, Equal, Sizes

Count = Annotated[Whole, Field(ge=1, le=100_000_000)]


class Kind(OwnMaterial):
    """One kind of grains in a mixture."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9-]*$", max_length=40)]
    """Name that `contact.between` refers to: lower-case letters, digits and hyphens."""
    # what is not stated is left out of what is stored and hashed
    share: Annotated[Ratio | None, Field(gt=0, le=1, exclude_if=lambda share: share is None)] = None
    """Number fraction of this kind; all shares add up to 1. All kinds state `share`, or all state `mass_share`."""
    mass_share: Annotated[Ratio | None, Field(gt=0, le=1, exclude_if=lambda share: share is None)] = None
    """Mass fraction of this kind, instead of `share`; all add up to 1."""
    diameter: Length | None = None
    """Diameter of all grains of this kind, at most d; none: from `grains.sizes`, or d."""
    density: Density | None = None
    """Density of this kind's material; none: `grains.density`."""
    youngs_modulus: OwnModulus = None
    """Young's modulus E of this kind's material, instead of `shear_modulus`."""
    shear_modulus: OwnModulus = None
    """Shear modulus G of this kind's material (laws by Hertz); none: as in `contact`."""
    poisson_ratio: OwnRatio = None
    """Poisson's ratio ν of this kind's material, only with a modulus; none: as in `contact`."""


@dataclass(frozen=True)
class Species:
    """Grains of one kind.

    Attributes:
        share: Share of all grains, by number.
        density: Density of the material [kg/m^3].
        sizes: Distribution of diameters.
    """

    share: float
    density: float
    sizes: Sizes | Equal


class Spheres(Model):
    """Spheres, equal or of several sizes and materials."""

    shape: Literal["sphere"] = "sphere"
    diameter: Length
    """Diameter d of the largest grains; `d` is a unit of length in all other keys."""
    density: Density
    """Density ρ_p of the grains' material."""
    count: Count
    """Number of grains N."""
    # what is not there is left out of what is stored and hashed: equal spheres are the same scene as ever
    sizes: Annotated[Sizes | None, Field(exclude_if=lambda sizes: sizes is None)] = None
    """Distribution of diameters, up to d; none: all diameters are d."""
    kinds: Annotated[tuple[Kind, ...], Field(exclude_if=lambda kinds: not kinds)] = ()
    """Kinds of grains, which differ in material or size; none: one kind."""

    @model_validator(mode="after")
    def _is_possible(self):
        refuse(self._faults())
        return self

    def _faults(self) -> Iterator[Fault]:
        d, smallest = self.diameter, SMALLEST_PART * self.diameter
        if self.sizes is not None:
            yield from self.sizes.faults(d)
        if not self.kinds:
            return
        names = [kind.name for kind in self.kinds]
        if len(set(names)) < len(names):
            yield Fault("kinds", "two kinds have the same name", "give each kind its own name")
        yield from self._faults_of_shares()
        for kind in self.kinds:
            if kind.diameter is not None and not smallest <= kind.diameter <= d:
                reason = f"the diameter of {kind.name} ({kind.diameter * 1e3:g} mm) is not between d/10 and d"
                yield Fault("kinds", reason, f"use {smallest * 1e3:g} to {d * 1e3:g} mm; d is grains.diameter")
        if all(kind.diameter is not None for kind in self.kinds):
            if self.sizes is not None:
                yield Fault("sizes", "every kind states its own diameter", "leave out sizes or the diameters of kinds")
            elif max(kind.diameter or 0.0 for kind in self.kinds) < d:
                yield Fault("kinds", "no kind is as large as grains.diameter", "let d be the largest diameter")

    def _faults_of_shares(self) -> Iterator[Fault]:
        by_number, by_mass = ([getattr(kind, key) for kind in self.kinds] for key in ("share", "mass_share"))
        shares = by_number if by_mass.count(None) == len(by_mass) else by_mass
        if None in shares or by_number.count(None) + by_mass.count(None) != len(shares):
            reason = "the kinds do not all state their share in the same way"
            yield Fault("kinds", reason, "state share (by number) or mass_share for each kind, not both")
            return
        total = math.fsum(share for share in shares if share is not None)
        if abs(total - 1) > 1e-6:
            yield Fault("kinds", f"the shares add up to {percent(total, 'g')}", "let them add up to 100 %")

    @property
    def varied(self) -> bool:
        """True if grains differ from one another."""
        return self.sizes is not None or bool(self.kinds)

    @property
    def graded(self) -> bool:
        """True if grains differ in size."""
        return any(species.sizes.range(self.diameter)[0] < self.diameter for species in self.species)

    @property
    def species(self) -> tuple[Species, ...]:
        """Kinds of the grains with shares by number; equal grains are of one kind."""
        rest = self.sizes or Equal(self.diameter)
        if not self.kinds:
            return (Species(1.0, self.density, rest),)
        densities = [kind.density or self.density for kind in self.kinds]
        sizes = [Equal(kind.diameter) if kind.diameter else rest for kind in self.kinds]
        shares = [kind.share for kind in self.kinds if kind.share is not None]
        if not shares:  # the mass of a grain is its density times the mean cube, and a factor that all share
            masses = [rho * cube.mean_cube(self.diameter) for rho, cube in zip(densities, sizes, strict=True)]
            numbers = [(kind.mass_share or 0.0) / mass for kind, mass in zip(self.kinds, masses, strict=True)]
            shares = [number / math.fsum(numbers) for number in numbers]
        return tuple(map(Species, shares, densities, sizes))

    def smallest(self) -> tuple["Spheres", ...]:
        """Make equal spheres like the smallest of each kind: the lightest grains, which limit a time step.

        Returns:
            Spheres of one diameter and density for each kind.
        """
        if not self.varied:
            return (self,)
        return tuple(
            Spheres(diameter=species.sizes.range(self.diameter)[0], density=species.density, count=self.count)
            for species in self.species
        )

    def largest(self) -> tuple["Spheres", ...]:
        """Make equal spheres like the largest of each kind.

        Returns:
            Spheres of one diameter and density for each kind.
        """
        if not self.varied:
            return (self,)
        return tuple(
            Spheres(diameter=species.sizes.range(self.diameter)[1], density=species.density, count=self.count)
            for species in self.species
        )

    @property
    def radius(self) -> float:
        """Radius of the largest grains [m]."""
        return self.diameter / 2

    @property
    def mean_cube(self) -> float:
        """Mean of the diameter cubed [m^3]."""
        if not self.varied:
            return self.diameter**3
        return math.fsum(species.share * species.sizes.mean_cube(self.diameter) for species in self.species)

    @property
    def mean_diameter(self) -> float:
        """Mean of the diameter by number [m]."""
        return math.fsum(species.share * species.sizes.moment(1, self.diameter) for species in self.species)

    @property
    def mean_diameter_by_mass(self) -> float:
        """Mean of the diameter weighted by mass [m]."""
        masses = [(species.share * species.density, species.sizes) for species in self.species]
        fourth = math.fsum(weight * sizes.moment(4, self.diameter) for weight, sizes in masses)
        return fourth / math.fsum(weight * sizes.mean_cube(self.diameter) for weight, sizes in masses)

    @property
    def finest(self) -> float:
        """Diameter of the smallest grains [m], by which overlaps are judged."""
        return min(sphere.diameter for sphere in self.smallest())

    @property
    def half_length(self) -> float:
        """Half the length of the segment at the heart of the grain [m]: 0, since it is a point."""
        return 0.0

    @property
    def extent(self) -> float:
        """Length of the largest grains from end to end [m]: d."""
        return self.diameter

    @property
    def aspect_ratio(self) -> float:
        """Aspect ratio L/d: 1."""
        return 1.0

    @property
    def volume(self) -> float:
        """Mean volume of a grain [m^3]; of every grain, if they are equal."""
        return math.pi / 6 * self.mean_cube

    @property
    def equivalent_diameter(self) -> float:
        """Diameter d* of the sphere of the (mean) volume [m]: d itself, if they are equal."""
        return self.mean_cube ** (1 / 3) if self.varied else self.diameter

    @property
    def mass(self) -> float:
        """Mean mass of a grain [kg]; of every grain, if they are equal."""
        if not self.varied:
            return self.density * math.pi / 6 * self.diameter**3
        cubes = (species.share * species.density * species.sizes.mean_cube(self.diameter) for species in self.species)
        return math.pi / 6 * math.fsum(cubes)

    @property
    def mean_density(self) -> float:
        """Mass of all grains over their volume [kg/m^3]."""
        return self.mass / self.volume if self.kinds else self.density

    @property
    def inertia(self) -> float:
        """Moment of inertia of one of equal grains about any axis through its centre [kg m^2]: (2/5) m r^2."""
        return 0.4 * self.mass * self.radius**2

    @property
    def inertia_axis(self) -> float:
        """Moment of inertia about the grain's own axis [kg m^2]: the same as about any."""
        return self.inertia


class Spherocylinders(Model):
    """Equal rods: cylinders with hemispheres on both ends."""

    shape: Literal["spherocylinder"] = "spherocylinder"
    diameter: Length
    """Diameter d; `d` is a unit of length in all other keys."""
    length: GrainLength
    """Length L from end to end, at least the diameter; an aspect ratio of 3.3 is a length of `3.3 d`."""
    density: Density
    """Density ρ_p of the grains' material."""
    count: Count
    """Number of grains N."""
    varied: ClassVar[bool] = False
    kinds: ClassVar[tuple[Kind, ...]] = ()

    @model_validator(mode="after")
    def _is_possible(self):
        refuse(self._faults())
        return self

    def _faults(self) -> Iterator[Fault]:
        if self.length < self.diameter:
            sizes = f"{self.length * 1e3:g} mm against {self.diameter * 1e3:g} mm"
            reason = f"a rod from end to end is not shorter than its diameter ({sizes})"
            yield Fault("length", reason, "make it at least 1 d, which is a sphere")

    @property
    def species(self) -> tuple[Species, ...]:
        """Kind of the rods, which are all equal."""
        return (Species(1.0, self.density, Equal(self.diameter)),)

    def smallest(self) -> tuple["Spherocylinders", ...]:
        """Rods themselves, which are all equal."""
        return (self,)

    def largest(self) -> tuple["Spherocylinders", ...]:
        """Rods themselves, which are all equal."""
        return (self,)

    @property
    def mean_density(self) -> float:
        """Mass of all grains over their volume [kg/m^3]."""
        return self.density

    @property
    def radius(self) -> float:
        """Radius of cylinder and ends [m]."""
        return self.diameter / 2

    @property
    def finest(self) -> float:
        """Diameter of the smallest rods [m], by which overlaps are judged: that of all."""
        return self.diameter

    @property
    def half_length(self) -> float:
        """Half the length of the segment that the surface is a radius away from [m]: (L - d)/2."""
        return (self.length - self.diameter) / 2

    @property
    def extent(self) -> float:
        """Length from end to end [m]: L."""
        return self.diameter + 2 * self.half_length  # to the last bit what places of grains were computed with

    @property
    def aspect_ratio(self) -> float:
        """Aspect ratio L/d."""
        return self.length / self.diameter

    @property
    def volume(self) -> float:
        """Volume of one grain [m^3]."""
        return math.pi / 4 * self.diameter**2 * (2 * self.half_length) + math.pi / 6 * self.diameter**3

    @property
    def equivalent_diameter(self) -> float:
        """Diameter d* of the sphere of the same volume [m]."""
        return (6 * self.volume / math.pi) ** (1 / 3)

    @property
    def _masses(self) -> tuple[float, float]:
        """Mass of the cylinder and of both ends together [kg]."""
        ends = self.density * math.pi / 6 * self.diameter**3
        return self.density * math.pi * self.radius**2 * (2 * self.half_length), ends

    @property
    def mass(self) -> float:
        """Mass of one grain [kg]."""
        cylinder, ends = self._masses
        return cylinder + ends

    @property
    def inertia(self) -> float:
        """Moment of inertia about any axis through the centre across the rod [kg m^2].

        m_c (l^2/12 + r^2/4) + m_s (2 r^2/5 + l^2/4 + 3 l r/8) with l = L - d: Steiner's theorem for two hemispheres.
        """
        (cylinder, ends), r, l = self._masses, self.radius, 2 * self.half_length
        return cylinder * (l**2 / 12 + r**2 / 4) + 0.4 * ends * r**2 + ends * (l**2 / 4 + 3 * l * r / 8)

    @property
    def inertia_axis(self) -> float:
        """Moment of inertia about the rod's axis [kg m^2]: m_c r^2/2 + m_s 2 r^2/5."""
        cylinder, ends = self._masses
        return cylinder * self.radius**2 / 2 + 0.4 * ends * self.radius**2


Grains = Annotated[Spheres | Spherocylinders, Field(discriminator="shape")]
