"""Tolerated error of a number, and the only place that decides if it is met."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Tolerance:
    """Criterion |bias| + half width of the 95 % interval <= `error`; all are parts of the number.

    Attributes:
        error: Tolerated error.
        bias: Largest bias by numerics, which averaging does not reduce.
    """

    error: float
    bias: float = 0.0

    @property
    def remainder(self) -> float:
        """Part of the error left for the half width; not positive if the bias alone is too large."""
        return self.error - self.bias

    def met(self, half_width: float) -> bool:
        """Decide if a number whose interval has this relative half width meets the error."""
        return bool(self.within(np.asarray(half_width)))

    def within(self, half_widths: np.ndarray) -> np.ndarray:
        """Decide the same for several half widths, of any shape."""
        return half_widths <= self.remainder
