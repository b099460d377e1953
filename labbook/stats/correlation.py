"""Errors of a mean within one run: autocorrelation and block means.

They check the seed-to-seed error; they do not replace it. The outflow of a hopper is anticorrelated: after many grains
fewer follow. So the statistical inefficiency is often below 1, and it is not forced to be 1 or more.
"""

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Correlated:
    """Mean of a correlated series.

    Attributes:
        mean: The mean.
        error: Its standard error.
        inefficiency: g = 1 + 2 sum rho_k, such that the squared error of the mean is g s^2/n; below 1 for
            anticorrelated series.
    """

    mean: float
    error: float
    inefficiency: float


def autocorrelation(series: np.ndarray) -> np.ndarray:
    """Autocorrelation rho_k of a series, shape [n], rho_0 = 1; positive definite (divided by n at every lag).

    Raises ValueError for a series that is constant or shorter than 2.
    """
    x = np.asarray(series, float) - np.mean(series)
    n = len(x)
    if n < 2 or not np.any(x):
        raise ValueError("a constant series has no autocorrelation")
    size = 1 << (2 * n - 1).bit_length()  # padded with zeros, so that the circular correlation does not wrap around
    spectrum = np.fft.rfft(x, size)
    covariance = np.fft.irfft(spectrum * spectrum.conj(), size)[:n]
    return covariance / covariance[0]


def correlated_mean(series: np.ndarray) -> Correlated:
    """Mean of a stationary series and its standard error from the integrated autocorrelation.

    The sum over lags has a flat-top window whose width follows from the data: twice the first lag after which the
    correlation stays insignificant (Politis, J. Nonparametr. Stat. 15 (2003) 517). A weak correlation over many
    samples, below strong noise, is significant at no single lag and is missed: average neighbouring samples first, or
    use blocks.
    """
    x = np.asarray(series, float)
    n = len(x)
    mean, spread = float(x.mean()), float(x.std(ddof=1)) if n > 1 else math.nan
    if n < 2 or spread == 0:
        return Correlated(mean, spread, math.nan)
    rho = autocorrelation(x)
    width = _significant_lags(rho)
    lags = np.arange(1, min(2 * width, n - 1) + 1)
    window = np.clip(2 * (1 - lags / (2 * width)), 0, 1) if width else np.zeros(0)
    # The sum may be zero or negative for a perfectly regular series. Its bound is 1/n: the scatter of one interval at
    # the ends of the window.
    inefficiency = max(1 + 2 * float(np.sum(window * rho[lags])), 1 / n)
    error = spread * math.sqrt(inefficiency / n)
    return Correlated(mean, error, inefficiency)


def _significant_lags(rho: np.ndarray) -> int:
    """Find the lag after which at least five in a row are below 2 sqrt(log10 n / n) (Politis' rule)."""
    n = len(rho)
    quiet = np.abs(rho) < 2 * math.sqrt(math.log10(n) / n)
    run = max(5, math.ceil(math.sqrt(math.log10(n))))
    longest = max(1, n // 4)  # beyond a quarter of the series the estimates are noise
    for lag in range(longest):
        if quiet[lag + 1 : lag + 1 + run].all():
            return lag
    return longest


@dataclass(frozen=True)
class Blocks:
    """Means over equal blocks of a series, shape [n], and the standard error of their mean."""

    means: np.ndarray
    error: float


def block_mean(series: np.ndarray, blocks: int = 10) -> Blocks:
    """Compute means over equal blocks, with the error of their mean.

    Args:
        series: The series; a remainder at its start is left out.
        blocks: Number of blocks, which must be much longer than the correlation.

    Raises:
        ValueError: There are fewer than 2 blocks, or fewer samples than blocks.
    """
    x = np.asarray(series, float)
    length = len(x) // blocks if blocks >= 2 else 0
    if length < 1:
        raise ValueError(f"{len(x)} samples cannot be cut into {blocks} blocks; at least 2 blocks are needed")
    means = x[len(x) - length * blocks :].reshape(blocks, length).mean(axis=1)
    return Blocks(means, float(means.std(ddof=1)) / math.sqrt(blocks))
