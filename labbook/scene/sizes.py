"""Distributions of grain diameters, from the smallest up to d, the largest."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from labbook.scene.model import Fault, Model
from labbook.scene.quantities import Length, Ratio, listed, percent

SMALLEST_PART = 0.1
"""Smallest diameter, in units of d, that a scene may have: near neighbours are looked for within d."""


_Fractions = Annotated[tuple[Annotated[Ratio, Field(gt=0, le=1)], ...], listed]


@dataclass(frozen=True)
class Equal:
    """Distribution of grains that all have one diameter [m]."""

    diameter: float

    def range(self, largest: float) -> tuple[float, float]:
        """Smallest and largest diameter [m]."""
        return self.diameter, self.diameter

    def mean_cube(self, largest: float) -> float:
        """Mean of the diameter cubed [m^3]."""
        return self.diameter**3

    def moment(self, power: int, largest: float) -> float:
        """Mean of a power of the diameter [m^power]."""
        return self.diameter**power

    def draw(self, rng: np.random.Generator, n: int, largest: float) -> np.ndarray:
        """Array of n times the diameter [m]."""
        return np.full(n, self.diameter)


class Distribution(Model, ABC):
    """Base of distributions of diameters by number, up to the largest.

    The largest diameter d is that of the grains; a distribution does not store it.
    """

    @abstractmethod
    def faults(self, largest: float) -> Iterator[Fault]:
        """Check the distribution.

        Args:
            largest: Largest diameter d [m].

        Yields:
            Reasons against it.
        """

    @abstractmethod
    def range(self, largest: float) -> tuple[float, float]:
        """Give the range of diameters.

        Args:
            largest: Largest diameter d [m].

        Returns:
            Smallest and largest diameter [m].
        """

    @abstractmethod
    def moment(self, power: int, largest: float) -> float:
        """Compute the mean by number of a power of the diameter.

        Args:
            power: Power, 1 to 4.
            largest: Largest diameter d [m].

        Returns:
            Mean [m^power].
        """

    def mean_cube(self, largest: float) -> float:
        """Compute the mean of the diameter cubed, on which mean volume and mass depend.

        Args:
            largest: Largest diameter d [m].

        Returns:
            Mean [m^3].
        """
        return self.moment(3, largest)

    @abstractmethod
    def draw(self, rng: np.random.Generator, n: int, largest: float) -> np.ndarray:
        """Draw diameters.

        Args:
            rng: Random numbers.
            n: Number of grains.
            largest: Largest diameter d [m].

        Returns:
            Diameters in random order [m], shape [n].
        """


class Uniform(Distribution):
    """Uniform number distribution of diameters from `smallest` to d."""

    kind: Literal["uniform"] = "uniform"
    smallest: Length
    """Smallest diameter, from d/10 to below d."""

    def faults(self, largest: float) -> Iterator[Fault]:
        """Faults: a smallest diameter that is not from d/10 to below d."""
        yield from _too_small(self.smallest, largest, "sizes.smallest")

    def range(self, largest: float) -> tuple[float, float]:
        """Smallest and largest diameter [m]."""
        return self.smallest, largest

    def mean_cube(self, largest: float) -> float:
        """Mean of the diameter cubed [m^3]: (b^4 - a^4)/(4 (b - a)), without its cancellation."""
        a, b = self.smallest, largest
        return (a + b) * (a**2 + b**2) / 4

    def moment(self, power: int, largest: float) -> float:
        """Mean of a power n of the diameter [m^n]: (b^(n+1) - a^(n+1))/((n + 1) (b - a)), without its cancellation."""
        a, b = self.smallest, largest
        return math.fsum(a**k * b ** (power - k) for k in range(power + 1)) / (power + 1)

    def draw(self, rng: np.random.Generator, n: int, largest: float) -> np.ndarray:
        """Diameters from a uniform distribution [m], shape [n]."""
        return rng.uniform(self.smallest, largest, n)


class Normal(Distribution):
    """Normal number distribution of diameters, cut at d and symmetrically below the mean."""

    kind: Literal["normal"] = "normal"
    mean: Length
    """Mean diameter, below d."""
    deviation: Length
    """Standard deviation of the diameters before the cut."""

    def faults(self, largest: float) -> Iterator[Fault]:
        """Faults: a mean that leaves no diameters from d/10 to d, or a deviation above d."""
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
        """Mean of the diameter cubed [m^3]: m^3 + 3 m s^2.

        s^2 = sigma^2 (1 - 2 k phi(k)/erf(k/sqrt 2)) is the variance of a normal distribution cut at k = (d - m)/sigma
        on both sides.
        """
        return self.mean**3 + 3 * self.mean * self._variance(largest)

    def _variance(self, largest: float) -> float:
        k = (largest - self.mean) / self.deviation
        density = math.exp(-(k**2) / 2) / math.sqrt(2 * math.pi)
        return self.deviation**2 * (1 - 2 * k * density / math.erf(k / math.sqrt(2)))

    def moment(self, power: int, largest: float) -> float:
        """Mean of a power of the diameter [m^power], from central moments.

        These are s^2 as in `mean_cube`, and 3 sigma^2 s^2 - 2 k^3 phi(k)/erf(k/sqrt 2) sigma^4 of the fourth order, by
        parts.
        """
        m, second, k = self.mean, self._variance(largest), (largest - self.mean) / self.deviation
        density = math.exp(-(k**2) / 2) / math.sqrt(2 * math.pi) / math.erf(k / math.sqrt(2))
        fourth = 3 * self.deviation**2 * second - 2 * k**3 * density * self.deviation**4
        central = (1.0, 0.0, second, 0.0, fourth)
        return math.fsum(math.comb(power, j) * m ** (power - j) * central[j] for j in range(power + 1))

    def draw(self, rng: np.random.Generator, n: int, largest: float) -> np.ndarray:
        """Diameters by the inverse of the cut distribution [m], shape [n]."""
        from scipy.special import erf, erfinv

        half = largest - self.mean
        within = erf(half / self.deviation / math.sqrt(2))
        offset = self.deviation * math.sqrt(2) * erfinv(within * rng.uniform(-1, 1, n))
        return self.mean + np.clip(offset, -half, half)


class LogNormal(Distribution):
    """Log-normal distribution of diameters, cut at `smallest` and at d."""

    kind: Literal["lognormal"] = "lognormal"
    median: Length
    """Median diameter before the cut, between `smallest` and d."""
    spread: Annotated[Ratio, Field(gt=0, le=2)]
    """Standard deviation of the logarithm of the diameter before the cut, ln of the geometric standard deviation."""
    smallest: Length
    """Smallest diameter, from d/10 to below d."""
    by: Literal["number", "mass"] = "number"
    """Weight of the distribution: `number` of grains, or `mass`, as sieves measure it."""

    def faults(self, largest: float) -> Iterator[Fault]:
        """Faults: a smallest diameter that is not from d/10 to below d, or a median that is not between."""
        yield from _too_small(self.smallest, largest, "sizes.smallest")
        if not self.smallest < self.median < largest:
            reason = f"a median of {self.median * 1e3:g} mm is not between the smallest diameter and d"
            use = f"use more than {self.smallest * 1e3:g} mm, below {largest * 1e3:g} mm"
            yield Fault("sizes.median", reason, use)

    def range(self, largest: float) -> tuple[float, float]:
        """Smallest and largest diameter [m]."""
        return self.smallest, largest

    @property
    def _mean_log(self) -> float:
        """Mean of ln(D/m) by number: that by mass less three variances.

        Source: Hatch & Choate, J. Franklin Inst. 207 (1929) 369.
        """
        return math.log(self.median) - (3 * self.spread**2 if self.by == "mass" else 0.0)

    def _cuts(self, largest: float, power: int = 0) -> tuple[float, float]:
        """Cuts in standard deviations from the mean of ln D, weighted by a power of D."""
        middle = self._mean_log + power * self.spread**2
        return (math.log(self.smallest) - middle) / self.spread, (math.log(largest) - middle) / self.spread

    def moment(self, power: int, largest: float) -> float:
        """Mean of a power n of the diameter [m^n].

        It is exp(n mu + n^2 s^2/2) times the ratio of the parts within the cuts of the normal distributions of ln D
        around mu + n s^2 and mu, with the spread s.
        """
        whole = math.exp(power * self._mean_log + (power * self.spread) ** 2 / 2)
        return whole * _normal_part(*self._cuts(largest, power)) / _normal_part(*self._cuts(largest))

    def draw(self, rng: np.random.Generator, n: int, largest: float) -> np.ndarray:
        """Diameters by the inverse of the cut distribution [m], shape [n]."""
        from scipy.special import ndtr, ndtri

        low, high = self._cuts(largest)
        side = -1.0 if low + high > 0 else 1.0  # in the tail above the mean probabilities are near 1
        first, last = sorted((side * low, side * high))
        z = side * ndtri(rng.uniform(ndtr(first), ndtr(last), n))
        return np.clip(np.exp(self._mean_log + self.spread * z), self.smallest, largest)


class SizeTable(Distribution):
    """Classes of grains of one diameter each, with the number or mass fraction of each."""

    kind: Literal["table"] = "table"
    diameters: Annotated[tuple[Length, ...], listed, Field(min_length=1, max_length=1000)]
    """Diameters of the classes, from d/10 to d; the largest is d."""
    # what is not stated is left out of what is stored and hashed
    number_fractions: Annotated[_Fractions | None, Field(exclude_if=lambda fractions: fractions is None)] = None
    """Number fraction of each class; all add up to 1."""
    mass_fractions: Annotated[_Fractions | None, Field(exclude_if=lambda fractions: fractions is None)] = None
    """Mass fraction of each class, instead of `number_fractions`; all add up to 1."""

    def faults(self, largest: float) -> Iterator[Fault]:
        """Faults: diameters out of d/10 to d, a largest one other than d, or fractions that do not add up to 1."""
        yield from _not_up_to(self.diameters, largest)
        fields = {"number_fractions": self.number_fractions, "mass_fractions": self.mass_fractions}
        ways = {key: fractions for key, fractions in fields.items() if fractions is not None}
        if len(ways) != 1:
            reason = "the fractions are stated twice" if ways else "no fractions of the classes are stated"
            yield Fault("sizes", reason, "state one of number_fractions and mass_fractions")
            return
        ((key, fractions),) = ways.items()
        if len(fractions) != len(self.diameters):
            reason = f"{len(fractions)} fractions for {len(self.diameters)} diameters"
            yield Fault(f"sizes.{key}", reason, "state one fraction for each diameter")
        elif abs(math.fsum(fractions) - 1) > 1e-6:
            reason = f"the fractions add up to {percent(math.fsum(fractions), 'g')}"
            yield Fault(f"sizes.{key}", reason, "let them add up to 100 %")

    @property
    def shares(self) -> np.ndarray:
        """Number fractions of the classes, in the order of `diameters`: those by mass go as these times D^3."""
        if self.number_fractions is not None:
            weights = np.array(self.number_fractions)
        else:
            assert self.mass_fractions is not None
            weights = np.array(self.mass_fractions) / (np.array(self.diameters) / max(self.diameters)) ** 3
        return weights / weights.sum()

    def range(self, largest: float) -> tuple[float, float]:
        """Smallest and largest diameter [m]."""
        return min(self.diameters), largest

    def moment(self, power: int, largest: float) -> float:
        """Mean of a power of the diameter [m^power]."""
        return float(self.shares @ np.array(self.diameters) ** power)

    def draw(self, rng: np.random.Generator, n: int, largest: float) -> np.ndarray:
        """Diameters [m], shape [n]: of each class n times its number fraction, within one grain."""
        return np.minimum(_systematic(rng, n, self.diameters, self.shares), largest)


class SizeList(Distribution):
    """Measured diameters, all equally frequent; as many grains as diameters have exactly these."""

    kind: Literal["list"] = "list"
    diameters: Annotated[tuple[Length, ...], listed, Field(min_length=1, max_length=10_000)]
    """Diameters, from d/10 to d; the largest is d."""

    def faults(self, largest: float) -> Iterator[Fault]:
        """Faults: diameters out of d/10 to d, or a largest one other than d."""
        yield from _not_up_to(self.diameters, largest)

    def range(self, largest: float) -> tuple[float, float]:
        """Smallest and largest diameter [m]."""
        return min(self.diameters), largest

    def moment(self, power: int, largest: float) -> float:
        """Mean of a power of the diameter [m^power]."""
        return float(np.mean(np.array(self.diameters) ** power))

    def draw(self, rng: np.random.Generator, n: int, largest: float) -> np.ndarray:
        """Diameters [m], shape [n]: each of the list as often as any other, within one grain."""
        count = len(self.diameters)
        return np.minimum(_systematic(rng, n, self.diameters, np.full(count, 1 / count)), largest)


def _too_small(smallest: float, largest: float, key: str) -> Iterator[Fault]:
    low = SMALLEST_PART * largest
    if not low <= smallest < largest:
        reason = f"a smallest diameter of {smallest * 1e3:g} mm is not from d/10 to below d"
        yield Fault(key, reason, f"use {low * 1e3:g} mm or more, below {largest * 1e3:g} mm")


def _not_up_to(diameters: tuple[float, ...], largest: float) -> Iterator[Fault]:
    """Reasons against diameters of which the largest has to be `largest` [m]."""
    if not math.isclose(max(diameters), largest, rel_tol=1e-9):  # of another unit they may differ by round-off
        reason = f"the largest diameter is {max(diameters) * 1e3:.9g} mm and grains.diameter {largest * 1e3:.9g} mm"
        yield Fault("sizes.diameters", reason, "let grains.diameter be the largest diameter")
    elif min(diameters) < SMALLEST_PART * largest:
        reason = f"a diameter of {min(diameters) * 1e3:g} mm is less than d/10"
        yield Fault("sizes.diameters", reason, f"use {SMALLEST_PART * largest * 1e3:g} mm or more")


def _normal_part(low: float, high: float) -> float:
    """Part of a standard normal distribution from `low` to `high`, without cancellation in its upper tail."""
    from scipy.special import ndtr

    return float(ndtr(-low) - ndtr(-high) if low + high > 0 else ndtr(high) - ndtr(low))


def _systematic(rng: np.random.Generator, n: int, diameters: tuple[float, ...], shares: np.ndarray) -> np.ndarray:
    """Draw n diameters [m] in random order by systematic sampling.

    Each class has n times its share to within one grain (Madow & Madow, Ann. Math. Stat. 15 (1944) 1).
    """
    classes = np.searchsorted(np.cumsum(shares)[:-1], (rng.uniform() + np.arange(n)) / max(n, 1), side="right")
    return rng.permutation(np.array(diameters)[classes])


Sizes = Annotated[Uniform | Normal | LogNormal | SizeTable | SizeList, Field(discriminator="kind")]
