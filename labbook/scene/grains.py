"""Bodies that flow: spheres, equal or of several sizes and kinds, equal rods, or equal clumps of spheres.

Every shape knows its mass, its moments of inertia and how far its surface reaches. A sphere and a rod also know the
segment that the surface is at a radius from: that of a sphere has the half length 0, and so a sphere is the
spherocylinder whose length is its diameter. A clump knows its spheres.
"""

import itertools
import math
import operator
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from labbook.scene.material import OwnMaterial, OwnModulus, OwnRatio
from labbook.scene.model import Fault, Model, once, refuse
from labbook.scene.quantities import Density, GrainLength, GrainPoint, Length, Ratio, Whole, percent
from labbook.scene.sizes import SMALLEST_PART, Equal, Sizes
from labbook.scene.sphere_union import Triple, UnionProperties, union_properties

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

    oriented: ClassVar[bool] = False
    """True if grains have an orientation q."""
    noun: ClassVar[str] = "sphere"
    """Word for a grain in messages."""
    round: ClassVar[bool] = True
    """True if all grains are spheres in fact."""
    elongated: ClassVar[bool] = False
    """True if grains have a long axis: the z axis of their body frame."""

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
    def bare_spheres(self) -> float:
        """Surface of a grain that others may touch, in surfaces of its spheres, as their contacts add up: 1."""
        return 1.0

    @property
    def form(self) -> tuple:
        """Numbers that decide the shape beside the diameter: none."""
        return ()

    @property
    def overhang(self) -> float:
        """Distance by which a grain reaches farther than a radius from its centre [m]: 0."""
        return 0.0

    @property
    def reach(self) -> float:
        """Largest distance of a surface from the centre of its grain [m]: r."""
        return self.radius

    @property
    def crowding(self) -> float:
        """Volume that a grain excludes over that of a sphere of its size: 1."""
        return 1.0

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

    @property
    def largest_inertia(self) -> float:
        """Largest moment of inertia [kg m^2]: the same as about any axis."""
        return self.inertia


class EqualGrains(Model):
    """Grains that are all equal, and of a shape that has an orientation."""

    oriented: ClassVar[bool] = True
    varied: ClassVar[bool] = False
    kinds: ClassVar[tuple[Kind, ...]] = ()

    if TYPE_CHECKING:  # each shape states these among its fields, in the order of its docs
        diameter: Length
        density: Density

    @property
    def species(self) -> tuple[Species, ...]:
        """Kind of the grains, which are all equal."""
        return (Species(1.0, self.density, Equal(self.diameter)),)

    def smallest(self) -> tuple[Self, ...]:
        """Grains themselves, which are all equal."""
        return (self,)

    def largest(self) -> tuple[Self, ...]:
        """Grains themselves, which are all equal."""
        return (self,)

    @property
    def mean_density(self) -> float:
        """Mass of all grains over their volume [kg/m^3]."""
        return self.density

    @property
    def radius(self) -> float:
        """Half of d [m]: of a rod the radius of cylinder and ends, of a clump that of its largest sphere."""
        return self.diameter / 2


class Spherocylinders(EqualGrains):
    """Equal rods: cylinders with hemispheres on both ends."""

    noun: ClassVar[str] = "rod"

    shape: Literal["spherocylinder"] = "spherocylinder"
    diameter: Length
    """Diameter d; `d` is a unit of length in all other keys."""
    length: GrainLength
    """Length L from end to end, at least the diameter; an aspect ratio of 3.3 is a length of `3.3 d`."""
    density: Density
    """Density ρ_p of the grains' material."""
    count: Count
    """Number of grains N."""

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
    def finest(self) -> float:
        """Diameter of the smallest rods [m], by which overlaps are judged: that of all."""
        return self.diameter

    @property
    def half_length(self) -> float:
        """Half the length of the segment that the surface is a radius away from [m]: (L - d)/2."""
        return (self.length - self.diameter) / 2

    @property
    def round(self) -> bool:
        """True for rods without length."""
        return self.half_length == 0

    @property
    def elongated(self) -> bool:
        """True unless rods are without length."""
        return self.half_length > 0

    @property
    def bare_spheres(self) -> float:
        """Surface of a grain in surfaces of its spheres, for the time step: 1, as the limit for rods was measured."""
        return 1.0

    @property
    def form(self) -> tuple:
        """Numbers that decide the shape beside the diameter: the half length [m]."""
        return (self.half_length,)

    @property
    def overhang(self) -> float:
        """Distance by which a rod reaches farther than a radius from its centre [m]: the half length."""
        return self.half_length

    @property
    def reach(self) -> float:
        """Largest distance of the surface from the centre [m]: L/2."""
        return self.radius + self.half_length

    @property
    def crowding(self) -> float:
        """Volume that a rod excludes, mean over orientations, over that of a sphere of diameter d.

        Rods of random orientations exclude 4/3 pi d^3 + 2 pi l d^2 + pi/2 l^2 d from one another, l = L - d (Onsager
        1949).
        """
        slender = 2 * self.half_length / self.diameter
        return 1 + 1.5 * slender + 0.375 * slender**2

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

    @property
    def largest_inertia(self) -> float:
        """Largest moment of inertia [kg m^2]: across the rod."""
        return self.inertia


MOST_SPHERES = 8
"""Largest number of spheres of a clump."""


@dataclass(frozen=True)
class BodySphere:
    """Sphere of a clump.

    Attributes:
        centre: Centre in the body frame, whose origin is the centre of mass of the clump [m].
        radius: Radius [m].
    """

    centre: Triple
    radius: float


class Clumps(EqualGrains):
    """Equal rigid clumps of up to eight spheres, which may overlap: any convex or concave grain.

    Mass and moments of inertia are those of the union of the spheres. The body frame has its origin in the centre of
    mass, and its axes are the principal axes: x that of the largest moment of inertia, z that of the smallest, along
    which the clump is long.
    """

    noun: ClassVar[str] = "clump"

    shape: Literal["clump"] = "clump"
    diameter: Length
    """Diameter d of the largest sphere; `d` is a unit of length in all other keys."""
    centres: Annotated[tuple[GrainPoint, ...], Field(min_length=1, max_length=MOST_SPHERES)]
    """Centres of the spheres, in any frame, such as `[[-0.4 d, 0 d, 0 d], [0.4 d, 0 d, 0 d]]`; 1 to 8 of them."""
    # those of equal spheres are left out of what is stored and hashed
    diameters: Annotated[tuple[GrainLength, ...], Field(exclude_if=lambda diameters: not diameters)] = ()
    """Diameters of the spheres in the order of `centres`, the largest of them d; none: all are d."""
    density: Density
    """Density ρ_p of the grains' material."""
    count: Count
    """Number of grains N."""

    @model_validator(mode="after")
    def _is_possible(self):
        refuse(self._faults())
        return self

    def _faults(self) -> Iterator[Fault]:
        d, smallest, n = self.diameter, SMALLEST_PART * self.diameter, len(self.centres)
        if self.diameters:
            if len(self.diameters) != n:
                reason = f"there are {n} centres and {len(self.diameters)} diameters"
                yield Fault("diameters", reason, "state one of each sphere, or leave diameters out: all are then d")
                return
            if not math.isclose(max(self.diameters), d, rel_tol=1e-9):
                reason = (
                    f"the largest sphere has {max(self.diameters) * 1e3:g} mm, and grains.diameter is {d * 1e3:g} mm"
                )
                yield Fault("diameters", reason, "let d be the diameter of the largest sphere")
            if min(self.diameters) < smallest:
                reason = f"a sphere has {min(self.diameters) * 1e3:g} mm, less than d/10"
                yield Fault("diameters", reason, f"use {smallest * 1e3:g} mm or more")
        radii = self._radii
        for i, j in itertools.permutations(range(n), 2):
            apart = math.dist(self.centres[i], self.centres[j])
            if apart + radii[i] <= radii[j] * (1 + 1e-6) and (radii[i] < radii[j] or i > j):
                reason = f"sphere {i + 1} lies within sphere {j + 1} and never touches anything"
                yield Fault("centres", reason, "leave it out")
        linked, reached = {0}, [0]
        while reached:
            i = reached.pop()
            gaps = {j: math.dist(self.centres[i], self.centres[j]) / (radii[i] + radii[j]) for j in range(n)}
            near = {j for j, gap in gaps.items() if gap <= 1 + 1e-6}
            reached += near - linked
            linked |= near
        if len(linked) < n:
            apart = min({*range(n)} - linked) + 1
            yield Fault("centres", f"sphere {apart} is apart from the first one", "let spheres touch or overlap")

    @property
    def _radii(self) -> tuple[float, ...]:
        return tuple(size / 2 for size in self.diameters or (self.diameter,) * len(self.centres))

    @property
    def _union(self) -> UnionProperties:
        return union_properties(self.centres, self._radii)

    @property
    def spheres(self) -> tuple[BodySphere, ...]:
        """Spheres in the body frame, in the order of `centres`."""
        return _in_body_frame(self.centres, self._radii)

    @property
    def finest(self) -> float:
        """Diameter of the smallest sphere [m], by which overlaps are judged."""
        return 2 * min(self._radii)

    @property
    def round(self) -> bool:
        """True for clumps of one sphere."""
        return len(self.centres) == 1

    @property
    def elongated(self) -> bool:
        """True if one principal moment is smaller than the others, so that the clump has a long axis."""
        _, middle, least = self._union.moments
        return least < middle * (1 - 1e-9)

    @property
    def bare_spheres(self) -> float:
        """Sum of the parts of the spheres' surfaces that no other sphere covers: between 1 and their number."""
        return math.fsum(self._union.bare)

    @property
    def form(self) -> tuple:
        """Numbers that decide the shape beside the diameter: centres and radii of the spheres [m]."""
        return self.centres, self._radii

    @property
    def overhang(self) -> float:
        """Distance by which a clump reaches farther than d/2 from its centre of mass [m]."""
        return max(0.0, self.reach - self.radius)

    @property
    def reach(self) -> float:
        """Largest distance of the surface from the centre of mass [m]."""
        return max(math.hypot(*sphere.centre) + sphere.radius for sphere in self.spheres)

    @property
    def crowding(self) -> float:
        """Upper bound of the volume that a clump excludes, mean over orientations, over that of a sphere of diameter d.

        No convex body excludes more than a sphere of its mean width does (Minkowski's inequalities).
        """
        return (_mean_width(self.centres, self._radii) / self.diameter) ** 3

    @property
    def extent(self) -> float:
        """Largest distance between two points of the surface [m]."""
        radii = self._radii
        pairs = itertools.combinations(range(len(radii)), 2)
        apart = (math.dist(self.centres[i], self.centres[j]) + radii[i] + radii[j] for i, j in pairs)
        return max([self.diameter, *apart])

    @property
    def aspect_ratio(self) -> float:
        """Length from end to end over d."""
        return self.extent / self.diameter

    @property
    def volume(self) -> float:
        """Volume of the union of the spheres of one grain [m^3]."""
        return math.pi / 6 * self.diameter**3 if self.round else self._union.volume

    @property
    def equivalent_diameter(self) -> float:
        """Diameter d* of the sphere of the same volume [m]."""
        return self.diameter if self.round else (6 * self.volume / math.pi) ** (1 / 3)

    @property
    def mass(self) -> float:
        """Mass of one grain [kg]."""
        return self.density * math.pi / 6 * self.diameter**3 if self.round else self.density * self.volume

    def _moment(self, axis: int) -> float:
        return 0.4 * self.mass * self.radius**2 if self.round else self.density * self._union.moments[axis]

    @property
    def largest_inertia(self) -> float:
        """Largest principal moment of inertia [kg m^2], about the x axis of the body frame."""
        return self._moment(0)

    @property
    def inertia(self) -> float:
        """Middle principal moment of inertia [kg m^2], about the y axis of the body frame."""
        return self._moment(1)

    @property
    def inertia_axis(self) -> float:
        """Smallest principal moment of inertia [kg m^2], about the z axis of the body frame."""
        return self._moment(2)


@once(256)
def _in_body_frame(centres: tuple[Triple, ...], radii: tuple[float, ...]) -> tuple[BodySphere, ...]:
    union = union_properties(centres, radii)
    branches = [tuple(a - b for a, b in zip(centre, union.centre, strict=True)) for centre in centres]
    turned = [[math.fsum(map(operator.mul, axis, branch)) for axis in union.axes] for branch in branches]
    return tuple(BodySphere((x, y, z), radius) for (x, y, z), radius in zip(turned, radii, strict=True))


_DIRECTIONS = 500


@once(256)
def _mean_width(centres: tuple[Triple, ...], radii: tuple[float, ...]) -> float:
    """Mean over directions of the distance between two parallel planes that enclose spheres [m]."""
    golden, total = math.pi * (3 - math.sqrt(5)), 0.0
    for k in range(_DIRECTIONS):  # on a spiral over the unit sphere
        z = 1 - (2 * k + 1) / _DIRECTIONS
        across = math.sqrt(1 - z * z)
        direction = across * math.cos(k * golden), across * math.sin(k * golden), z
        heights = [sum(map(operator.mul, direction, centre)) for centre in centres]
        highest = max(map(operator.add, heights, radii))
        total += highest - min(map(operator.sub, heights, radii))
    return total / _DIRECTIONS


Grains = Annotated[Spheres | Spherocylinders | Clumps, Field(discriminator="shape")]
