"""Bodies that flow: all grains of a scene are alike.

Every shape knows its mass, its inertia and the segment that its surface is at a radius from: that of a sphere has the
half length 0, and so a sphere is the spherocylinder whose length is its diameter.
"""

import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field, model_validator

from labbook.scene.model import Fault, Model, refuse
from labbook.scene.quantities import Density, GrainLength, Length

Count = Annotated[int, Field(ge=1, le=100_000_000, strict=True)]


class Spheres(Model):
    """Equal spheres."""

    shape: Literal["sphere"] = "sphere"
    diameter: Length
    """Diameter d; `d` is a unit of length in all other keys."""
    density: Density
    """Density ρ_p of the grains' material."""
    count: Count
    """Number of grains N."""

    @property
    def radius(self) -> float:
        """Radius [m]."""
        return self.diameter / 2

    @property
    def half_length(self) -> float:
        """Half the length of the segment at the heart of the grain [m]: a point, 0."""
        return 0.0

    @property
    def volume(self) -> float:
        """Volume of one grain [m^3]."""
        return math.pi / 6 * self.diameter**3

    @property
    def equivalent_diameter(self) -> float:
        """Diameter d* of the sphere of the same volume [m]: d itself."""
        return self.diameter

    @property
    def mass(self) -> float:
        """Mass of one grain [kg]."""
        return self.density * math.pi / 6 * self.diameter**3

    @property
    def inertia(self) -> float:
        """Moment of inertia of one grain about any axis through its centre [kg m^2]: (2/5) m r^2."""
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
    def radius(self) -> float:
        """Radius of cylinder and ends [m]."""
        return self.diameter / 2

    @property
    def half_length(self) -> float:
        """Half the length of the segment that the surface is a radius away from [m]: (L - d)/2."""
        return (self.length - self.diameter) / 2

    @property
    def aspect_ratio(self) -> float:
        """L/d."""
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
        """Of the cylinder and of both ends together [kg]."""
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
