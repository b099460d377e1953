"""Pooling of replicates: mean over seeds, seed-to-seed error and Student's interval."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Pooled:
    """Mean of independent replicates.

    Attributes:
        value: The mean.
        error: Standard error from the scatter between replicates; NaN for one replicate.
        half_width: Half width of the interval; infinite for one replicate.
        n: Number of replicates.
        confidence: Confidence of the interval.
    """

    value: float
    error: float
    half_width: float
    n: int
    confidence: float = 0.95

    @property
    def low(self) -> float:
        """Lower end of the interval."""
        return self.value - self.half_width

    @property
    def high(self) -> float:
        """Upper end of the interval."""
        return self.value + self.half_width

    @property
    def significant(self) -> float:
        """Absolute mean beyond its interval about zero: max(0, |mean| - half width)."""
        return max(0.0, abs(self.value) - self.half_width)

    @property
    def relative(self) -> float:
        """Half width relative to the absolute mean; infinite for a mean of zero."""
        return self.half_width / abs(self.value) if self.value else math.inf


def welch(a: float, n: int, b: float, m: int) -> float:
    """Degrees of freedom of the difference of two means (Welch, Biometrika 34 (1947) 28).

    Args:
        a: Squared standard error of the first mean.
        n: Its number of values.
        b: Squared standard error of the second mean.
        m: Its number of values.
    """
    spread = a**2 / (n - 1) + b**2 / (m - 1)
    return (a + b) ** 2 / spread if spread else float(n + m - 2)  # without scatter: as for equal variances


def student(confidence: float, degrees_of_freedom: float) -> float:
    """Two-sided quantile t of Student's distribution: |T| < t with probability `confidence`.

    Infinite below one degree of freedom.
    """
    return float(students(confidence, np.asarray(degrees_of_freedom, float)))


def students(confidence: float, degrees_of_freedom: np.ndarray) -> np.ndarray:
    """Quantiles of `student`, of the shape of `degrees_of_freedom`."""
    from scipy.special import stdtrit

    if not 0 < confidence < 1:
        raise ValueError(f"a confidence lies between 0 and 1, not at {confidence}")
    t = stdtrit(np.clip(degrees_of_freedom, 1, 1e8), 0.5 + confidence / 2)  # stdtrit fails for infinitely many
    return np.where(degrees_of_freedom < 1, math.inf, t)


def pool(values: Sequence[float] | np.ndarray, confidence: float = 0.95) -> Pooled:
    """Pool one value per replicate: mean and Student's interval, x +- t_{n-1} s / sqrt(n).

    The interval holds for a number of replicates that was fixed beforehand. If it was decided from the values, use
    `StoppingRule`.

    Args:
        values: Value of each replicate, shape [n].
        confidence: Confidence of the interval.

    Raises:
        ValueError: There is no value, or one is not finite.
    """
    array = np.asarray(values, float)
    if array.ndim != 1 or not len(array):
        raise ValueError("pooling needs one value per replicate, and at least one replicate")
    if not np.isfinite(array).all():
        raise ValueError("pooling needs finite values: leave out the replicates that gave none, and say so")
    n, mean = len(array), float(array.mean())
    if n == 1:  # no error at all, rather than the zero that one value scatters by
        return Pooled(mean, math.nan, math.inf, 1, confidence)
    error = float(array.std(ddof=1)) / math.sqrt(n)
    return Pooled(mean, error, student(confidence, n - 1) * error, n, confidence)
