"""What a turning bottom does (Pongo et al. 2022): points that differ in nothing else, over the one at rest; and how
drop and rise of the flow depend on the length of the grains and on the outlet (Fig. 3)."""

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
"""Of the intervals that statements are held against: two one-sided tests at 5 %."""
_DRAWS, _SEED = 2000, 0


@dataclass(frozen=True)
class Extreme:
    """Where a curve is lowest: frequency [Hz] and the ends of its interval."""

    frequency: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Rotation:
    """Points of one shape and outlet, slowest bottom first. `missing`: f [Hz] of those without any run."""

    points: tuple[PointResult, ...]
    missing: tuple[float, ...] = ()

    @property
    def frequencies(self) -> np.ndarray:
        """f [Hz] of the points, shape [n]."""
        return np.array([_frequency(one) for one in self.points])

    @property
    def unfinished(self) -> tuple[float, ...]:
        """f [Hz] of the points that lack runs, ascending."""
        return tuple(sorted([*self.missing, *(_frequency(one) for one in self.points if one.partial)]))

    @cached_property
    def shape(self) -> str:
        """`spheres`, or `rods, L/d = 3.33`."""
        return shape_of(self.points[0])

    @property
    def label(self) -> str:
        """What the points have in common beside their shape."""
        at = self.points[0].at
        return display.label(at, {name for name in at if name == ROTATION or name.startswith("grains.")} | _OF_SHAPE)

    @property
    def orifice(self) -> float:
        """D [m]."""
        return self.points[0].orifice

    def has(self, quantity: str) -> bool:
        """Whether the quantity was measured at two frequencies at least."""
        return sum(quantity in one.pooled for one in self.points) > 1

    @property
    def flows(self) -> bool:
        """Whether any point has a flow rate."""
        return any(FLOW in one.pooled for one in self.points)

    @property
    def rated(self) -> bool:
        """Whether a flow rate with the bottom turning can be divided by that at rest."""
        return any(self.ratio(FLOW, k) is not None for k in range(1, len(self.points)))

    def ratio(self, quantity: str, index: int, over: int = 0) -> Pooled | None:
        """Quantity at a point over that at another one (at rest, unless said otherwise), paired by seeds.

        None where no seed has both.
        """
        above, below = (by_seed(self.points[k], quantity) for k in (index, over))
        seeds = sorted(set(above) & set(below))
        if not seeds:
            return None
        return paired_ratio([above[s] for s in seeds], [below[s] for s in seeds], CONFIDENCE)

    def lowest(self, quantity: str = FLOW, first: int = 0, before_last: bool = False) -> int | None:
        """Index of the point at which the quantity is smallest in size, as v_z is negative, from the index `first` on
        and, if asked for, before the fastest; None with fewer than three frequencies."""
        known = [k for k, one in enumerate(self.points) if quantity in one.pooled]
        if len(known) < 3:
            return None
        among = [k for k in known if k >= first and not (before_last and k == known[-1])]
        return min(among, key=lambda k: abs(self.points[k].pooled[quantity].value))

    def minimum(self, quantity: str = FLOW) -> Extreme | None:
        """Where the quantity is smallest in size; None with fewer than three frequencies or two seeds that have all.

        The interval holds 90 % of the minima of curves drawn from the multivariate Student distribution of the means,
        whose covariance is that of the seeds: a seed that flows fast does so at all frequencies.
        """
        lowest = self.lowest(quantity)
        known = [one for one in self.points if quantity in one.pooled]
        values = [by_seed(one, quantity) for one in known]
        seeds = sorted(set.intersection(*map(set, values))) if values else []
        if lowest is None or len(seeds) < 2:
            return None
        table, n = np.array([[one[s] for one in values] for s in seeds]), len(seeds)
        rng, mean = np.random.default_rng(_SEED), table.mean(axis=0)
        drawn = rng.standard_normal((_DRAWS, n)) @ (table - mean) / math.sqrt(n * (n - 1))
        curves = mean + drawn / np.sqrt(rng.chisquare(n - 1, (_DRAWS, 1)) / (n - 1))
        found = np.array([_frequency(one) for one in known])[abs(curves).argmin(axis=1)]
        tail = (1 - CONFIDENCE) / 2
        low, high = np.quantile(found, [tail, 1 - tail], method="nearest")
        return Extreme(float(self.frequencies[lowest]), float(low), float(high))


_OF_SHAPE = {"contact.normal_stiffness"}
"""Swept along with the shape, for the law's sake."""


def rotations(points: Sequence[PointResult], missing: Sequence[Mapping[str, float | str]] = ()) -> tuple[Rotation, ...]:
    """Points in groups that differ in the rotation of the bottom only and have one at rest, two points at least; in the
    order of shape (spheres, then longer and longer rods) and orifice. `missing`: where points without any run are."""
    groups: dict[tuple, list[PointResult]] = {}
    for one in points:
        if ROTATION in one.at:
            groups.setdefault(_but_turning(one.at), []).append(one)
    lacking: dict[tuple, list[float]] = {}
    for at in missing:
        if ROTATION in at:
            lacking.setdefault(_but_turning(at), []).append(abs(float(at[ROTATION])))
    found = [
        Rotation(tuple(sorted(group, key=_frequency)), tuple(lacking.get(key, ())))
        for key, group in groups.items()
        if len(group) > 1 and min(map(_frequency, group)) == 0
    ]
    return tuple(sorted(found, key=lambda one: (aspect_ratio(one.points[0]), one.orifice)))


def rotations_of(results: StudyResults) -> tuple[Rotation, ...]:
    """Points of a study that differ in the rotation of the bottom only."""
    extra = redundant(results.study.points)
    return rotations(results.points, [swept(point, extra) for point in results.missing])


def _but_turning(at: Mapping[str, float | str]) -> tuple:
    return tuple((name, value) for name, value in at.items() if name != ROTATION)


def shape_of(result: PointResult) -> str:
    """`spheres`, or `rods, L/d = 3.33`."""
    ratio = aspect_ratio(result)
    return "spheres" if ratio == 1 else f"rods, L/d = {ratio:.3g}"


def turning_at(result: PointResult) -> str:
    """`f = 0.32 Hz`."""
    return display.setting(ROTATION, result.at[ROTATION])


def aspect_ratio(result: PointResult) -> float:
    """L/d of the grains; 1 of spheres."""
    return result.point.scene.grains.aspect_ratio


def relative_orifice(result: PointResult) -> float:
    """D/d*: the orifice in diameters of the sphere of a grain's volume."""
    return result.orifice / result.point.scene.grains.equivalent_diameter


def _frequency(result: PointResult) -> float:
    return abs(float(result.at[ROTATION]))


CLOSE = 0.03
"""Relative difference within which two D/d* count as one."""


def drop_of(curve: Rotation, quantity: str) -> Pooled | None:
    """1 less the smallest ratio to that at rest, while turning; None with fewer than three frequencies or no pair of
    seeds."""
    if curve.lowest(quantity) is None:
        return None
    slowest = curve.lowest(quantity, first=1)
    assert slowest is not None
    one = curve.ratio(quantity, slowest)
    return one and Pooled(1 - one.value, one.error, one.half_width, one.n, one.confidence)


def rise_of(curve: Rotation, quantity: str) -> Pooled | None:
    """The quantity at the fastest rotation over the smallest at slower ones; None as for `drop_of`."""
    slowest = curve.lowest(quantity, first=1, before_last=True)
    return None if slowest is None else curve.ratio(quantity, len(curve.points) - 1, slowest)


@dataclass(frozen=True)
class Dependence:
    """Dependence of a drop or a rise on the curve: the logarithm `of` each, and the slope `by` one of FACTORS."""

    of: Callable[[Rotation, str], Pooled | None]
    sign: float
    by: str

    def value(self, curve: Rotation, quantity: str) -> float | None:
        """ln(Q(0)/Q_min) of a drop, ln(Q_max f/Q_min) of a rise; None where a curve has none."""
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
"""By the name of the feature in a statement."""


def trend(curves: Sequence[Rotation], quantity: str, feature: str) -> tuple[Pooled, tuple[Rotation, ...]]:
    """A slope of TRENDS, of a plane by those of FACTORS that vary, through all curves that have the number; and these.

    Raises ValueError, which says what is lacking.
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
    """A positive number over the fastest turning bottom over that over the slowest, along a straight line of its
    logarithm against f, with its standard error and the ends of its interval. Raises ValueError for too few places."""
    (slope,) = slopes([[f] for f in frequencies], np.log(values).tolist(), CONFIDENCE)
    span = max(frequencies) - min(frequencies)
    ratio, low, high = (math.exp(span * one) for one in (slope.value, slope.low, slope.high))
    return ratio, ratio * span * slope.error, low, high
