"""Is there a plateau? A test of block means for a trend across the window."""

import math
from dataclasses import dataclass

import numpy as np

SIGNIFICANCE = 0.01
"""A trend is reported only if chance alone shows one as strong in fewer than 1 % of steady runs ..."""
MATERIAL = 0.05
"""... and the fitted change across the window exceeds 5 % of the mean: less does not spoil a mean."""


@dataclass(frozen=True)
class Trend:
    """Outcome of a trend test over a window.

    `drift`: change of the straight-line fit across the window, relative to the mean, and `drift_error`, its
    standard error. `change`: highest minus lowest value of the fitted parabola, relative to the mean. `p`:
    probability of a parabola as good as this one in a steady series. `trending`: `p` below 0.01 and `change`
    above 0.05.
    """

    drift: float
    drift_error: float
    change: float
    p: float

    @property
    def trending(self) -> bool:
        """Whether there is no plateau."""
        return self.p < SIGNIFICANCE and self.change > MATERIAL


def trend(values: np.ndarray) -> Trend:
    """Test block means at equal distances for a trend: least-squares parabola against a constant (F test).

    The parabola sees what a straight line misses: a flow that rises and falls within the window. Block means
    of a series whose correlation is shorter than a block are nearly independent, so that the ordinary F and t
    distributions hold. Raises ValueError for fewer than 5 blocks or a mean of zero.
    """
    from scipy.special import fdtrc

    y = np.asarray(values, float)
    n = len(y)
    if n < 5:
        raise ValueError(f"a trend test needs at least 5 blocks, not {n}")
    mean = float(y.mean())
    if mean == 0:
        raise ValueError("a relative trend needs a mean that is not zero")
    x = (np.arange(n) + 0.5) / n - 0.5  # the window is one unit long
    line, parabola = np.vander(x, 2), np.vander(x, 3)
    slope = np.linalg.lstsq(line, y, rcond=None)[0]
    curve = np.linalg.lstsq(parabola, y, rcond=None)[0]
    left_line = float(np.sum((y - line @ slope) ** 2))
    left = float(np.sum((y - parabola @ curve) ** 2))
    total = float(np.sum((y - mean) ** 2))
    error = math.sqrt(left_line / (n - 2) / float(np.sum(x**2)))
    if total <= (1e-12 * mean) ** 2 * n:  # constant to round-off
        p = 1.0
    elif left <= 1e-24 * total:
        p = 0.0
    else:
        p = float(fdtrc(2, n - 3, (total - left) / 2 / (left / (n - 3))))
    at = np.polyval(curve, np.linspace(-0.5, 0.5, 101))
    return Trend(float(slope[0]) / mean, error / abs(mean), float(np.ptp(at)) / abs(mean), p)
