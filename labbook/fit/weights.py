"""Errors of the points of a fit: noisy ones from few replicates, pooled over all points."""

from dataclasses import dataclass
from math import inf, log

import numpy as np


@dataclass(frozen=True)
class Weights:
    """Relative standard errors of the points of a fit.

    Attributes:
        relative: Relative standard error of each point, shape [n].
        degrees_of_freedom: Degrees of freedom of the errors; infinite if they are known exactly. 0 without replicates:
            then only ratios of errors are meaningful.
        uneven: True if the scatter differs between points by more than chance (Bartlett's test, p < 0.01).
    """

    relative: np.ndarray
    degrees_of_freedom: float
    uneven: bool = False


def pooled_weights(W: np.ndarray, error: np.ndarray, replicates: np.ndarray | None) -> Weights:
    """Relative errors of flow rates from the standard errors of their means.

    An error from 3 replicates is itself uncertain by half its size, and such noisy weights spoil a fit. So the relative
    variance between replicates is pooled over all points, s^2 = sum (n_i - 1) s_i^2 / sum (n_i - 1), and point i gets
    s / sqrt(n_i).

    Args:
        W: Flow rates, shape [n].
        error: Their standard errors, shape [n].
        replicates: Number of replicates of each, shape [n]; None: the errors are known exactly.

    Returns:
        The weights. With one replicate of each point the errors are unknown: all points then have the same weight,
        with no degree of freedom.
    """
    if replicates is None:
        return Weights(error / W, inf)
    n = np.asarray(replicates, float)
    freedom = n - 1
    total = float(freedom.sum())
    if total == 0:
        return Weights(np.ones_like(W), 0.0)
    replicated = freedom > 0
    variance = (error[replicated] / W[replicated]) ** 2 * n[replicated]
    pooled = float(np.sum(freedom[replicated] * variance) / total)
    return Weights(np.sqrt(pooled / n), total, _uneven(variance, freedom[replicated], pooled))


def _uneven(variance: np.ndarray, freedom: np.ndarray, pooled: float) -> bool:
    from scipy.special import chdtrc

    if len(variance) < 2 or pooled == 0:
        return False
    if (variance == 0).any():
        return True  # Bartlett's statistic is infinite
    total = float(freedom.sum())
    statistic = total * log(pooled) - float(np.sum(freedom * np.log(variance)))
    correction = 1 + (float(np.sum(1 / freedom)) - 1 / total) / (3 * (len(variance) - 1))
    return float(chdtrc(len(variance) - 1, statistic / correction)) < 0.01
