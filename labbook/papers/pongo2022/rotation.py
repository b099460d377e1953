"""What a turning bottom does (Pongo et al. 2022): points that differ in nothing else, over the one at rest; and how
much more the flow of longer grains drops when the bottom begins to turn, and rises as it turns faster (Fig. 3)."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labbook.results import display
from labbook.results.points import PointResult, by_seed, redundant, swept
from labbook.results.study import StudyResults
from labbook.stats import Pooled
from labbook.stats.pooling import student, welch
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


WITH_LENGTH: dict[str, Callable[[Rotation, str], Pooled | None]] = {
    "drop_with_length": drop_of,
    "rise_with_length": rise_of,
}
"""What a curve has that may grow with the length of its grains, by the name of the feature in a statement."""


def neighbours(curves: Sequence[Rotation]) -> Iterator[tuple[Rotation, Rotation, str]]:
    """Each shape with the next longer one, by L/d, at equal D, and again at equal D/d* where that is another pair; and
    at which."""
    for longer in curves:
        shape, wide = aspect_ratio(longer.points[0]), relative_orifice(longer.points[0])
        shorter = [one for one in curves if aspect_ratio(one.points[0]) < shape]
        alike = (
            (f"D = {longer.orifice * 1e3:.4g} mm", [one for one in shorter if one.orifice == longer.orifice]),
            (
                f"D/d* = {wide:.3g}",
                [one for one in shorter if abs(relative_orifice(one.points[0]) / wide - 1) < CLOSE],
            ),
        )
        found: list[Rotation] = []
        for where, group in alike:
            nearest = max(group, key=lambda one: aspect_ratio(one.points[0]), default=None)
            if nearest is not None and not any(nearest is one for one in found):
                found.append(nearest)
                yield nearest, longer, where


def gained(shorter: Rotation, longer: Rotation, quantity: str, feature: str) -> Pooled | None:
    """A feature of `WITH_LENGTH` of the longer grains less that of the shorter, with Welch's interval: their packings
    are no pairs."""
    a, b = (WITH_LENGTH[feature](one, quantity) for one in (shorter, longer))
    if a is None or b is None:
        return None
    n, value, error = min(a.n, b.n), b.value - a.value, math.hypot(a.error, b.error)
    if n < 2:
        return Pooled(value, math.nan, math.inf, n, CONFIDENCE)
    freedom = welch(a.error**2, a.n, b.error**2, b.n)
    return Pooled(value, error, student(CONFIDENCE, freedom) * error, n, CONFIDENCE)
