"""Straight lines and planes through points by least squares, with errors from their scatter."""

import math
from collections.abc import Sequence

import numpy as np

from labbook.stats.pooling import Pooled, student


def slopes(factors: Sequence[Sequence[float]], values: Sequence[float], confidence: float = 0.95) -> tuple[Pooled, ...]:
    """Slopes of a plane by each of its factors, all points weighing alike.

    Errors are from the scatter of the points about the plane, so what the plane misses widens them; intervals are
    Student's with as many degrees of freedom. Without any, errors are NaN and intervals infinite.

    Args:
        factors: of each point, shape [n, k].
        values: of each point, shape [n].
        confidence: of the intervals.

    Returns:
        k slopes, whose `n` is the number of points.

    Raises:
        ValueError: the points do not determine a plane.
    """
    x, y = np.asarray(factors, float), np.asarray(values, float)
    n, k = x.shape
    x, y = x - x.mean(axis=0), y - y.mean()
    sizes = np.abs(x).max(axis=0)
    if n < k + 1 or not sizes.all() or np.linalg.matrix_rank(x / sizes) < k:
        raise ValueError(f"{n} points do not determine the slopes of a plane by {k} factors")
    inverse = np.linalg.inv((x / sizes).T @ (x / sizes)) / np.outer(sizes, sizes)
    plane, freedom = inverse @ x.T @ y, n - k - 1
    scatter = math.sqrt(float(np.sum((y - x @ plane) ** 2)) / freedom) if freedom else math.nan
    errors = scatter * np.sqrt(np.diag(inverse))
    t = student(confidence, freedom)
    return tuple(
        Pooled(float(value), float(error), t * float(error) if freedom else math.inf, n, confidence)
        for value, error in zip(plane, errors, strict=True)
    )
