"""Distributions of grain diameters, from the smallest up to d, the largest."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from labbook.scene.model import Fault, Model
from labbook.scene.quantities import Length

SMALLEST_PART = 0.1
"""Smallest diameter, in units of d, that a scene may have: near neighbours are looked for within d."""


@dataclass(frozen=True)
class Equal:
    """All are of this diameter [m]."""

    diameter: float

    def range(self, largest: float) -> tuple[float, float]:
        """Smallest and largest diameter [m]."""
        return self.diameter, self.diameter

    def mean_cube(self, largest: float) -> float:
        """Mean of the diameter cubed [m^3]."""
        return self.diameter**3

    def draw(self, rng: np.random.Generator, n: int, largest: float) -> np.ndarray:
        """n diameters [m]."""
        return np.full(n, self.diameter)


class Uniform(Model):
    """Uniform number distribution of diameters from `smallest` to d."""

    kind: Literal["uniform"] = "uniform"
    smallest: Length
    """Smallest diameter, from d/10 to below d."""

    def faults(self, largest: float) -> Iterator[Fault]:
        """What is wrong with it where the largest diameter is `largest` [m]."""
        low = SMALLEST_PART * largest
        if not low <= self.smallest < largest:
            reason = f"a smallest diameter of {self.smallest * 1e3:g} mm is not from d/10 to below d"
            yield Fault("sizes.smallest", reason, f"use {low * 1e3:g} mm or more, below {largest * 1e3:g} mm")

    def range(self, largest: float) -> tuple[float, float]:
        """Smallest and largest diameter [m]."""
        return self.smallest, largest

    def mean_cube(self, largest: float) -> float:
        """Mean of the diameter cubed [m^3]: (b^4 - a^4)/(4 (b - a)), without its cancellation."""
        a, b = self.smallest, largest
        return (a + b) * (a**2 + b**2) / 4

    def draw(self, rng: np.random.Generator, n: int, largest: float) -> np.ndarray:
        """n diameters [m]."""
        return rng.uniform(self.smallest, largest, n)


class Normal(Model):
    """Normal number distribution of diameters, cut at d and symmetrically below the mean."""

    kind: Literal["normal"] = "normal"
    mean: Length
    """Mean diameter, below d."""
    deviation: Length
    """Standard deviation of the diameters before the cut."""

    def faults(self, largest: float) -> Iterator[Fault]:
        """What is wrong with it where the largest diameter is `largest` [m]."""
        low = (1 + SMALLEST_PART) / 2 * largest
        if not low <= self.mean < largest:
            reason = f"a mean of {self.mean * 1e3:g} mm, cut symmetrically at d, leaves no diameters from d/10 to d"
            yield Fault("sizes.mean", reason, f"use {low * 1e3:g} mm or more, below {largest * 1e3:g} mm")
        if self.deviation > largest:
            reason = f"a deviation of {self.deviation * 1e3:g} mm is more than d"
            yield Fault("sizes.deviation", reason, "use kind: uniform, which is almost the same")

    def range(self, largest: float) -> tuple[float, float]:
        """Smallest and largest diameter [m]."""
        return 2 * self.mean - largest, largest

    def mean_cube(self, largest: float) -> float:
        """Mean of the diameter cubed [m^3]: m^3 + 3 m s^2, where s^2 = sigma^2 (1 - 2 k phi(k)/erf(k/sqrt 2)) is the
        variance of a normal distribution cut at k = (d - m)/sigma on both sides."""
        k = (largest - self.mean) / self.deviation
        density = math.exp(-(k**2) / 2) / math.sqrt(2 * math.pi)
        variance = self.deviation**2 * (1 - 2 * k * density / math.erf(k / math.sqrt(2)))
        return self.mean**3 + 3 * self.mean * variance

    def draw(self, rng: np.random.Generator, n: int, largest: float) -> np.ndarray:
        """n diameters [m]."""
        from scipy.special import erf, erfinv

        half = largest - self.mean
        within = erf(half / self.deviation / math.sqrt(2))
        offset = self.deviation * math.sqrt(2) * erfinv(within * rng.uniform(-1, 1, n))
        return self.mean + np.clip(offset, -half, half)


Sizes = Annotated[Uniform | Normal, Field(discriminator="kind")]
