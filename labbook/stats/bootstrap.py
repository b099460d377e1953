"""Bootstrap over seeds, for statistics that have no formula."""

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
    """Hierarchical bootstrap: within each point whole replicates (seeds) are drawn with replacement.

    `points`: for each point its replicates, of any type (numbers, series); `statistic`: the numbers that are made of
    them. What lies within a replicate stays together: drawing it anew would count its noise twice (Davison & Hinkley,
    Bootstrap Methods, 1997, section 3.8). With n replicates a point the bootstrap sees (n-1)/n of the variance, which
    is a third too little at n = 3; the error is corrected for that, and the interval is Student's with the degrees of
    freedom of all points together. Raises ValueError for a point with fewer than 2 replicates.
    """
    sizes = [len(replicates) for replicates in points]
    if not sizes or min(sizes) < 2:
        raise ValueError("a bootstrap over seeds needs at least 2 replicates at every point")
    rng = np.random.default_rng(seed)
    values = [float(value) for value in statistic([list(replicates) for replicates in points])]
    drawn = np.empty((draws, len(values)))
    for k in range(draws):
        drawn[k] = statistic([[p[i] for i in rng.integers(0, n, n)] for p, n in zip(points, sizes, strict=True)])
    if not np.isfinite(drawn).all():
        raise ValueError("the statistic is not finite for some draws of the replicates")
    # Points of unequal size: the harmonic mean gives each variance its own share when they matter alike.
    n = len(sizes) / sum(1 / size for size in sizes)
    freedom = sum(sizes) - len(sizes)
    errors = drawn.std(axis=0, ddof=1) * math.sqrt(n / (n - 1))
    t = student(confidence, freedom)
    return tuple(
        Pooled(value, float(error), t * float(error), sum(sizes), confidence)
        for value, error in zip(values, errors, strict=True)
    )
