"""Errors of the points of a fit: noisy ones from few replicates, pooled into a sound one."""

from dataclasses import dataclass
from math import inf, log

import numpy as np


@dataclass(frozen=True)
class Weights:
    """Relative standard error of each point, shape [n], and the degrees of freedom behind them.

    `degrees_of_freedom`: infinite for errors that are known exactly, 0 where there are no replicates: then
    only the errors' sizes relative to each other mean anything. `uneven`: whether the scatter differs between
    points by more than chance (Bartlett's test, p < 0.01).
    """

    relative: np.ndarray
    degrees_of_freedom: float
    uneven: bool = False


def pooled_weights(W: np.ndarray, error: np.ndarray, replicates: np.ndarray | None) -> Weights:
    """Relative errors of flow rates W from the standard errors of their means over `replicates` seeds.

    An error from 3 replicates is itself uncertain by half its size, and weights that noisy spoil a fit: the
    relative variance between replicates is pooled over all points, s^2 = sum (n_i - 1) s_i^2 / sum (n_i - 1),
    and point i gets s / sqrt(n_i). Without `replicates` the errors are taken as exactly known. With one replicate of
    each, nothing tells the errors: all points weigh the same, with no degree of freedom.
    """
    if replicates is None:
        return Weights(error / W, inf)
    n = np.asarray(replicates, float)
    freedom = n - 1
    total = float(freedom.sum())
    if total == 0:
        return Weights(np.ones_like(W), 0.0)
    known = freedom > 0
    variance = (error[known] / W[known]) ** 2 * n[known]
    pooled = float(np.sum(freedom[known] * variance) / total)
    return Weights(np.sqrt(pooled / n), total, _uneven(variance, freedom[known], pooled))


def _uneven(variance: np.ndarray, freedom: np.ndarray, pooled: float) -> bool:
    from scipy.special import chdtrc

    if len(variance) < 2 or pooled == 0:
        return False
    if (variance == 0).any():
        return True
    total = float(freedom.sum())
    statistic = total * log(pooled) - float(np.sum(freedom * np.log(variance)))
    correction = 1 + (float(np.sum(1 / freedom)) - 1 / total) / (3 * (len(variance) - 1))
    return float(chdtrc(len(variance) - 1, statistic / correction)) < 0.01
