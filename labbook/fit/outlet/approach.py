"""How a parameter of eccentric profiles approaches its centred value (Fan et al. 2023, Fig. 11)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labbook.fit.band import half_width, law_error
from labbook.fit.result import Parameter
from labbook.stats.pooling import student

_RATES = np.geomspace(0.1, 100.0, 600)
"""Where the rate is looked for: slower than 0.1 is a straight line over s* from 0 to 1, faster than 100 a step."""


TERMS = ("limit", "depth", "rate")
"""Names of the parameters of an approach."""


@dataclass(frozen=True, eq=False)
class Approach:
    """y = limit - depth e^{-rate s*}; the paper has sigma1 = 0.39 - 0.12 e^{-3.74 s*}.

    `covariance` of limit, depth and rate, shape [3, 3], from the scatter of the points about the law: infinite with a
    rate at an end of the range in which it is looked for. `scatter`: standard error
    of a point about the law.
    """

    limit: float
    depth: float
    rate: float
    covariance: np.ndarray
    freedom: int
    scatter: float

    @property
    def parameters(self) -> dict[str, Parameter]:
        """limit, depth and rate with 95 % intervals, by Student's t."""
        values = (self.limit, self.depth, self.rate)
        t = student(0.95, self.freedom)
        return {
            name: Parameter(value, value - t * error, value + t * error, error, "")
            for name, value, error in zip(TERMS, values, self.errors, strict=True)
        }

    @property
    def errors(self) -> tuple[float, float, float]:
        """Standard errors of limit, depth and rate."""
        limit, depth, rate = np.sqrt(np.diag(self.covariance))
        return float(limit), float(depth), float(rate)

    def at(self, s: float | np.ndarray) -> np.ndarray:
        """The value at s* = 2 s/(L - D)."""
        return approach_at(s, self.limit, self.depth, self.rate)

    def half_width(self, s: np.ndarray, *, new_point: bool = False) -> np.ndarray:
        """Half of the 95 % interval of the law at s*, shape [n], to first order; with `new_point` of one more point."""
        error = law_error(_slopes(np.asarray(s, float), self.depth, self.rate), self.covariance)
        return half_width(error, 0.95, self.freedom, self.scatter if new_point else 0.0)


def approach_at(s: np.ndarray | float, limit: float, depth: float, rate: float) -> np.ndarray:
    """limit - depth e^{-rate s*}."""
    return limit - depth * np.exp(-rate * np.asarray(s, float))


def fit_approach(s: Sequence[float], values: Sequence[float]) -> Approach:
    """Least squares, all points alike: given the rate the law is linear, and the rate is found by a scan.

    Errors of single points, of a few seeds, are too noisy for weights. Raises ValueError for fewer than 4 different s*.
    """
    if len(set(s)) < 4:
        raise ValueError("an approach has three parameters: it needs at least 4 different s*")
    places, y = np.asarray(s, float), np.asarray(values, float)
    decay = np.exp(-np.outer(_RATES, places))
    spread = decay - decay.mean(axis=1, keepdims=True)
    slope = spread @ y / (spread**2).sum(axis=1)
    left = ((y - y.mean() - slope[:, None] * spread) ** 2).sum(axis=1)
    best = int(np.argmin(left))
    limit, depth, rate = float(y.mean() - slope[best] * decay[best].mean()), float(-slope[best]), float(_RATES[best])
    freedom = len(y) - 3
    covariance = np.full((3, 3), math.inf)
    if 0 < best < len(_RATES) - 1:
        slopes = _slopes(places, depth, rate)
        covariance = left[best] / freedom * np.linalg.pinv(slopes.T @ slopes)
    return Approach(limit, depth, rate, covariance, freedom, math.sqrt(left[best] / freedom))


def _slopes(s: np.ndarray, depth: float, rate: float) -> np.ndarray:
    """Derivatives of the law by limit, depth and rate, shape [n, 3]."""
    decay = np.exp(-rate * s)
    return np.stack([np.ones(len(s)), -decay, depth * s * decay], axis=1)
