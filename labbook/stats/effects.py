"""Effects that differ from case to case: the effect in one more case."""

import math
from collections.abc import Sequence

import numpy as np

from labbook.stats.pooling import student

FEWEST = 3
"""Cases from which on something is known of another: t of two would be 12.7."""
_FEW = 4
"""Cases up to which the interval is that of a prediction: the scatter of so few cannot be told from their errors."""
_SCALE = 10.0
"""Of the prior of the scatter between cases, in errors of measurement."""


def one_more(values: Sequence[float], variances: Sequence[float], confidence: float = 0.95) -> tuple[float, float]:
    """Give the best estimate of the effect in one more case of a kind, and the half width of its interval.

    Effects are drawn from a normal distribution. Of k = 3 or 4 cases the interval is that of a prediction, mean +-
    t_(k-1) s sqrt(1 + 1/k) with the standard deviation s of the measured effects (Hahn & Meeker, Statistical Intervals,
    1991, section 4.7). From five cases on the mean has a flat prior, and the standard deviation tau between cases has
    one as 1/(1 + (tau/10 a)^2), with a the error of measurement (Gelman, Bayesian Analysis 1 (2006) 515), so that noise
    is not taken for scatter. 95 % intervals hold one more effect in 93 to 100 % of simulations
    (benchmarks/intervals.py).

    Args:
        values: Effects that were measured in cases of that kind, at least FEWEST.
        variances: Squares of their standard errors of measurement.
        confidence: Of the interval.

    Returns:
        Best estimate and half width.

    Raises:
        ValueError: There are fewer than FEWEST cases.
    """
    from scipy.special import ndtr

    x, v = np.asarray(values, float), np.maximum(np.asarray(variances, float), 1e-24)
    if len(x) < FEWEST:
        raise ValueError(f"the effect in one more case needs at least {FEWEST} that were measured, not {len(x)}")
    if len(x) <= _FEW:
        reach = student(confidence, len(x) - 1) * math.sqrt(1 + 1 / len(x))
        return float(x.mean()), reach * float(x.std(ddof=1))
    error = math.sqrt(float(v.mean()))
    tau = np.concatenate([[0.0], np.geomspace(1e-2 * error, 100 * max(error, float(np.ptp(x))), 80)])
    weights = 1 / (v + tau[:, None] ** 2)
    total = weights.sum(axis=1)
    means = (weights * x).sum(axis=1) / total
    fit = 0.5 * (np.log(weights).sum(axis=1) - np.log(total) - (weights * (x - means[:, None]) ** 2).sum(axis=1))
    likely = np.exp(fit - fit.max()) / (1 + (tau / error / _SCALE) ** 2) * np.gradient(tau)
    likely /= likely.sum()
    mean, spread = float(likely @ means), np.sqrt(1 / total + tau**2)
    low, high = 0.0, float(np.abs(means - mean).max() + 10 * spread.max())
    while high - low > 1e-3 * high:
        half = 0.5 * (low + high)
        covered = likely @ (ndtr((mean + half - means) / spread) - ndtr((mean - half - means) / spread))
        low, high = (half, high) if covered < confidence else (low, half)
    return mean, high
