"""Rates of rare events: events over exposure, with exact intervals, also for censored runs.

For a silo the events are stops and the exposure is the number of grains that left. If a flow has no memory and stops
are rare, the number of stops among G grains is Poisson distributed. That holds however the G grains are spread over
runs, and whether a run ended by a stop or by its time: right-censored runs need nothing else.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labbook.stats.pooling import Pooled

_DRAWS = 2000


@dataclass(frozen=True)
class PooledRate(Pooled):
    """Events over exposure, of `n` independent replicates.

    Attributes:
        events: Events in all replicates.
        exposure: Exposure of all replicates, such as grains.
        low_end: Lower end of the exact interval.
        high_end: Upper end of the exact interval.
    """

    events: int = 0
    exposure: float = 0.0
    low_end: float = 0.0
    high_end: float = math.inf

    @property
    def low(self) -> float:
        """Lower end of the interval; 0 without events."""
        return self.low_end

    @property
    def high(self) -> float:
        """Upper end of the interval; without events the upper bound of the rate."""
        return self.high_end

    @property
    def bound(self) -> bool:
        """True without events, when only an upper bound is known."""
        return self.events == 0


def rate(events: int, exposure: float, replicates: int = 1, confidence: float = 0.95) -> PooledRate:
    """Rate of a Poisson process from its events, with the exact interval of Garwood (Biometrika 28 (1936) 437).

    The ends are chi2_{a/2}(2k) / 2G and chi2_{1-a/2}(2k + 2) / 2G for k events in an exposure of G. Without events the
    upper end is 3.69 / G at 95 %.

    Args:
        events: Events k in all replicates.
        exposure: Exposure G, above 0.
        replicates: Number of independent replicates.
        confidence: Confidence of the interval.

    Returns:
        The rate; its `error` is sqrt(k) / G, and its `half_width` the distance to the upper end.

    Raises:
        ValueError: A negative count, or no exposure.
    """
    from scipy.special import chdtri

    if events < 0 or not exposure > 0:
        raise ValueError(f"a rate needs a count and an exposure above 0, not {events} and {exposure:g}")
    tail = (1 - confidence) / 2
    # chdtri takes the upper tail: the lower end comes from 2k degrees of freedom, the upper one from 2k + 2
    low = float(chdtri(2 * events, 1 - tail)) / (2 * exposure) if events else 0.0
    high = float(chdtri(2 * events + 2, tail)) / (2 * exposure)
    value = events / exposure
    # the interval is skewed, and its upper side the longer one: a criterion on the half width holds for both sides
    half_width = high - value
    return PooledRate(
        value, math.sqrt(events) / exposure, half_width, replicates, confidence, events, float(exposure), low, high
    )


def events_needed(error: float, confidence: float = 0.95) -> int:
    """Events needed for a relative half width `error` of the interval of a rate: (z / error)^2, 97 for 20 % at 95 %."""
    from scipy.special import ndtri

    if not error > 0:
        raise ValueError(f"an error must be positive, not {error}")
    return math.ceil((float(ndtri(0.5 + confidence / 2)) / error) ** 2)


def clustered(
    events: Sequence[int] | np.ndarray, exposures: Sequence[float] | np.ndarray, confidence: float = 0.95, seed: int = 0
) -> tuple[float, float]:
    """Compute the interval of a rate by a bootstrap over clusters, whose events may depend on one another.

    Whole clusters are drawn with replacement (Davison & Hinkley, Bootstrap Methods, 1997, section 3.8), and the ends
    are percentiles. For few clusters the interval is too narrow: use 32 or more.

    Args:
        events: Events of each cluster, such as the runs of one packing.
        exposures: Exposure of each cluster.
        confidence: Confidence of the interval.
        seed: Seed of the draws.

    Returns:
        Lower and upper end; NaN for fewer than two clusters.
    """
    n = len(events)
    if n < 2:
        return math.nan, math.nan
    # n draws with replacement are multinomial numbers of each cluster, so that all sums are one product
    weights = np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), size=_DRAWS)
    k, passed = weights @ np.asarray(events, float), weights @ np.asarray(exposures, float)
    with np.errstate(invalid="ignore", divide="ignore"):  # a draw may have no exposure, if that of clusters is zero
        low, high = np.nanquantile(k / passed, [(1 - confidence) / 2, (1 + confidence) / 2])
    return float(low), float(high)
