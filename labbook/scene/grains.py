"""Bodies that flow."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field, model_validator

from labbook.scene.model import Fault, Model, refuse
from labbook.scene.quantities import Density, Length, Ratio
from labbook.scene.sizes import SMALLEST_PART, Equal, Sizes


class Kind(Model):
    """One kind of grains in a mixture."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9-]*$", max_length=40)]
    """Name that `contact.between` refers to: lower-case letters, digits and hyphens."""
    share: Annotated[Ratio, Field(gt=0, le=1)]
    """Part of the grains, by number, that is of this kind; all shares add up to 1."""
    diameter: Length | None = None
    """Diameter of all grains of this kind, at most d; none: as `grains.sizes` says, or d."""
    density: Density | None = None
    """Density of this kind's material; none: that of `grains`."""


@dataclass(frozen=True)
class Part:
    """Grains of one kind: their share by number, density [kg/m^3] and the distribution of their diameters."""

    share: float
    density: float
    sizes: Sizes | Equal


class Spheres(Model):
    """Spheres, equal or of several sizes and materials."""

    shape: Literal["sphere"] = "sphere"
    diameter: Length
    """Diameter d, that of the largest grains; `d` is a unit of length in all other keys."""
    density: Density
    """Density ρ_p of the grains' material."""
    count: Annotated[int, Field(ge=1, le=100_000_000, strict=True)]
    """Number of grains N."""
    # what is not there is left out of what is stored and hashed: equal spheres are the same scene as ever
    sizes: Annotated[Sizes | None, Field(exclude_if=lambda sizes: sizes is None)] = None
    """Distribution of diameters, up to d; none: all are d."""
    kinds: Annotated[tuple[Kind, ...], Field(exclude_if=lambda kinds: not kinds)] = ()
    """Kinds of grains, which differ in material or size; none: all are of one."""

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
            yield Fault("kinds", "two kinds have the same name", "name each kind differently")
        total = math.fsum(kind.share for kind in self.kinds)
        if abs(total - 1) > 1e-6:
            yield Fault("kinds", f"the shares add up to {total * 100:g} %", "let them add up to 100 %")
        for kind in self.kinds:
            if kind.diameter is not None and not smallest <= kind.diameter <= d:
                reason = f"the diameter of {kind.name} ({kind.diameter * 1e3:g} mm) is not between d/10 and d"
                yield Fault("kinds", reason, f"use {smallest * 1e3:g} to {d * 1e3:g} mm; d is grains.diameter")
        if all(kind.diameter is not None for kind in self.kinds):
            if self.sizes is not None:
                yield Fault("sizes", "every kind states its own diameter", "leave out one or the other")
            elif max(kind.diameter or 0.0 for kind in self.kinds) < d:
                yield Fault("kinds", "no kind is as large as grains.diameter", "let d be the largest diameter")

    @property
    def varied(self) -> bool:
        """Whether grains differ from one another."""
        return self.sizes is not None or bool(self.kinds)

    @property
    def parts(self) -> tuple[Part, ...]:
        """What the grains are made up of: their kinds; equal grains are of one."""
        rest = self.sizes or Equal(self.diameter)
        if not self.kinds:
            return (Part(1.0, self.density, rest),)
        return tuple(
            Part(kind.share, kind.density or self.density, Equal(kind.diameter) if kind.diameter else rest)
            for kind in self.kinds
        )

    def smallest(self) -> tuple["Spheres", ...]:
        """Equal spheres like the smallest of each kind: the lightest grains, which decide a time step."""
        if not self.varied:
            return (self,)
        return tuple(
            Spheres(diameter=part.sizes.range(self.diameter)[0], density=part.density, count=self.count)
            for part in self.parts
        )

    @property
    def radius(self) -> float:
        """Radius of the largest grains [m]."""
        return self.diameter / 2

    @property
    def mean_cube(self) -> float:
        """Mean of the diameter cubed [m^3], which times pi/6 is the mean volume."""
        if not self.varied:
            return self.diameter**3
        return math.fsum(part.share * part.sizes.mean_cube(self.diameter) for part in self.parts)

    @property
    def mass(self) -> float:
        """Mean mass of a grain [kg]; of every grain, if they are equal."""
        if not self.varied:
            return self.density * math.pi / 6 * self.diameter**3
        cubes = (part.share * part.density * part.sizes.mean_cube(self.diameter) for part in self.parts)
        return math.pi / 6 * math.fsum(cubes)

    @property
    def mean_density(self) -> float:
        """Mass of all grains over their volume [kg/m^3]."""
        return self.mass / (math.pi / 6 * self.mean_cube) if self.kinds else self.density

    @property
    def inertia(self) -> float:
        """Moment of inertia of one of equal grains about any axis through its centre [kg m^2]: (2/5) m r^2."""
        return 0.4 * self.mass * self.radius**2


Grains = Spheres
