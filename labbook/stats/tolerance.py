"""The error that is tolerated in a number, and whether it is kept: the one place where that is decided."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Tolerance:
    """|bias| + half width of the 95 % interval <= `error`; all are parts of the number.

    Attributes:
        error: What is tolerated.
        bias: What numerics add at most, which does not average out.
    """

    error: float
    bias: float = 0.0

    @property
    def left(self) -> float:
        """What the bias leaves for the half width; not positive where the bias alone is too large."""
        return self.error - self.bias

    def kept(self, half_width: float) -> bool:
        """Decide whether a number whose interval has this half width, relative to it, is as good as was asked."""
        return bool(self.within(np.asarray(half_width)))

    def within(self, half_widths: np.ndarray) -> np.ndarray:
        """Decide it of several half widths, shape [...]."""
        return half_widths <= self.left
