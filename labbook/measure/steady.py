"""Rate of an outflow within a window, from the times at which grains left."""

import math
from dataclasses import dataclass

import numpy as np

from labbook.measure.measure import Window
from labbook.stats.correlation import block_mean, correlated_mean
from labbook.stats.trend import Trend, trend

GAP = 1.0
"""s: a longer time without a grain is a gap, left out of the rate and reported (Pongo et al. 2022)."""
FEWEST = 60
"""Grains in a window below which there is no rate and no trend test."""
BLOCKS = 12
"""Blocks of equally many grains, for the trend test and the block error."""


@dataclass(frozen=True)
class SteadyFlow:
    """Outflow within a window.

    `rate`: grains per second while flowing, (grains - gaps) / (time - gap time). `error`: its standard error
    from 12 blocks of equally many grains (11 degrees of freedom); `correlated_error`, from the
    autocorrelation of averages over sqrt(n) grains. Both are checks of the seed-to-seed error; for very
    regular outflow both are too large. `inefficiency`: squared error over that of n independent times between
    grains, below 1 for outflow that is more regular than chance, and `n_effective` = n over it. `begin`,
    `end` [s]; `fraction`: the part of the initial grains discharged at either end.
    """

    rate: float
    error: float
    correlated_error: float
    inefficiency: float
    n_effective: float
    trend: Trend
    begin: float
    end: float
    fraction: tuple[float, float]
    grains: int
    gaps: int
    gap_time: float


def steady_flow(times: np.ndarray, total: int, window: Window) -> SteadyFlow | None:
    """Rate of outflow between the fractions `window.start` and `window.end` of `total` grains discharged.

    `times`: ascending crossing times [s], shape [n]. The window runs from one crossing to another, so that
    its count is exact. None if it holds fewer than 60 grains: too few for a rate.
    """
    first = max(math.ceil(window.start * total - 1e-9), 1) - 1
    last = min(math.floor(window.end * total + 1e-9), len(times)) - 1
    if last - first < FEWEST:
        return None
    waits = np.diff(times[first : last + 1])
    flowing = waits <= GAP
    kept = waits[flowing]
    if len(kept) < FEWEST:
        return None
    n = len(kept)
    blocks = block_mean(kept, BLOCKS)
    correlated = correlated_mean(block_mean(kept, math.isqrt(n)).means)
    mean = float(kept.mean())
    rate = 1 / mean
    spread = float(kept.std(ddof=1))
    inefficiency = n * (blocks.error / spread) ** 2 if spread else math.nan
    return SteadyFlow(
        rate=rate,
        error=rate * blocks.error / mean,
        correlated_error=rate * correlated.error / mean,
        inefficiency=inefficiency,
        n_effective=n / inefficiency if inefficiency else math.nan,
        trend=trend(1 / blocks.means),
        begin=float(times[first]),
        end=float(times[last]),
        fraction=((first + 1) / total, (last + 1) / total),
        grains=n,
        gaps=int((~flowing).sum()),
        gap_time=float(waits[~flowing].sum()),
    )
