"""The shape that profiles along an outlet share: a dome (1 - x*^2)^p, and its tilt.

Bins lie in pairs about the middle, so that the dome, which is even, and x*, which is odd, are orthogonal: amplitude and
tilt follow from one product each, and only the exponent has to be looked for.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

EXPONENTS = np.linspace(0.0, 2.0, 401)
"""Where the exponent is looked for; it is found between these by a parabola."""


@dataclass(frozen=True, eq=False)
class Outlet:
    """Profiles along one outlet, of one run or the mean of several.

    `R`: half width of the outlet [m]; `edges`: of the bins, in x* = (x - e)/R from -1 to 1, shape [m + 1];
    `area_fraction` phi and `flux` phi v [m/s], shape [m]; `reach`: x* up to which bins are fitted. `counted`: flow rate
    counted [kg/s].
    """

    R: float
    edges: np.ndarray
    area_fraction: np.ndarray
    flux: np.ndarray
    reach: float
    counted: float

    @property
    def velocity(self) -> np.ndarray:
        """v = phi v / phi [m/s], shape [m]; NaN where no grain ever was."""
        empty = np.full_like(self.flux, np.nan)
        return np.divide(self.flux, self.area_fraction, out=empty, where=self.area_fraction > 0)

    @property
    def inside(self) -> np.ndarray:
        """Which bins lie within `reach`, shape [m]."""
        return np.maximum(abs(self.edges[1:]), abs(self.edges[:-1])) <= self.reach * (1 + 1e-9)

    @property
    def seen(self) -> bool:
        """Whether there is a shape to fit: grains that move, in bins within `reach` on both sides of the middle."""
        known = np.isfinite(self.velocity)
        pairs = self.inside & known & known[::-1]
        return bool((np.abs(self.flux[pairs]) > 0).any())


def mean_of(outlets: Sequence[Outlet]) -> Outlet:
    """The mean of several runs through equal outlets; velocities weigh by the time that grains were there."""
    first = outlets[0]
    return Outlet(
        first.R,
        first.edges,
        np.mean([one.area_fraction for one in outlets], axis=0),
        np.mean([one.flux for one in outlets], axis=0),
        first.reach,
        float(np.mean([one.counted for one in outlets])),
    )


def tilted(x: np.ndarray, exponent: float, tilt: float = 0.0) -> np.ndarray:
    """tilt x + (1 - x^2)^p at places x* (Fan et al. 2023, eqs 16 and 17 over their epsilon); without tilt, the dome."""
    return tilt * x + (1 - x**2) ** exponent


def middle_speed(gamma: float, R: float | np.ndarray, g: float) -> np.ndarray:
    """v_c = sqrt(2 g gamma R) [m/s] in the middle of outlets of half widths R [m] (Fan et al. 2023, eq 10)."""
    return np.sqrt(2 * g * gamma * np.asarray(R, float))


def dome(edges: np.ndarray, exponent: float | np.ndarray) -> np.ndarray:
    """Mean of (1 - x^2)^p over each bin: exact, by incomplete beta functions; shape of `exponent` + [m]."""
    from scipy.special import beta, betainc

    p = np.asarray(exponent, float)[..., None]
    upto = 0.5 * np.sign(edges) * beta(0.5, p + 1) * betainc(0.5, p + 1, np.minimum(edges**2, 1.0))
    return np.diff(upto, axis=-1) / np.diff(edges)


@lru_cache(maxsize=64)
def _domes(edges: bytes) -> np.ndarray:
    return dome(np.frombuffer(edges), EXPONENTS)


@dataclass(frozen=True, eq=False)
class Tilted:
    """y_j = A_j dome^p + B_j x*: the exponent shared by all profiles j, amplitudes and tilts of each, shape [j]."""

    exponent: float
    amplitude: np.ndarray
    tilt: np.ndarray


def fit_dome(outlets: Sequence[Outlet], values: Sequence[np.ndarray], *, one_amplitude: bool = False) -> Tilted:
    """Least squares of profiles `values`, one an outlet, shape [m] each, that share their exponent.

    Every profile weighs alike, in units of its own mean. Bins where there is no value (NaN: no velocity where no grain
    ever was) are left out in pairs about the middle. `one_amplitude`: amplitude and tilt are shared, too, and
    profiles are taken as they are.
    """
    explained = np.zeros(len(EXPONENTS))
    products, norms, tilts, spans = [], [], [], []
    for outlet, profile in zip(outlets, values, strict=True):
        known = np.isfinite(profile)
        inside = outlet.inside & known & known[::-1]
        y = np.asarray(profile, float)[inside]
        scale = 1.0 if one_amplitude else 1 / float(y.mean())
        shapes = _domes(np.ascontiguousarray(outlet.edges, float).tobytes())[:, inside]
        middle = ((outlet.edges[1:] + outlet.edges[:-1]) / 2)[inside]
        products.append(shapes @ y)
        norms.append((shapes**2).sum(axis=1))
        tilts.append(float(middle @ y))
        spans.append(float(middle @ middle))
        if not one_amplitude:
            explained += (scale * products[-1]) ** 2 / norms[-1]
    if one_amplitude:
        explained = np.sum(products, axis=0) ** 2 / np.sum(norms, axis=0)
    at, exponent = _top(explained)
    product = np.array([np.interp(exponent, EXPONENTS[at : at + 3], p[at : at + 3]) for p in products])
    norm = np.array([np.interp(exponent, EXPONENTS[at : at + 3], n[at : at + 3]) for n in norms])
    tilt, span = np.array(tilts), np.array(spans)
    if one_amplitude:
        same = np.ones(len(product))
        return Tilted(exponent, same * product.sum() / norm.sum(), same * tilt.sum() / span.sum())
    return Tilted(exponent, product / norm, tilt / span)


def _top(explained: np.ndarray) -> tuple[int, float]:
    """Where a row of values is largest: the first of three neighbours, and the exponent by a parabola through them."""
    at = int(np.clip(np.argmax(explained) - 1, 0, len(explained) - 3))
    a, b, c = explained[at : at + 3]
    bend = a - 2 * b + c
    shift = float(np.clip(0.5 * (a - c) / bend, -1, 1)) if bend < 0 else 0.0
    if np.argmax(explained) in (0, len(explained) - 1):
        shift = -1.0 if np.argmax(explained) == 0 else 1.0
    return at, float(EXPONENTS[at + 1] + shift * (EXPONENTS[1] - EXPONENTS[0]))
