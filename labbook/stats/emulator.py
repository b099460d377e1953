"""Emulator: a response to settings of several keys between runs, with its error, as a Gaussian process.

The response is a plane plus a smooth deviation with a Matérn covariance of order 5/2, one length for each key
(Rasmussen & Williams, Gaussian Processes for Machine Learning, 2006, chapters 2, 4 and 5). The noise of runs and the
covariance of runs of one bed are given. Lengths and size of the deviation maximise the likelihood. Settings are numbers
from 0 to 1.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from typing import Any

import numpy as np

_SLOPES = 4.0
"""Prior standard deviation of the plane's coefficients, over that of the values, for keys from -1 to 1: so wide that
the data decide."""
_LENGTHS = (0.4, 4.0)
"""Bounds of lengths, for keys from -1 to 1. Longer ones gave too small errors in simulations."""
_FAR = 1e6
"""Length of a key without effect. Seeds are scaled down by it beside keys, so that only the covariance of beds
distinguishes them."""
_SIZES = (0.01, 10.0)
"""Bounds of the variance of the deviation, over that of the values: never 0, since data that show no deviation from the
plane do not exclude one."""


class LearnMissing(ImportError):
    """The extra `learn` is not installed."""

    def __init__(self, package: str):
        super().__init__(f"emulators need the package {package}: pip install 'labbook[learn]'")


def check_installed() -> None:
    """Check that the packages of emulators are installed, without importing them. Raises LearnMissing."""
    for package, module in (("scikit-learn", "sklearn"), ("threadpoolctl", "threadpoolctl")):
        if find_spec(module) is None:
            raise LearnMissing(package)


@dataclass(frozen=True, eq=False)
class Emulator:
    """A response fitted to n runs at settings of d keys."""

    _process: Any
    """`GaussianProcessRegressor` of scikit-learn, of values with mean 0 and variance 1."""
    _mean: float
    _scale: float

    @classmethod
    def of(
        cls,
        settings: np.ndarray,
        values: np.ndarray,
        variance: float | np.ndarray,
        beds: np.ndarray,
        of_beds: float = 0.0,
    ) -> "Emulator":
        """Fit the response.

        Args:
            settings: Settings of the runs, from 0 to 1, shape [n, d].
            values: Values of the runs, shape [n].
            variance: Variance of the noise of each run, shape [n], or of all.
            beds: Seeds of the beds, shape [n].
            of_beds: Variance of the contribution that all runs of one bed share.

        Raises:
            LearnMissing: scikit-learn is not installed.
        """
        try:
            from sklearn.exceptions import ConvergenceWarning
            from sklearn.gaussian_process import GaussianProcessRegressor
            from sklearn.gaussian_process.kernels import RBF, ConstantKernel, DotProduct, Matern
            from threadpoolctl import threadpool_limits
        except ImportError as missing:
            raise LearnMissing("scikit-learn") from missing
        noise = np.broadcast_to(variance, len(values))
        settings, values, beds, noise = _with_means(settings, values, beds, noise, of_beds)
        # of rows, so that many beds of one setting change neither; values that are all equal are not divided
        mean, scale = float(np.mean(values)), float(np.std(values)) or 1.0
        d = settings.shape[1]
        lengths, bounds = np.append(np.full(d, 2.0), _FAR), np.array([*[_LENGTHS] * d, (_FAR, _FAR)])
        apart = np.append(np.full(d, _FAR), 1e-3 / _FAR)
        plane = ConstantKernel(_SLOPES**2, "fixed") * DotProduct(1.0, "fixed")
        deviation = ConstantKernel(0.1, _SIZES) * Matern(lengths, bounds, nu=2.5)  # pyright: ignore[reportArgumentType]
        same_bed = ConstantKernel(max(of_beds / scale**2, 1e-12), "fixed") * RBF(apart, "fixed")  # pyright: ignore[reportArgumentType]
        process = GaussianProcessRegressor(plane + deviation + same_bed, alpha=noise / scale**2 + 1e-10)  # pyright: ignore[reportArgumentType]
        with warnings.catch_warnings(), threadpool_limits(1, "blas"):
            warnings.simplefilter("ignore", ConvergenceWarning)  # a length at its bound: the response is a plane there
            process.fit(_rows(settings, beds), (values - mean) / scale)
        return cls(process, mean, scale)

    def at(self, settings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute the response at k settings, shape [k, d], and its standard error, each of shape [k]."""
        mean, covariance = self.joint(settings[:, None, :])
        return mean[:, 0], np.sqrt(covariance[:, 0, 0])

    def joint(self, settings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute k groups of m responses with the covariance of their errors within each group.

        Args:
            settings: Shape [k, m, d].

        Returns:
            Means, shape [k, m], and covariances, shape [k, m, m].
        """
        k, m, d = settings.shape
        mean, pull = self._pull(settings.reshape(k * m, d))
        pull = pull.reshape(-1, k, m)
        prior = np.array([[self._prior(settings[:, i], settings[:, j]) for j in range(m)] for i in range(m)])
        covariance = np.moveaxis(prior, -1, 0) - np.einsum("nki,nkj->kij", pull, pull)
        i = np.arange(m)
        # prior less the information of the runs: rounding may leave a variance below zero at the runs themselves
        covariance[:, i, i] = np.maximum(covariance[:, i, i], 1e-12)
        return mean.reshape(k, m), covariance * self._scale**2

    def covariance(self, settings: np.ndarray) -> np.ndarray:
        """Compute the covariance of the errors at k settings, shape [k, d], among all of them, shape [k, k]."""
        _, pull = self._pull(settings)
        return (self._process.kernel_.k1(_rows(settings)) - pull.T @ pull) * self._scale**2

    def _pull(self, settings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Means at k settings, shape [k], and the root, shape [n, k], of the covariance that the runs remove."""
        between = self._process.kernel_.k1(_rows(settings), self._process.X_train_)
        mean = between @ self._process.alpha_ * self._scale + self._mean
        return mean, self._root @ between.T

    @cached_property
    def _root(self) -> np.ndarray:
        """Inverse of the Cholesky factor of the covariance of the runs, shape [n, n]."""
        return np.linalg.inv(self._process.L_)

    def _prior(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Prior covariance between pairs of settings, each of shape [k, d]: shape [k]."""
        plane, deviation = self._process.kernel_.k1.k1, self._process.kernel_.k1.k2
        x, y = _rows(first), _rows(second)
        r = np.sqrt(5) * np.linalg.norm((x - y) / deviation.k2.length_scale, axis=1)
        flat = plane.k1.constant_value * (plane.k2.sigma_0**2 + (x * y).sum(axis=1))
        return flat + deviation.k1.constant_value * (1 + r + r**2 / 3) * np.exp(-r)


def _rows(settings: np.ndarray, beds: np.ndarray | None = None) -> np.ndarray:
    """Settings from -1 to 1, with a column of tiny numbers for seeds; without `beds`, that of a bed without runs."""
    seeds = np.full(len(settings), -1.0) if beds is None else np.asarray(beds, float)
    return np.column_stack([2 * settings - 1, seeds / _FAR])


def _with_means(
    settings: np.ndarray, values: np.ndarray, beds: np.ndarray, noise: np.ndarray, of_beds: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Replace runs at one setting, whose beds have no other run, by their mean, which has the same information.

    The covariance of beds counts that of one bed for each row, and the mean of m beds has an m-th of it. The noise of
    such a row is therefore less by the difference, and may be below zero; their sum is not.

    Returns:
        Settings, values and beds of r <= n rows, and their variances of noise, shape [r].
    """
    _, of_bed, runs = np.unique(beds, return_inverse=True, return_counts=True)
    _, of_setting = np.unique(settings, axis=0, return_inverse=True)
    # runs of a bed with several are rows of their own; others are named by their setting
    names = np.where(runs[of_bed] == 1, of_setting.ravel(), of_setting.max() + 1 + np.arange(len(beds)))
    _, first, of_row, counts = np.unique(names, return_index=True, return_inverse=True, return_counts=True)
    means, noises = (np.bincount(of_row.ravel(), of) / counts for of in (values, noise))
    return settings[first], means, beds[first], (noises + of_beds) / counts - of_beds


def best_settings(
    covariances: Sequence[np.ndarray], noises: Sequence[float | np.ndarray], weights: Sequence[np.ndarray], number: int
) -> list[int]:
    """Choose the runs that lower the variance of emulators most.

    Each run is the best one given those before, by the sum of variances over all candidates. That is the criterion of
    Cohn (Adv. Neural Inf. Process. Syst. 6 (1994) 679), which does not depend on the results of the runs.

    Args:
        covariances: Covariance of the errors of each emulator among k candidates, shape [k, k].
        noises: Variance of a run about each emulator: at all candidates, or at each, shape [k].
        weights: Weight of the variance of each emulator at the candidates, shape [k].
        number: Number of runs.

    Returns:
        Indices of candidates.
    """
    remaining = [covariance.copy() for covariance in covariances]
    of_runs = [np.broadcast_to(noise, len(C)) for noise, C in zip(noises, remaining, strict=True)]
    picks = list[int]()
    for _ in range(number):
        gain = np.zeros(len(remaining[0]))
        for C, noise, weight in zip(remaining, of_runs, weights, strict=True):
            gain += weight @ C**2 / (np.diag(C) + noise)
        best = int(np.argmax(gain))
        picks.append(best)
        for C, noise in zip(remaining, of_runs, strict=True):
            C -= np.outer(C[:, best], C[best]) / (C[best, best] + noise[best])
    return picks
