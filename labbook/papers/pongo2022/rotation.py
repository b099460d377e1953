"""Effect of a rotating bottom (Pongo et al. 2022): points that differ only in rotation, over the one at rest; and the
dependence of drop and rise of the flow on the length of the grains and on the outlet (Fig. 3)."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labbook.results import display
from labbook.results.points import PointResult, by_seed, redundant, swept
from labbook.results.study import StudyResults
from labbook.stats import Pooled
from labbook.stats.linear import slopes
from labbook.stats.ratio import paired_ratio

ROTATION = "container.rotation"
FLOW = "grain_rate"
CONFIDENCE = 0.9
"""Confidence of the intervals that statements are compared with: two one-sided tests at 5 %."""
_DRAWS, _SEED = 2000, 0


@dataclass(frozen=True)
class Extreme:
    """Minimum of a curve: frequency [Hz] and the ends of its interval."""

    frequency: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Rotation:
    """Points of one shape and outlet, in the order of frequency. `missing`: f [Hz] of points without any run."""

    points: tuple[PointResult, ...]
    missing: tuple[float, ...] = ()

    @property
    def frequencies(self) -> np.ndarray:
        """f [Hz] of the points, shape [n]."""
        return np.array([_frequency(point) for point in self.points])

    @property
    def unfinished(self) -> tuple[float, ...]:
        """f [Hz] of the points that lack runs, ascending."""
        return tuple(sorted([*self.missing, *(_frequency(point) for point in self.points if point.partial)]))

    @cached_property
    def shape(self) -> str:
        """Name of the shape: `spheres`, or `rods, L/d = 3.33`."""
        return shape_of(self.points[0])

    @property
    def label(self) -> str:
        """Common settings of the points, besides their shape."""
        at = self.points[0].at
        return display.label(at, {name for name in at if name == ROTATION or name.startswith("grains.")} | _OF_SHAPE)

    @property
    def orifice(self) -> float:
        """Orifice D [m]."""
        return self.points[0].orifice

    def has(self, quantity: str) -> bool:
        """True if the quantity was measured at two frequencies at least."""
        return sum(quantity in point.pooled for point in self.points) > 1

    @property
    def flows(self) -> bool:
        """True if any point has a flow rate."""
        return any(FLOW in point.pooled for point in self.points)

    @property
    def rated(self) -> bool:
        """True if a flow rate with the bottom rotating can be divided by that at rest."""
        return any(self.ratio(FLOW, k) is not None for k in range(1, len(self.points)))

    def ratio(self, quantity: str, index: int, reference: int = 0) -> Pooled | None:
        """Quantity at a point over that at another one, paired by seeds.

        Args:
            quantity: Name of the quantity.
            index: Index of the point.
            reference: Index of the other point; 0: at rest.

        Returns:
            Ratio with its interval of CONFIDENCE; None if no seed has both.
        """
        above, below = (by_seed(self.points[k], quantity) for k in (index, reference))
        seeds = sorted(set(above) & set(below))
        if not seeds:
            return None
        return paired_ratio([above[s] for s in seeds], [below[s] for s in seeds], CONFIDENCE)

    def lowest(self, quantity: str = FLOW, first: int = 0, before_last: bool = False) -> int | None:
        """Find the point at which the quantity has its smallest absolute value.

        Args:
            quantity: Name of the quantity; the absolute value matters for v_z, which is negative.
            first: First index to consider.
            before_last: Leave out the fastest rotation.

        Returns:
            Index of the point; None with fewer than three frequencies.
        """
        measured = [k for k, point in enumerate(self.points) if quantity in point.pooled]
        if len(measured) < 3:
            return None
        among = [k for k in measured if k >= first and not (before_last and k == measured[-1])]
        return min(among, key=lambda k: abs(self.points[k].pooled[quantity].value))

    def minimum(self, quantity: str = FLOW) -> Extreme | None:
        """Minimum of the absolute value of a quantity, with the interval of its frequency.

        The interval holds 90 % of the minima of curves drawn from the multivariate Student distribution of the means.
        Its covariance is that of the seeds: a seed that flows fast does so at all frequencies.

        Returns:
            The minimum; None with fewer than three frequencies, or two seeds that have all.
        """
        lowest = self.lowest(quantity)
        measured = [point for point in self.points if quantity in point.pooled]
        values = [by_seed(point, quantity) for point in measured]
        seeds = sorted(set.intersection(*map(set, values))) if values else []
        if lowest is None or len(seeds) < 2:
            return None
        table, n = np.array([[numbers[s] for numbers in values] for s in seeds]), len(seeds)
        rng, mean = np.random.default_rng(_SEED), table.mean(axis=0)
        # random combinations of the seeds' deviations have the covariance of the mean; chi^2 makes them Student's
        deviations = rng.standard_normal((_DRAWS, n)) @ (table - mean) / math.sqrt(n * (n - 1))
        curves = mean + deviations / np.sqrt(rng.chisquare(n - 1, (_DRAWS, 1)) / (n - 1))
        minima = np.array([_frequency(point) for point in measured])[abs(curves).argmin(axis=1)]
        tail = (1 - CONFIDENCE) / 2
        low, high = np.quantile(minima, [tail, 1 - tail], method="nearest")
        return Extreme(float(self.frequencies[lowest]), float(low), float(high))


_OF_SHAPE = {"contact.normal_stiffness"}
"""Keys that are swept along with the shape: the stiffness of the law scales with the grains."""


def rotations(points: Sequence[PointResult], missing: Sequence[Mapping[str, float | str]] = ()) -> tuple[Rotation, ...]:
    """Group points that differ in the rotation of the bottom only, at least two, of which one is at rest.

    Args:
        points: The points.
        missing: Settings of points without any run.

    Returns:
        Curves in the order of shape (spheres, then rods by length) and orifice.
    """
    groups: dict[tuple, list[PointResult]] = {}
    for point in points:
        if ROTATION in point.at:
            groups.setdefault(_but_turning(point.at), []).append(point)
    lacking: dict[tuple, list[float]] = {}
    for at in missing:
        if ROTATION in at:
            lacking.setdefault(_but_turning(at), []).append(abs(float(at[ROTATION])))
    curves = [
        Rotation(tuple(sorted(group, key=_frequency)), tuple(lacking.get(key, ())))
        for key, group in groups.items()
        if len(group) > 1 and min(map(_frequency, group)) == 0
    ]
    return tuple(sorted(curves, key=lambda curve: (aspect_ratio(curve.points[0]), curve.orifice)))


def rotations_of(results: StudyResults) -> tuple[Rotation, ...]:
    """Group the points of a study that differ in the rotation of the bottom only; see `rotations`."""
    extra = redundant(results.study.points)
    return rotations(results.points, [swept(point, extra) for point in results.missing])


def _but_turning(at: Mapping[str, float | str]) -> tuple:
    return tuple((name, value) for name, value in at.items() if name != ROTATION)


def shape_of(result: PointResult) -> str:
    """Name of the shape: `spheres`, or `rods, L/d = 3.33`."""
    ratio = aspect_ratio(result)
    return "spheres" if ratio == 1 else f"rods, L/d = {ratio:.3g}"


def turning_at(result: PointResult) -> str:
    """Rotation of a point in words: `f = 0.32 Hz`."""
    return display.setting(ROTATION, result.at[ROTATION])


def aspect_ratio(result: PointResult) -> float:
    """L/d of the grains; 1 of spheres."""
    return result.point.scene.grains.aspect_ratio


def relative_orifice(result: PointResult) -> float:
    """D/d*: orifice over the diameter of the sphere of a grain's volume."""
    return result.orifice / result.point.scene.grains.equivalent_diameter


def _frequency(result: PointResult) -> float:
    return abs(float(result.at[ROTATION]))


CLOSE = 0.03
"""Relative difference within which two D/d* count as one."""


def drop_of(curve: Rotation, quantity: str) -> Pooled | None:
    """1 less the smallest ratio to the value at rest, while rotating; None with too few frequencies or pairs."""
    if curve.lowest(quantity) is None:
        return None
    slowest = curve.lowest(quantity, first=1)
    assert slowest is not None
    ratio = curve.ratio(quantity, slowest)
    return ratio and Pooled(1 - ratio.value, ratio.error, ratio.half_width, ratio.n, ratio.confidence)


def rise_of(curve: Rotation, quantity: str) -> Pooled | None:
    """The quantity at the fastest rotation over the smallest at slower ones; None as for `drop_of`."""
    slowest = curve.lowest(quantity, first=1, before_last=True)
    return None if slowest is None else curve.ratio(quantity, len(curve.points) - 1, slowest)


@dataclass(frozen=True)
class Dependence:
    """Dependence of a drop or a rise on a property of the curves.

    Args:
        of: Drop or rise of a quantity on a curve.
        sign: Sign of the logarithm: negative for a drop.
        by: Property, one of FACTORS.
    """

    of: Callable[[Rotation, str], Pooled | None]
    sign: float
    by: str

    def value(self, curve: Rotation, quantity: str) -> float | None:
        """ln(Q(0)/Q_min) of a drop, ln(Q_max f/Q_min) of a rise; None if a curve has none."""
        size = self.of(curve, quantity)
        if size is None:
            return None
        ratio = size.value if self.sign > 0 else 1 - size.value
        return self.sign * math.log(ratio) if ratio > 0 else None


FACTORS: Mapping[str, Callable[[Rotation], float]] = {
    "length": lambda curve: aspect_ratio(curve.points[0]),
    "orifice": lambda curve: curve.orifice,
}
"""Factors of drops and rises: L/d, and D [m]."""
TRENDS: Mapping[str, Dependence] = {
    f"{name}_with_{factor}": Dependence(of, sign, factor)
    for name, of, sign in (("drop", drop_of, -1.0), ("rise", rise_of, 1.0))
    for factor in FACTORS
}
"""Dependences by name of the feature in a statement."""


def trend(curves: Sequence[Rotation], quantity: str, feature: str) -> tuple[Pooled, tuple[Rotation, ...]]:
    """Fit a slope of TRENDS: that of a plane in all varied FACTORS, through all curves with the number.

    Returns:
        The slope, and the curves used.

    Raises:
        ValueError: A factor does not vary, or there are too few curves; the message names the lack.
    """
    by, numbers = TRENDS[feature].by, [TRENDS[feature].value(curve, quantity) for curve in curves]
    used = tuple(curve for curve, number in zip(curves, numbers, strict=True) if number is not None)
    table = {name: [of(curve) for curve in used] for name, of in FACTORS.items()}
    varied = [name for name, values in table.items() if len(set(values)) > 1]
    if by not in varied:
        raise ValueError(f"grains or outlets of several sizes are needed, and {by} does not vary")
    rows = list(zip(*(table[name] for name in varied), strict=True))
    plane = slopes(rows, [number for number in numbers if number is not None], CONFIDENCE)
    return plane[varied.index(by)], used


def along_rotation(frequencies: Sequence[float], values: Sequence[float]) -> tuple[float, float, float, float]:
    """Ratio of a positive number at the fastest rotation to that at the slowest, by a line through its logarithms.

    Returns:
        The ratio, its standard error, and the ends of its interval.

    Raises:
        ValueError: There are too few places.
    """
    (slope,) = slopes([[f] for f in frequencies], np.log(values).tolist(), CONFIDENCE)
    span = max(frequencies) - min(frequencies)
    ratio, low, high = (math.exp(span * exponent) for exponent in (slope.value, slope.low, slope.high))
    return ratio, ratio * span * slope.error, low, high
