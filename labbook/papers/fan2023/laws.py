"""Laws of Fan et al. (2023): profiles along an outlet, the flow rate that follows from them, and their dependences.

Eqs 10, 12, 14 to 18, and the fit of eq 12 and of the approach in its Fig. 11. Flow through a slot, derived again: a
layer of spheres of diameter d whose discs cover the part phi of the outlet line carries the mass
W = (2/3) d rho_p int phi v dx, the integral from -R to R; with x = R u and int (1 - u^2)^p du = beta(1/2, 1 + p).

Centred: v = v_c (1 - u^2)^a and phi = phi_c (1 - u^2)^b give

    W = (2/3) d rho_p phi_c v_c R beta(1/2, 1 + a + b),

which with v_c = sqrt(2 g gamma R) is the printed eq 14 except for one letter. In print, phi_c is replaced by its limit
phi_inf for wide outlets, so that the flow through narrow ones is overestimated.

Eccentric: v = sqrt(2 g R) [delta1 u + eps1 (1 - u^2)^sigma1] and phi = phi_max [delta2 u + eps2 (1 - u^2)^sigma2]. The
mixed terms are odd, int u^2 du = 2/3, and

    W = (2/3) d rho_p phi_max sqrt(2 g R) R [(2/3) delta1 delta2 + eps1 eps2 beta(1/2, 1 + sigma1 + sigma2)].

The printed eq 18 has beta(1, .) in place of beta(1/2, .), which is twice the integral over u^2 instead of u, and `v`
for sqrt(2 g R). With delta = 0, eps1 = sqrt(gamma), eps2 = 1 it would not reduce to eq 14.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from labbook.fit import Parameter
from labbook.fit.band import half_width, law_error
from labbook.measure.outlet import ProfileAcross
from labbook.stats.pooling import student

# Bins lie in pairs about the middle, so that the dome, which is even, and x*, which is odd, are orthogonal: amplitude
# and tilt follow from one product each, and only the exponent has to be looked for.

EXPONENTS = np.linspace(0.0, 2.0, 401)
"""Exponents of the scan; the fit interpolates between them by a parabola."""


def tilted(x: np.ndarray, exponent: float, tilt: float = 0.0) -> np.ndarray:
    """tilt x + (1 - x^2)^p at places x* (Fan et al. 2023, eqs 16 and 17 over their epsilon); without tilt, the dome."""
    return tilt * x + (1 - x**2) ** exponent


def middle_speed(gamma: float, R: float | np.ndarray, g: float) -> np.ndarray:
    """v_c = sqrt(2 g gamma R) [m/s] in the middle of an outlet of half width R [m] (Fan et al. 2023, eq 10)."""
    return np.sqrt(2 * g * gamma * np.asarray(R, float))


def dome(edges: np.ndarray, exponent: float | np.ndarray) -> np.ndarray:
    """Mean of (1 - x^2)^p over each bin, exact by incomplete beta functions.

    Args:
        edges: Edges of the bins, x* from -1 to 1, shape [m + 1].
        exponent: Exponents p, of any shape.

    Returns:
        Means, shape of `exponent` + [m].
    """
    from scipy.special import beta, betainc

    p = np.asarray(exponent, float)[..., None]
    upto = 0.5 * np.sign(edges) * beta(0.5, p + 1) * betainc(0.5, p + 1, np.minimum(edges**2, 1.0))
    return np.diff(upto, axis=-1) / np.diff(edges)


@lru_cache(maxsize=64)
def _domes(edges: bytes) -> np.ndarray:
    return dome(np.frombuffer(edges), EXPONENTS)


@dataclass(frozen=True, eq=False)
class Tilted:
    """Fitted profiles y_j = A_j dome^p + B_j x*: one exponent for all profiles j, amplitudes and tilts of shape [j]."""

    exponent: float
    amplitude: np.ndarray
    tilt: np.ndarray


def fit_dome(outlets: Sequence[ProfileAcross], values: Sequence[np.ndarray], *, one_amplitude: bool = False) -> Tilted:
    """Fit profiles that share their exponent by least squares.

    Args:
        outlets: Bins of each profile.
        values: Values of each profile, shape [m]. Bins without a value (NaN: no grain was ever there) are left out in
            pairs about the middle, so that dome and tilt stay orthogonal.
        one_amplitude: Profiles share amplitude and tilt too, and are not scaled. Otherwise every profile has the same
            weight, in units of its own mean.
    """
    explained = np.zeros(len(EXPONENTS))
    products, norms, tilts, spans = [], [], [], []
    for outlet, profile in zip(outlets, values, strict=True):
        finite = np.isfinite(profile)
        inside = outlet.inside & finite & finite[::-1]
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
    # the scanned sums are smooth in the exponent: a parabola through the largest resolves it below the spacing
    at, exponent = _top(explained)
    product = np.array([np.interp(exponent, EXPONENTS[at : at + 3], p[at : at + 3]) for p in products])
    norm = np.array([np.interp(exponent, EXPONENTS[at : at + 3], n[at : at + 3]) for n in norms])
    tilt, span = np.array(tilts), np.array(spans)
    if one_amplitude:
        shared = np.ones(len(product))
        return Tilted(exponent, shared * product.sum() / norm.sum(), shared * tilt.sum() / span.sum())
    return Tilted(exponent, product / norm, tilt / span)


def _top(explained: np.ndarray) -> tuple[int, float]:
    """Find the largest of a row of values: index of the first of three neighbours, and exponent by their parabola."""
    at = int(np.clip(np.argmax(explained) - 1, 0, len(explained) - 3))
    a, b, c = explained[at : at + 3]
    bend = a - 2 * b + c
    shift = float(np.clip(0.5 * (a - c) / bend, -1, 1)) if bend < 0 else 0.0
    if np.argmax(explained) in (0, len(explained) - 1):
        shift = -1.0 if np.argmax(explained) == 0 else 1.0
    return at, float(EXPONENTS[at + 1] + shift * (EXPONENTS[1] - EXPONENTS[0]))


FEWEST = 4
"""Fewest places that determine the three parameters of a law: widths of outlets (eq 12), or s*."""
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
    """Fit eq 12 by least squares: it is linear in phi_inf and phi_inf tau1 at a given tau2, which is scanned.

    Args:
        R: Half widths of at least 4 outlets [m].
        phi_c: Area fraction in the middle of each.
        d: Diameter of the grains [m]. tau2 d is scanned from 0.05 to 5: beyond, an exponential is a straight line or a
            step between the two narrowest outlets.

    Raises:
        ValueError: There are fewer outlets.
    """
    if len(set(R)) < FEWEST:
        raise ValueError(f"eq 12 has three parameters: it needs at least {FEWEST} outlets of different widths")
    half, phi = np.asarray(R, float), np.asarray(phi_c, float)
    decay = np.exp(-2 * np.outer(_DECAYS / d, half))
    spread = decay - decay.mean(axis=1, keepdims=True)
    slope = (spread @ phi) / (spread**2).sum(axis=1)
    squares = ((phi - phi.mean() - slope[:, None] * spread) ** 2).sum(axis=1)
    best = int(np.argmin(squares))
    phi_inf = float(phi.mean() - slope[best] * decay[best].mean())
    return Saturation(phi_inf, float(-slope[best] / phi_inf), float(_DECAYS[best] / d))


_RATES = np.geomspace(0.1, 100.0, 600)
"""Rates of the scan: slower than 0.1 is a straight line over s* from 0 to 1, faster than 100 a step."""


TERMS = ("limit", "depth", "rate")
"""Names of the parameters of an approach."""


@dataclass(frozen=True, eq=False)
class Approach:
    """Law y = limit - depth e^{-rate s*}, such as the paper's sigma1 = 0.39 - 0.12 e^{-3.74 s*}.

    Args:
        limit: Value far from the wall.
        depth: Limit less the value at the wall.
        rate: Rate of the decay in s*.
        covariance: Of limit, depth and rate, shape [3, 3], from the scatter of the points about the law; infinite if
            the rate lies at an end of the scan.
        freedom: Degrees of freedom.
        scatter: Standard error of a point about the law.
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
    """Fit by least squares: the law is linear at a given rate, which is scanned.

    All points have the same weight: standard errors from a few seeds are too noisy for weights.

    Args:
        s: Distances from the wall s*, at least 4 different ones.
        values: Value at each.

    Raises:
        ValueError: There are fewer different s*.
    """
    if len(set(s)) < FEWEST:
        raise ValueError(f"an approach has three parameters: it needs at least {FEWEST} different s*")
    positions, y = np.asarray(s, float), np.asarray(values, float)
    decay = np.exp(-np.outer(_RATES, positions))
    spread = decay - decay.mean(axis=1, keepdims=True)
    slope = spread @ y / (spread**2).sum(axis=1)
    squares = ((y - y.mean() - slope[:, None] * spread) ** 2).sum(axis=1)
    best = int(np.argmin(squares))
    limit, depth, rate = float(y.mean() - slope[best] * decay[best].mean()), float(-slope[best]), float(_RATES[best])
    freedom = len(y) - 3
    covariance = np.full((3, 3), math.inf)
    if 0 < best < len(_RATES) - 1:
        slopes = _slopes(positions, depth, rate)
        # pseudo-inverse: without any depth the rate has no effect, and the matrix is singular
        covariance = squares[best] / freedom * np.linalg.pinv(slopes.T @ slopes)
    return Approach(limit, depth, rate, covariance, freedom, math.sqrt(squares[best] / freedom))


def _slopes(s: np.ndarray, depth: float, rate: float) -> np.ndarray:
    """Derivatives of the law by limit, depth and rate, shape [n, 3]."""
    decay = np.exp(-rate * s)
    return np.stack([np.ones(len(s)), -decay, depth * s * decay], axis=1)


def centred_flow(d: float, rho_p: float, phi_c: float, v_c: float, R: float, a: float, b: float) -> float:
    """W [kg/s] of centred profiles: d [m], rho_p [kg/m^3], v_c [m/s], R [m]."""
    from scipy.special import beta

    return 2 / 3 * d * rho_p * phi_c * v_c * R * float(beta(0.5, 1 + a + b))


def eccentric_flow(
    d: float,
    rho_p: float,
    g: float,
    R: float,
    phi_max: float,
    velocity: tuple[float, float, float],
    area_fraction: tuple[float, float, float],
) -> float:
    """W [kg/s] of tilted profiles; `velocity` and `area_fraction` are (delta, eps, sigma) of each."""
    from scipy.special import beta

    (delta1, eps1, sigma1), (delta2, eps2, sigma2) = velocity, area_fraction
    integral = 2 / 3 * delta1 * delta2 + eps1 * eps2 * float(beta(0.5, 1 + sigma1 + sigma2))
    return 2 / 3 * d * rho_p * phi_max * math.sqrt(2 * g * R) * R * integral


# Dependence of the flow rate on the angle [rad] of the bottom from the vertical, relative to a flat bottom (90 deg):
# laws without free parameters.


def brown(angle: float) -> float:
    """Brown's factor int_0^a sqrt(cos x) dx / sin^{3/2} a over its value at 90 deg, 1.198 (Nature 191 (1961) 458;
    Fan et al. 2023, eq 3).

    From the least energy of grains that fall freely from an arch. It grows as a^{-1/2} for steep bottoms. Raises
    ValueError for an angle that is not above 0 and at most 90 deg.
    """
    return _brown(_checked(angle)) / _brown(math.pi / 2)


def _brown(angle: float) -> float:
    from scipy.integrate import quad

    # x = pi/2 - y^2 takes the root out of the end at 90 deg
    low = math.sqrt(max(math.pi / 2 - angle, 0.0))
    integral, _ = quad(
        lambda y: 2 * y * math.sqrt(math.sin(y * y)), low, math.sqrt(math.pi / 2), epsabs=0, epsrel=1e-12
    )
    return integral / math.sin(angle) ** 1.5


def rose_tanaka(angle: float, friction_angle: float) -> float:
    """(tan a tan phi_d)^{-0.35} for a < 90 deg - phi_d, else 1 (Rose & Tanaka, Engineer 208 (1959) 465).

    `friction_angle` phi_d [rad]: the angle between the stagnant zone and the horizontal; where it is not known the
    arctangent of the friction of the grains may stand for it. Raises ValueError for angles out of range.
    """
    angle = _checked(angle)
    if not 0 < friction_angle < math.pi / 2:
        raise ValueError(
            f"the angle of friction lies between 0 and 90 deg, not at {math.degrees(friction_angle):g} deg"
        )
    if angle >= math.pi / 2 - friction_angle:
        return 1.0
    return (math.tan(angle) * math.tan(friction_angle)) ** -0.35


def _checked(angle: float) -> float:
    if not 0 < angle <= math.pi / 2 * (1 + 1e-9):
        raise ValueError(f"the angle of a bottom lies between 0 and 90 deg, not at {math.degrees(angle):g} deg")
    return min(angle, math.pi / 2)
