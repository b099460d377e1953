"""The order of an error in the time step: the slope of a straight line through logarithms."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Order:
    """Error ~ dt^value, with the standard error of the slope; NaN where there is nothing to fit."""

    value: float
    error: float


def fit_order(steps: Sequence[float] | np.ndarray, errors: Sequence[float] | np.ndarray) -> Order:
    """Fit the order by least squares over the finer half of the steps, at least three of them.

    Args:
        steps: Time steps, in any unit.
        errors: Error at each step.

    Returns:
        The order; NaN with fewer than three steps, or if an error is zero and so has no logarithm.
    """
    h, e = np.asarray(steps, float), np.asarray(errors, float)
    finest = np.argsort(h)[: max(3, (len(h) + 1) // 2)]
    h, e = h[finest], e[finest]
    if len(h) < 3 or not (np.isfinite(e) & (e > 0)).all():
        return Order(math.nan, math.nan)
    x, y = np.log(h) - np.log(h).mean(), np.log(e)
    slope = float(x @ y / (x @ x))
    residuals = y - y.mean() - slope * x
    return Order(slope, math.sqrt(float(residuals @ residuals) / (len(h) - 2) / float(x @ x)))
