"""Setting at which a response has a target value, with its interval: the settings whose intervals hold the value.

That is Fieller's construction (J. R. Stat. Soc. B 16 (1954) 175), for any response with pointwise intervals.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

Band = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""Function that gives values of a response at m settings and the ends of their intervals, each of shape [m]."""
_PLACES, _FINE = 129, 17
"""Settings at which a response is computed to find sign changes, and settings between two of them."""


class NoSetting(ValueError):
    """No setting of the range gives the value, or several do.

    Attributes:
        smallest, largest: Values of the response within the range.
        nearest: Setting whose value is nearest to the target.
        several: True if several settings give the value.
    """

    def __init__(self, message: str, smallest: float, largest: float, nearest: float, several: bool = False):
        super().__init__(message)
        self.smallest, self.largest, self.nearest, self.several = smallest, largest, nearest, several


@dataclass(frozen=True)
class Setting:
    """A setting with its interval; an end outside the range of settings is infinite."""

    value: float
    low: float
    high: float

    @property
    def ends(self) -> tuple[float, float]:
        """Both ends of its interval."""
        return self.low, self.high


def setting_for(band: Band, low: float, high: float, target: float) -> Setting:
    """Find the setting at which a response has a value.

    Args:
        band: The response.
        low: Smallest setting.
        high: Largest setting.
        target: Value to find.

    Returns:
        The setting, and the settings about it whose intervals hold the value.

    Raises:
        NoSetting: The value is not reached within the range, or at several settings.
    """
    grid = np.linspace(low, high, _PLACES)

    def beyond(x: np.ndarray) -> np.ndarray:
        return band(x)[0] - target

    def inside(x: np.ndarray) -> np.ndarray:
        """Above 0 where the interval holds the value."""
        _, lower, upper = band(x)
        return np.minimum(target - lower, upper - target)

    off = beyond(grid)
    # a grid, and not a bracketing search: that would return one of several settings without a word
    crossings = np.flatnonzero(np.diff(np.sign(off)) != 0)
    reach = float(off.min() + target), float(off.max() + target), float(grid[np.argmin(np.abs(off))])
    if len(crossings) == 0:
        raise NoSetting("the value is not reached within the range", *reach)
    if len(crossings) > 1 and off[crossings[1]] != 0:  # a zero at a place of the grid changes the sign twice
        raise NoSetting(f"{len(crossings)} settings give the value", *reach, several=True)
    root = _zero(beyond, *grid[crossings[0] :][:2].tolist())
    # Fieller: an end of the interval is the place where the band, and not the mean, crosses the target
    outside = inside(grid) < 0
    below, above = np.flatnonzero(outside & (grid < root)), np.flatnonzero(outside & (grid > root))
    first = _zero(inside, grid[below[-1]], min(grid[below[-1] + 1], root)) if len(below) else -math.inf
    last = _zero(inside, max(grid[above[0] - 1], root), grid[above[0]]) if len(above) else math.inf
    return Setting(root, first, last)


def _zero(function: Callable[[np.ndarray], np.ndarray], start: Any, end: Any) -> float:
    """Find the zero of a function whose sign changes between start and end, linear between fine places."""
    grid = np.linspace(start, end, _FINE)
    values = function(grid)
    index = int(np.argmax(np.sign(values) != np.sign(values[0]))) - 1
    rise = values[index + 1] - values[index]
    fraction = np.clip(-values[index] / rise, 0, 1) if rise else 0.0
    return float(grid[index] + fraction * (grid[index + 1] - grid[index]))
