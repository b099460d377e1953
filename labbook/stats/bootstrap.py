"""Bootstrap over seeds, for statistics without a formula for their error."""

import math
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from labbook.stats.pooling import Pooled, student

Replicate = TypeVar("Replicate")


def bootstrap_all(
    points: Sequence[Sequence[Replicate]],
    statistic: Callable[[list[list[Replicate]]], Sequence[float]],
    draws: int = 1000,
    seed: int = 0,
    confidence: float = 0.95,
) -> tuple[Pooled, ...]:
    """Estimate statistics with errors by a hierarchical bootstrap over replicates.

    Whole replicates (seeds) are drawn with replacement within each point. Data within a replicate stay together:
    drawing them again would count their noise twice (Davison & Hinkley, Bootstrap Methods, 1997, section 3.8).

    Args:
        points: Replicates of each point, of any type (numbers, series).
        statistic: Function from replicates of each point to k numbers.
        draws: Number of bootstrap samples.
        seed: Seed of the draws.
        confidence: Confidence of the intervals.

    Returns:
        k numbers with Student's intervals, whose degrees of freedom are those of all points together.

    Raises:
        ValueError: A point has fewer than 2 replicates, or the statistic is not finite for a sample.
    """
    sizes = [len(replicates) for replicates in points]
    if not sizes or min(sizes) < 2:
        raise ValueError("a bootstrap over seeds needs at least 2 replicates at every point")
    rng = np.random.default_rng(seed)
    values = [float(value) for value in statistic([list(replicates) for replicates in points])]
    samples = np.empty((draws, len(values)))
    for k in range(draws):
        samples[k] = statistic([[p[i] for i in rng.integers(0, n, n)] for p, n in zip(points, sizes, strict=True)])
    if not np.isfinite(samples).all():
        raise ValueError("the statistic is not finite for some draws of the replicates")
    # The bootstrap sees (n-1)/n of the variance of n replicates, a third too little at n = 3: hence the factor. Points
    # of unequal size: the harmonic mean corrects each variance in proportion to its share, if points matter equally.
    n = len(sizes) / sum(1 / size for size in sizes)
    freedom = sum(sizes) - len(sizes)  # each point gives its mean
    errors = samples.std(axis=0, ddof=1) * math.sqrt(n / (n - 1))
    t = student(confidence, freedom)
    return tuple(
        Pooled(value, float(error), t * float(error), sum(sizes), confidence)
        for value, error in zip(values, errors, strict=True)
    )
