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
    """Outflow within a window, without its gaps.

    `error` and `correlated_error` are checks of the seed-to-seed error. For very regular outflow both are too large.

    Attributes:
        rate: Outflow in mean masses per second [1/s]: mass of all grains except those that end gaps, over the time
            without gaps.
        error: Standard error of `rate` from 12 blocks of equally many grains (11 degrees of freedom) [1/s].
        grain_rate: Grains per second [1/s] in the same window; equal to `rate` for equal grains.
        grain_error: Standard error of `grain_rate` [1/s].
        heaviest: Mass of the heaviest grain that left, over the initial mass.
        correlated_error: Standard error of `rate` from the autocorrelation of averages over sqrt(n) grains [1/s].
        n_effective: Number of independent times between grains that would give `error`; above the number of grains if
            the outflow is more regular than independent times would make it.
        grain_n_effective: The same number for `grain_error`.
        trend: Trend of the rate across the window.
        begin: Time of the first crossing [s].
        end: Time of the last crossing [s].
        fraction: Fractions of the initial mass discharged at begin and end.
        grains: Number of grains that count.
        gaps: Number of gaps.
        gap_time: Sum of the gaps [s].
        longest: Longest time between two grains that is no gap [s].
        plateau: False if the window was to open at the end of the start-up, and the start-up takes more than half of
            the outflow. The window is then the other half.
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

    @property
    def larger_error(self) -> float:
        """Larger of `error` and `correlated_error` [1/s].

        The latter is scaled so that Student's interval of it is as wide as the normal one.
        """
        normal = student(CONFIDENCE, math.inf) / student(CONFIDENCE, BLOCKS - 1)
        return float(np.fmax(self.error, normal * self.correlated_error))

    @property
    def precision(self) -> float:
        """Half width of Student's 95 % interval of `rate` from this run alone, relative to `rate`."""
        return student(CONFIDENCE, BLOCKS - 1) * self.larger_error / self.rate


@dataclass(frozen=True)
class TimeWindow:
    """A window between two instants [s] after the opening."""

    start: float
    end: float
    timed: bool = True


def gaps(times: np.ndarray, flow: SteadyFlow) -> tuple[np.ndarray, np.ndarray]:
    """List begins and ends [s] of the gaps within the window, each at a crossing; `times` as in `steady_flow`."""
    inside = times[(times >= flow.begin) & (times <= flow.end)]
    longer = np.diff(inside) > flow.longest
    return inside[:-1][longer], inside[1:][longer]


def in_gap(at: np.ndarray, times: np.ndarray, flow: SteadyFlow) -> np.ndarray:
    """Mask of the instants `at` [s] in gaps within the window; `times` as in `steady_flow`."""
    between = zip(*gaps(times, flow), strict=True)
    return np.any([np.zeros(np.shape(at), bool), *((at > before) & (at < after) for before, after in between)], axis=0)


def steady_flow(
    times: np.ndarray, total: int, window: Window, mass: np.ndarray | None = None, gap: float = math.inf
) -> SteadyFlow | None:
    """Compute the rate of outflow within a window.

    The window runs from one crossing to another, so that its mass is exact. The rate is a ratio of two sums, of masses
    and of times. Its errors are those of the mean time between grains, after subtracting from each time the share of
    the grain's excess mass (the linearised error of a ratio).

    Args:
        times: Ascending times of crossings [s], shape [n].
        total: Number of grains at the opening.
        window: The window.
        mass: Mass of each grain in units of the mean mass at the opening, shape [n]; None: all are equal.
        gap: Longest time without a grain that counts as flow [s]; longer ones are left out of the rate and reported
            (Pongo et al. 2022; `labbook.measure.scales.gap`).

    Returns:
        The outflow; None if fewer than 60 grains left within the window.
    """
    mass = np.ones(len(times)) if mass is None else mass
    passed = np.cumsum(mass)
    if window.timed:
        first, last = int(np.searchsorted(times, window.start)), int(np.searchsorted(times, window.end, "right")) - 1
    else:
        # 1e-9 of a grain: products such as 0.6 * total, and sums of masses, are not exact
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
    # Each time between grains belongs to the grain that ends it: a gap is left out together with that grain.
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
    """Compute the outflow of a run within a window.

    Returns:
        The outflow, None for too few grains; and the ascending times of all crossings [s], shape [n].

    Raises:
        MeasureError: The run recorded no crossings.
    """
    times, weights = crossings(run)
    return steady_flow(times, len(run.start), window, weights, gap_of(run.scene, window)), times


def too_few(left: int, total: int) -> str:
    """Write the note on a run without a window, of whose `total` grains `left` have left."""
    return f"too few grains: {left} of {total} left, fewer than {FEWEST} in the window"


TOO_FEW = re.compile(r"too few grains: (\d+) of (\d+) left, fewer than (\d+) in the window")
"""Pattern of such a note with its numbers."""


def _independent(values: np.ndarray, error: float) -> float:
    """Number of independent values of this spread whose mean has this error; NaN for an error of 0."""
    return (float(values.std(ddof=1)) / error) ** 2 if error else math.nan
