"""Test of block means for a trend across the window, that is, for the absence of a plateau."""

import math
from dataclasses import dataclass

import numpy as np

SIGNIFICANCE = 0.01
"""Probability of a trend by chance in a steady run, below which a trend may be reported."""
MATERIAL = 0.05
"""Change of the fit across the window, relative to the mean, above which a significant trend is reported: a smaller one
does not spoil a mean."""


@dataclass(frozen=True)
class Trend:
    """Outcome of a trend test over a window.

    Attributes:
        drift: Change of the straight-line fit across the window, relative to the mean.
        drift_error: Its standard error.
        change: Highest less lowest value of the fitted parabola, relative to the mean.
        p: Probability of a parabola that fits as well in a steady series.
    """

    drift: float
    drift_error: float
    change: float
    p: float

    @property
    def trending(self) -> bool:
        """True if there is no plateau: `p` is below 0.01 and `change` above 0.05."""
        return self.p < SIGNIFICANCE and self.change > MATERIAL


def trend(values: np.ndarray) -> Trend:
    """Test block means at equal distances for a trend: least-squares parabola against a constant (F test).

    A parabola detects a flow that rises and falls within the window, which a straight line misses. If the correlation
    is shorter than a block, block means are nearly independent, and the ordinary F and t distributions hold.

    Args:
        values: Block means, shape [n].

    Raises:
        ValueError: There are fewer than 5 blocks, or their mean is zero.
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
    squares_line = float(np.sum((y - line @ slope) ** 2))
    squares = float(np.sum((y - parabola @ curve) ** 2))
    total = float(np.sum((y - mean) ** 2))
    error = math.sqrt(squares_line / (n - 2) / float(np.sum(x**2)))
    if total <= (1e-12 * mean) ** 2 * n:  # constant to round-off
        p = 1.0
    elif squares <= 1e-24 * total:  # a perfect parabola to round-off: F is infinite
        p = 0.0
    else:
        p = float(fdtrc(2, n - 3, (total - squares) / 2 / (squares / (n - 3))))
    at = np.polyval(curve, np.linspace(-0.5, 0.5, 101))
    return Trend(float(slope[0]) / mean, error / abs(mean), float(np.ptp(at)) / abs(mean), p)
