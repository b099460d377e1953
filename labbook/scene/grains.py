"""Bodies that flow."""

import math
from typing import Annotated, Literal

from pydantic import Field

from labbook.scene.model import Model
from labbook.scene.quantities import Density, Length


class Spheres(Model):
    """Equal spheres."""

    shape: Literal["sphere"] = "sphere"
    diameter: Length
    """Diameter d; `d` is a unit of length in all other keys."""
    density: Density
    """Density ρ_p of the grains' material."""
    count: Annotated[int, Field(ge=1, le=100_000_000, strict=True)]
    """Number of grains N."""

    @property
    def radius(self) -> float:
        """Radius [m]."""
        return self.diameter / 2

    @property
    def mass(self) -> float:
        """Mass of one grain [kg]."""
        return self.density * math.pi / 6 * self.diameter**3

    @property
    def inertia(self) -> float:
        """Moment of inertia of one grain about any axis through its centre [kg m^2]: (2/5) m r^2."""
        return 0.4 * self.mass * self.radius**2


Grains = Spheres
