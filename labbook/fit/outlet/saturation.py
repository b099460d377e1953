"""How the area fraction in the middle of an outlet grows with its width (Fan et al. 2023, eq 12)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

FEWEST = 4
"""Outlets of different widths without which its three parameters cannot be told."""
_DECAYS = np.geomspace(0.05, 5.0, 400)  # tau_2 d: a decay over 10 d of width, or over a tenth of d


@dataclass(frozen=True)
class Saturation:
    """phi_c = phi_inf (1 - tau1 e^{-2 tau2 R}); tau2 in 1/m."""

    phi_inf: float
    tau1: float
    tau2: float

    def at(self, R: float | np.ndarray) -> np.ndarray:
        """phi_c of outlets of half width R [m]."""
        return self.phi_inf * (1 - self.tau1 * np.exp(-2 * self.tau2 * np.asarray(R, float)))


def fit_saturation(R: Sequence[float], phi_c: Sequence[float], d: float) -> Saturation:
    """Least squares: given tau2 the law is linear in phi_inf and phi_inf tau1, and tau2 is found by a scan.

    R [m] and phi_c of at least 4 outlets; d: diameter of the grains [m]. tau2 d is kept between 0.05 and 5: beyond, an
    exponential is a straight line or a step between the two narrowest outlets. Raises ValueError for fewer outlets.
    """
    if len(set(R)) < FEWEST:
        raise ValueError(f"eq 12 has three parameters: it needs at least {FEWEST} outlets of different widths")
    half, phi = np.asarray(R, float), np.asarray(phi_c, float)
    decay = np.exp(-2 * np.outer(_DECAYS / d, half))
    spread = decay - decay.mean(axis=1, keepdims=True)
    slope = (spread @ phi) / (spread**2).sum(axis=1)
    left = ((phi - phi.mean() - slope[:, None] * spread) ** 2).sum(axis=1)
    best = int(np.argmin(left))
    phi_inf = float(phi.mean() - slope[best] * decay[best].mean())
    return Saturation(phi_inf, float(-slope[best] / phi_inf), float(_DECAYS[best] / d))
