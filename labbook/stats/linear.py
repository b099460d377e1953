"""Straight lines and planes through points by least squares, with errors from their scatter."""

import math
from collections.abc import Sequence

import numpy as np

from labbook.stats.pooling import Pooled, student


def slopes(factors: Sequence[Sequence[float]], values: Sequence[float], confidence: float = 0.95) -> tuple[Pooled, ...]:
    """Fit the slopes of a plane by each of its factors; all points have the same weight.

    Errors follow from the scatter of the points about the plane, so that a lack of fit widens them. Intervals are
    Student's. Without degrees of freedom errors are NaN and intervals infinite.

    Args:
        factors: Factors of each point, shape [n, k].
        values: Value of each point, shape [n].
        confidence: Confidence of the intervals.

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
    # factors of very different size, such as L/d and D [m], are scaled before the matrix is inverted
    inverse = np.linalg.inv((x / sizes).T @ (x / sizes)) / np.outer(sizes, sizes)
    plane, freedom = inverse @ x.T @ y, n - k - 1
    scatter = math.sqrt(float(np.sum((y - x @ plane) ** 2)) / freedom) if freedom else math.nan
    errors = scatter * np.sqrt(np.diag(inverse))
    t = student(confidence, freedom)
    return tuple(
        Pooled(float(value), float(error), t * float(error) if freedom else math.inf, n, confidence)
        for value, error in zip(plane, errors, strict=True)
    )
