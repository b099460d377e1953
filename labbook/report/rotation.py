"""What a turning bottom does: points that differ in nothing else, over the one at rest (Pongo et al. 2022)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labbook.report import display
from labbook.report.points import PointResult
from labbook.stats import Pooled
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


def _but_turning(at: Mapping[str, float | str]) -> tuple:
    return tuple((name, value) for name, value in at.items() if name != ROTATION)


def by_seed(result: PointResult, quantity: str) -> dict[int, float]:
    """The quantity of every run of a point that counts."""
    found = {run.seed: run.measured[quantity].value for run in result.runs if quantity in run.measured}
    diverged = {run.seed for run in result.runs if run.outcome == "diverged"}
    return {seed: value for seed, value in found.items() if math.isfinite(value) and seed not in diverged}


def shape_of(result: PointResult) -> str:
    """`spheres`, or `rods, L/d = 3.33`."""
    ratio = aspect_ratio(result)
    return "spheres" if ratio == 1 else f"rods, L/d = {ratio:.3g}"


def turning_at(result: PointResult) -> str:
    """`f = 0.32 Hz`."""
    return display.setting(ROTATION, result.at[ROTATION])


def aspect_ratio(result: PointResult) -> float:
    """L/d of the grains; 1 of spheres."""
    return float(getattr(result.point.scene.grains, "aspect_ratio", 1.0))


def relative_orifice(result: PointResult) -> float:
    """D/d*: the orifice in diameters of the sphere of a grain's volume."""
    return result.orifice / result.point.scene.grains.equivalent_diameter


def _frequency(result: PointResult) -> float:
    return abs(float(result.at[ROTATION]))
