"""A number against one setting, between runs: interpolation with its error.

The number is the sum of a straight line, a smooth deviation from it, and contributions of the bed of a run and of its
flow. The deviation is integrated Brownian motion, whose posterior mean is the cubic smoothing spline (Wahba, J. R.
Stat. Soc. B 40 (1978) 364; its intervals: 45 (1983) 133). Its size, the share of the beds and the scatter of runs are
unknown. The first two are averaged over by their likelihood (restricted, as the line is unknown too); the scatter leads
to Student's t. So an interval includes the noise of the runs and the possible course of the response between them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labbook.stats.nested import bed_prior
from labbook.stats.pooling import student

FEWEST = 4
"""Fewest different settings for an estimate of the deviation from a straight line; with three, intervals are
meaningless."""
_SIZES = np.logspace(-1, 4, 11)
"""Sizes of the deviation that are averaged over, over the scatter of runs."""
_SHARES = np.array([0.05, 0.2, 0.45])
"""Shares of the beds in the variance of runs that are averaged over."""
_NEGLIGIBLE = 1e-6
"""Weight of a pair of size and share below which it is left out."""


@dataclass(frozen=True, eq=False)
class Response:
    """A response fitted to n runs.

    Attributes:
        low: Smallest setting.
        high: Largest setting.
        freedom: Degrees of freedom of its intervals.
        scatter: Standard deviation of runs about the response.
    """

    low: float
    high: float
    freedom: int
    scatter: float
    _line: np.ndarray
    """Settings from 0 to 1 beside a column of ones, shape [n, 2]."""
    _values: np.ndarray
    _weights: np.ndarray
    """Weights of k pairs of a share and a size."""
    _sizes: np.ndarray
    _inverses: np.ndarray
    """Inverses of the covariance of the values, over the variance of runs, shape [k, n, n]."""

    @classmethod
    def of(
        cls, settings: Sequence[float] | np.ndarray, values: Sequence[float] | np.ndarray, beds: Sequence[int]
    ) -> "Response":
        """Fit the response to runs.

        Args:
            settings: Settings of the runs, shape [n].
            values: Values of the runs, shape [n].
            beds: Seeds of their beds, shape [n]; runs of one seed share the contribution of the bed.

        Raises:
            ValueError: Fewer than four settings differ, or a number is not finite.
        """
        x, y, seeds = np.asarray(settings, float), np.asarray(values, float), np.asarray(beds)
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            raise ValueError("a response needs finite numbers")
        if len(np.unique(x)) < FEWEST:
            raise ValueError(f"{len(np.unique(x))} settings are too few: a response needs {FEWEST}")
        low, high, freedom = float(x.min()), float(x.max()), len(x) - 2
        s = (x - low) / (high - low)
        line = np.stack([np.ones_like(s), s], axis=1)
        share, size = (grid.ravel() for grid in np.meshgrid(_SHARES, _SIZES, indexing="ij"))
        noise = (1 - share)[:, None, None] * np.eye(len(s)) + share[:, None, None] * (seeds[:, None] == seeds)
        covariance = noise + size[:, None, None] ** 2 * _spline(s, s)
        inverses = np.linalg.inv(covariance)
        _, of_line, _, squares = _least_squares(line, y, inverses)
        determinants = np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(of_line)[1]
        # restricted: the line is integrated over, which adds the determinant of its information
        likelihood = -0.5 * (determinants + freedom * np.log(squares))
        # averaged and not maximised: a few settings cannot tell a smooth response from a noisy one
        weights = np.exp(likelihood - likelihood.max()) * bed_prior(share)
        weights /= weights.sum()
        scatter = float(np.sqrt(weights @ squares / freedom))
        relevant = weights > _NEGLIGIBLE
        return cls(low, high, freedom, scatter, line, y, weights[relevant], size[relevant], inverses[relevant])

    def at(self, settings: Sequence[float] | np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Compute the response at m settings and the half width of its 95 % interval, each of shape [m].

        Raises:
            ValueError: A setting is outside the range of the runs.
        """
        x = np.atleast_1d(np.asarray(settings, float))
        edge = 1e-9 * (self.high - self.low)
        if (x < self.low - edge).any() or (x > self.high + edge).any():
            raise ValueError(f"the response is known from {self.low:g} to {self.high:g} only")
        s = np.clip((x - self.low) / (self.high - self.low), 0, 1)
        line, between, own = np.stack([np.ones_like(s), s], axis=1), _spline(s, self._line[:, 1]), s**3 / 3
        best, of_line, residuals, squares = _least_squares(self._line, self._values, self._inverses)
        means, variances = [], []
        for k, size in enumerate(self._sizes**2):
            pull = size * between @ self._inverses[k]
            off = line - pull @ self._line
            means.append(line @ best[k] + pull @ residuals[k])
            # variance of the spline given the line, and that of the line seen through the spline
            spread = size * (own - (pull * between).sum(axis=1)) + ((off @ of_line[k]) * off).sum(axis=1)
            variances.append(np.maximum(spread, 0) * squares[k] / self.freedom)
        mean = self._weights @ np.array(means)
        # law of total variance: within each member of the average, and between members
        variance = self._weights @ (np.array(variances) + (np.array(means) - mean) ** 2)
        return mean, student(0.95, self.freedom) * np.sqrt(variance)


def _least_squares(line: np.ndarray, y: np.ndarray, inverses: np.ndarray):
    """Fit the straight line for each of k covariances.

    Returns:
        Coefficients, shape [k, 2], their covariance over the variance of runs, residuals, shape [k, n], and weighted
        sums of squares, shape [k].
    """
    cross = inverses @ line
    of_line = np.linalg.inv(line.T @ cross)
    best = (of_line @ (cross.transpose(0, 2, 1) @ y)[..., None])[..., 0]
    residuals = y - best @ line.T
    squares = np.einsum("ki,kij,kj->k", residuals, inverses, residuals, optimize=True)
    return best, of_line, residuals, np.maximum(squares, np.finfo(float).tiny)


def _spline(s: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Covariance of integrated Brownian motion between s, shape [n], and t, shape [m], from 0 on; shape [n, m]."""
    small, large = np.minimum(s[:, None], t), np.maximum(s[:, None], t)
    return small**2 * (3 * large - small) / 6
