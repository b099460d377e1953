"""Rate of an outflow within a window, from the times at which grains left."""

import math
import re
from dataclasses import dataclass

import numpy as np

from labbook.measure.data import RunData
from labbook.measure.measure import Window, after_start_up
from labbook.measure.scales import gap as gap_of
from labbook.measure.series import crossings
from labbook.measure.startup import LONGEST, end_of_start_up
from labbook.stats.correlation import block_mean, correlated_mean
from labbook.stats.pooling import student
from labbook.stats.trend import Trend, trend

FEWEST = 60
"""Grains in a window below which there is no rate and no trend test."""
BLOCKS = 12
"""Blocks of equally many grains, for the trend test and the block error."""
CONFIDENCE = 0.95


@dataclass(frozen=True)
class SteadyFlow:
    """Outflow within a window.

    `rate`: mean masses per second while flowing: mass of the grains but for those after gaps, over the time but for the
    gaps. `error`: its standard error from 12 blocks of equally many grains (11 degrees of freedom); `correlated_error`,
    from the autocorrelation of averages over sqrt(n) grains. Both are checks of the seed-to-seed error; for very
    regular outflow both are too large. `n_effective`: how many independent times between grains would give `error`,
    more than there are where outflow is more regular than chance; `grain_n_effective`: the same of `grain_error`.
    `begin`, `end` [s]; `fraction`: the part of the initial mass discharged at either end. `grain_rate`, `grain_error`:
    the same in grains per second, from the same window; of equal grains they are the same numbers. `heaviest`: what
    part of the initial mass the heaviest grain is, of those that left. `longest`: the longest time between two grains
    [s] that is no gap.
    """

    rate: float
    error: float
    grain_rate: float
    grain_error: float
    heaviest: float
    correlated_error: float
    n_effective: float
    grain_n_effective: float
    trend: Trend
    begin: float
    end: float
    fraction: tuple[float, float]
    grains: int
    gaps: int
    gap_time: float
    longest: float
    plateau: bool = True
    """False if the window was to open at the end of the start-up, and the start-up takes more than half of the
    outflow. The window is then the other half."""

    @property
    def larger_error(self) -> float:
        """The larger of `error` and `correlated_error`; the latter such that Student's interval of it is as wide as the
        normal one."""
        normal = student(CONFIDENCE, math.inf) / student(CONFIDENCE, BLOCKS - 1)
        return float(np.fmax(self.error, normal * self.correlated_error))

    @property
    def precision(self) -> float:
        """Half width of the 95 % interval of `rate`, by what this run alone tells, relative to it: Student's."""
        return student(CONFIDENCE, BLOCKS - 1) * self.larger_error / self.rate


@dataclass(frozen=True)
class TimeWindow:
    """A window between two instants [s] after the opening."""

    start: float
    end: float
    timed: bool = True


def gaps(times: np.ndarray, flow: SteadyFlow) -> tuple[np.ndarray, np.ndarray]:
    """When gaps without flow begin and end within the window [s], each with a grain; `times` as of `steady_flow`."""
    inside = times[(times >= flow.begin) & (times <= flow.end)]
    longer = np.diff(inside) > flow.longest
    return inside[:-1][longer], inside[1:][longer]


def in_gap(at: np.ndarray, times: np.ndarray, flow: SteadyFlow) -> np.ndarray:
    """Which of the instants `at` [s] fall into gaps without flow within the window; `times` as of `steady_flow`."""
    between = zip(*gaps(times, flow), strict=True)
    return np.any([np.zeros(np.shape(at), bool), *((at > before) & (at < after) for before, after in between)], axis=0)


def steady_flow(
    times: np.ndarray, total: int, window: Window, mass: np.ndarray | None = None, gap: float = math.inf
) -> SteadyFlow | None:
    """Rate of outflow within a window of the discharge of `total` grains.

    `times`: ascending crossing times [s], shape [n]; `mass`: of each, in units of the mean mass at the start (None: all
    are equal); `gap` [s]: a longer time without a grain is left out of the rate and reported (Pongo et al. 2022;
    `labbook.measure.scales.gap`). The window runs from one crossing to another, so that its mass is exact. None if it
    holds fewer than 60 grains: too few for a rate.

    The rate is a ratio of two sums, of masses and of times. Its errors are those of the mean of times between grains,
    of each of which the part that belongs to the grain's mass in excess of the mean is taken off.
    """
    mass = np.ones(len(times)) if mass is None else mass
    passed = np.cumsum(mass)
    if window.timed:
        first, last = int(np.searchsorted(times, window.start)), int(np.searchsorted(times, window.end, "right")) - 1
    else:
        first = int(np.searchsorted(passed, window.start * total - 1e-9))
        last = int(np.searchsorted(passed, window.end * total + 1e-9, side="right")) - 1
    if last - first < FEWEST:
        return None
    plateau = True
    if after_start_up(window):
        opening = end_of_start_up(times[: last + 1], passed[: last + 1], gap)
        plateau = opening is not None
        first = max(first, math.ceil(LONGEST * last) if opening is None else opening)
    waits = np.diff(times[first : last + 1])
    flowing = waits <= gap
    intervals, carried = waits[flowing], mass[first + 1 : last + 1][flowing]
    if len(intervals) < FEWEST:
        return None
    n, mean = len(intervals), float(intervals.mean())
    of_grains, waited = block_mean(intervals, BLOCKS).error, intervals
    load = float(carried.mean())
    intervals = intervals - (carried / load - 1) * mean
    blocks = block_mean(intervals, BLOCKS)
    correlated = correlated_mean(block_mean(intervals, math.isqrt(n)).means)
    rate = load / mean
    return SteadyFlow(
        rate=rate,
        error=rate * blocks.error / mean,
        grain_rate=1 / mean,
        grain_error=of_grains / mean**2,
        heaviest=float(mass.max()) / total,
        correlated_error=rate * correlated.error / mean,
        n_effective=_independent(intervals, blocks.error),
        grain_n_effective=_independent(waited, of_grains),
        trend=trend(load / blocks.means),
        begin=float(times[first]),
        end=float(times[last]),
        fraction=(float(passed[first]) / total, float(passed[last]) / total),
        grains=n,
        gaps=int((~flowing).sum()),
        gap_time=float(waits[~flowing].sum()),
        longest=gap,
        plateau=plateau,
    )


def outflow(run: RunData, window: Window) -> tuple[SteadyFlow | None, np.ndarray]:
    """The outflow of a run within a window, None of too few grains, and all times [s] at which grains left, shape [n].

    Raises MeasureError if the run recorded no crossings.
    """
    times, weights = crossings(run)
    return steady_flow(times, len(run.start), window, weights, gap_of(run.scene, window)), times


def too_few(left: int, total: int) -> str:
    """Note on a run without a window, of whose `total` grains `left` have left."""
    return f"too few grains: {left} of {total} left, fewer than {FEWEST} in the window"


TOO_FEW = re.compile(r"too few grains: (\d+) of (\d+) left, fewer than (\d+) in the window")
"""Finds the numbers of such a note."""


def _independent(values: np.ndarray, error: float) -> float:
    """How many independent values with this spread have a mean with this error; NaN for none at all."""
    return (float(values.std(ddof=1)) / error) ** 2 if error else math.nan
