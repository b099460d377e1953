"""Ratio of two means: of paired replicates, which share a seed, or of independent ones."""

import math
from collections.abc import Sequence

import numpy as np

from labbook.stats.pooling import Pooled, student, welch


def paired_ratio(
    above: Sequence[float] | np.ndarray, below: Sequence[float] | np.ndarray, confidence: float = 0.95
) -> Pooled:
    """R = mean(above) / mean(below) of paired replicates.

    The error is that of the mean of above[i] - R below[i], over mean(below), with Student's t on n - 1 degrees of
    freedom (Cochran, Sampling Techniques, 3rd ed., section 6.3): a common effect of the seed cancels. The mean of the
    single ratios would be biased if `below` scatters.

    Args:
        above: Values of the numerator.
        below: Values of the denominator; below[i] shares a seed with above[i].
        confidence: Confidence of the interval.

    Raises:
        ValueError: Samples have unequal lengths or no value, or the denominator is zero.
    """
    x, y = np.asarray(above, float), np.asarray(below, float)
    if len(x) != len(y) or not len(x):
        raise ValueError(f"a ratio of pairs needs equally many values above and below, not {len(x)} and {len(y)}")
    middle = float(y.mean())
    if middle == 0:
        raise ValueError("a ratio needs a denominator that is not zero")
    ratio, n = float(x.mean()) / middle, len(x)
    if n == 1:  # one pair says nothing about the scatter of its ratio
        return Pooled(ratio, math.nan, math.inf, 1, confidence)
    # the mean of x - R y is zero by the definition of R, which costs one degree of freedom as a sample mean does
    error = float(np.std(x - ratio * y, ddof=1)) / math.sqrt(n) / abs(middle)
    return Pooled(ratio, error, student(confidence, n - 1) * error, n, confidence)


def independent_ratio(above: Pooled, below: Pooled, confidence: float = 0.95) -> Pooled:
    """R = above / below of independent means.

    The error is that of above - R below, over below, with Student's t on the degrees of freedom of Welch and
    Satterthwaite.

    Args:
        above: The numerator.
        below: The denominator.
        confidence: Confidence of the interval.

    Returns:
        The ratio, whose `n` is the smaller number of replicates. With a single replicate the error is NaN and the
        interval infinite.

    Raises:
        ValueError: The denominator is zero.
    """
    if below.value == 0:
        raise ValueError("a ratio needs a denominator that is not zero")
    ratio, n = above.value / below.value, min(above.n, below.n)
    if n == 1:
        return Pooled(ratio, math.nan, math.inf, 1, confidence)
    # to first order in both errors: for a denominator near zero the exact (Fieller's) interval would have no end
    a, b = above.error**2, (ratio * below.error) ** 2
    error = math.sqrt(a + b) / abs(below.value)
    return Pooled(ratio, error, student(confidence, welch(a, above.n, b, below.n)) * error, n, confidence)
