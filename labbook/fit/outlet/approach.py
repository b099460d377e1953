"""How a parameter of eccentric profiles approaches its centred value (Fan et al. 2023, Fig. 11)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_RATES = np.geomspace(0.1, 100.0, 600)
"""Where the rate is looked for: slower than 0.1 is a straight line over s* from 0 to 1, faster than 100 a step."""


@dataclass(frozen=True)
class Approach:
    """y = limit - depth e^{-rate s*}; the paper has sigma1 = 0.39 - 0.12 e^{-3.74 s*}."""

    limit: float
    depth: float
    rate: float

    def at(self, s: float | np.ndarray) -> np.ndarray:
        """The value at s* = 2 s/(L - D)."""
        return self.limit - self.depth * np.exp(-self.rate * np.asarray(s, float))


def fit_approach(s: Sequence[float], values: Sequence[float], errors: Sequence[float]) -> Approach:
    """Weighted least squares: given the rate the law is linear, and the rate is found by a scan.

    Raises ValueError for fewer than 4 different s*.
    """
    if len(set(s)) < 4:
        raise ValueError("an approach has three parameters: it needs at least 4 different s*")
    weight = 1 / np.square(np.asarray(errors, float))
    weight /= weight.sum()
    y = np.asarray(values, float)
    decay = np.exp(-np.outer(_RATES, np.asarray(s, float)))
    spread = decay - (decay @ weight)[:, None]
    mean = float(weight @ y)
    slope = (spread * weight) @ y / (spread**2 @ weight)
    left = (y - mean - slope[:, None] * spread) ** 2 @ weight
    best = int(np.argmin(left))
    return Approach(float(mean - slope[best] * (decay @ weight)[best]), float(-slope[best]), float(_RATES[best]))
