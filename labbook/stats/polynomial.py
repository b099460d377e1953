"""A number against several settings at once: a polynomial through the runs, with its covariance and its lack of fit.

The number is the sum of a plane, a smooth deviation from it, a deviation of each design by itself (the misfit), and
contributions of the bed of a run and of its flow. The deviation is a sum of Legendre polynomials. Their coefficients
have prior mean zero and a prior standard deviation that falls with the cube of the degree, as for a smoothing spline
(Wahba, J. R. Stat. Soc. B 40 (1978) 364; `labbook.stats.response` for one setting). Size of the deviation, misfit and
share of the beds are averaged over by their restricted likelihood; the scatter leads to Student's t. So an interval
includes the noise of the runs and the possible course of the number between them. The result is one vector of
coefficients with one covariance matrix, which a page evaluates without Python.

The polynomials are orthonormal over the swept range. A share of the variance (Sobol, Math. Comput. Simul. 55 (2001)
271) is then a sum of squared coefficients, and the mean variance of the surface the trace of their covariance.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from labbook.stats.nested import bed_prior
from labbook.stats.pooling import student

DEGREES = (7, 5, 5, 4, 3)
"""Degree of the polynomial by the number of settings, from one on; with more settings the degree is 2."""
_SHARES = np.array([0.05, 0.2, 0.45])
"""Shares of the beds in the variance of runs that are averaged over."""
_SIZES = np.logspace(-1, 2.5, 8)
"""Sizes of the smooth deviation that are averaged over, over the scatter of runs."""
_DECAY, _MIXED = 3.0, 0.5
"""Exponent with which coefficients fall with the degree, and their factor for each further setting in a term. Chosen by
simulation of plain, bent and wavy responses with known answers: intervals hold 93 to 100 % of them."""
_MISFITS = np.array([0.0, 0.5, 2.0])
"""Standard deviations of the misfit that are averaged over, over the scatter of runs."""
_DRAWS = 4000
"""Number of draws of the coefficients for the intervals of shares."""
_EDGE = 1e-9
"""Tolerance of the range, in half ranges."""


@dataclass(frozen=True, eq=False)
class Polynomial:
    """A polynomial of k settings from -1 to 1, fitted to n runs at m designs.

    Attributes:
        degrees: Degree of each of p terms in each setting, shape [p, k].
        coefficients: Coefficients of the terms, shape [p].
        covariance: Covariance of the coefficients, shape [p, p].
        misfit: Standard deviation of the designs about the polynomial.
        scatter: Standard deviation of runs of one design.
        freedom: Degrees of freedom of the intervals.
        lack_of_fit: Probability of a larger distance of the designs from the surface if it were true (F test against
            the scatter of replicates); NaN without degrees of freedom.
        hull: Half-spaces whose intersection is the convex hull of the designs: `hull[:, :k] @ u + hull[:, k] <= 0`.
    """

    degrees: np.ndarray
    coefficients: np.ndarray
    covariance: np.ndarray
    misfit: float
    scatter: float
    freedom: int
    lack_of_fit: float
    hull: np.ndarray

    @classmethod
    def of(
        cls, settings: np.ndarray, values: Sequence[float] | np.ndarray, beds: Sequence[int] | np.ndarray
    ) -> "Polynomial":
        """Fit a polynomial to runs.

        Args:
            settings: Settings of the runs, from -1 to 1, shape [n, k].
            values: Values of the runs, shape [n].
            beds: Seeds of their beds, shape [n].

        Raises:
            ValueError: The runs do not determine a plane and its error.
        """
        u, y, seeds = np.asarray(settings, float), np.asarray(values, float), np.asarray(beds)
        designs, of_run = np.unique(u.round(12), axis=0, return_inverse=True)
        if len(np.unique(seeds)) < 2:
            raise ValueError("all values are of one bed, whose scatter is not known; use replicates: 2 or more")
        if len(designs) < u.shape[1] + 2:
            raise ValueError(f"{len(designs)} designs are too few: a surface over {u.shape[1]} keys needs "
                             f"{u.shape[1] + 2}")  # fmt: skip
        hull, degrees = _hull(designs), _degrees(u.shape[1])
        return cls(
            degrees,
            *_fit(_basis(u, degrees), degrees.sum(axis=1), (degrees > 0).sum(axis=1), y, seeds, of_run.ravel()),
            hull,
        )

    @property
    def student(self) -> float:
        """Half width of a 95 % interval, in standard errors."""
        return student(0.95, self.freedom)

    def basis(self, settings: np.ndarray) -> np.ndarray:
        """Compute all terms at m settings, shape [m, p]."""
        return _basis(np.atleast_2d(settings), self.degrees)

    def inside(self, settings: np.ndarray) -> np.ndarray:
        """Mark the settings within the hull of the designs, of m settings: shape [m]."""
        u = np.atleast_2d(settings)
        return np.all(u @ self.hull[:, :-1].T + self.hull[:, -1] <= _EDGE, axis=1)

    def at(self, settings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute the number at m settings and the half width of its 95 % interval, each of shape [m].

        Raises:
            ValueError: Settings are outside the hull of the designs.
        """
        if not self.inside(settings).all():
            raise ValueError("the surface is known between its points only")
        terms = self.basis(settings)
        variance = ((terms @ self.covariance) * terms).sum(axis=1) + self.misfit**2
        return terms @ self.coefficients, self.student * np.sqrt(variance)

    def line(self, factor: int, settings: np.ndarray) -> tuple[float, float] | None:
        """Find the part of a line along one setting within the hull.

        Args:
            factor: Index of the setting that varies.
            settings: Values of all settings, shape [k]; that of `factor` is ignored.

        Returns:
            Smallest and largest value of the setting; None if the line does not meet the hull.
        """
        fixed = np.array(settings, float)
        fixed[factor] = 0.0
        slope, offset = self.hull[:, factor], self.hull[:, :-1] @ fixed + self.hull[:, -1]
        flat = np.abs(slope) < _EDGE
        ends = -offset[~flat] / slope[~flat]
        low = max(ends[slope[~flat] < 0], default=-math.inf)
        high = min(ends[slope[~flat] > 0], default=math.inf)
        return (low, high) if (offset[flat] <= _EDGE).all() and high - low > -_EDGE else None

    def shares(self, trends: Mapping[int, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Compute the parts of the variance over the range that each setting explains alone, and all together.

        The interval holds both the percentile and the basic interval of draws of the coefficients, so that it reaches
        zero for a setting without an effect.

        Args:
            trends: Known trend of the number in a setting, besides the polynomial: coefficients of orthonormal Legendre
                polynomials from degree 1 on, by index of the setting.

        Returns:
            Parts, and lower and upper ends of their 95 % intervals, each of shape [k + 1]; the last is the part that
            settings explain only together.
        """
        rng = np.random.default_rng(1)
        root = np.linalg.cholesky(self.covariance + 1e-14 * np.trace(self.covariance) * np.eye(len(self.covariance)))
        wide = np.sqrt(self.freedom / rng.chisquare(self.freedom, _DRAWS))[:, None]
        draws = self.coefficients + wide * (rng.standard_normal((_DRAWS, len(root))) @ root.T)
        best, random = (self._terms(sets, trends) for sets in (self.coefficients[None], draws))
        low, high = np.quantile(random, [0.025, 0.975], axis=0)
        # a squared coefficient exceeds its true value by its variance on average: the mean of the draws is as far above
        # the estimate as that is above the truth
        value = 2 * best[0] - random.mean(axis=0)
        ends = np.minimum(low, 2 * best[0] - high), np.maximum(high, 2 * best[0] - low)
        low, high = (np.clip(end, 0.0, 1.0) for end in ends)
        return np.clip(value, low, high), low, high

    def _terms(self, coefficients: np.ndarray, trends: Mapping[int, np.ndarray]) -> np.ndarray:
        """Parts of the variance for each of m vectors of coefficients, shape [m, k + 1]."""
        involved = (self.degrees > 0).sum(axis=1)
        squares = np.zeros((len(coefficients), self.degrees.shape[1] + 1))
        squares[:, -1] = (coefficients[:, involved > 1] ** 2).sum(axis=1)
        for factor in range(self.degrees.shape[1]):
            own = (involved == 1) & (self.degrees[:, factor] > 0)
            trend = trends.get(factor, np.zeros(0))
            total = np.zeros((len(coefficients), max([len(trend), *self.degrees[own, factor]])))
            total[:, : len(trend)] = trend
            total[:, self.degrees[own, factor] - 1] += coefficients[:, own]
            squares[:, factor] = (total**2).sum(axis=1)
        return squares / squares.sum(axis=1, keepdims=True)

    def change(self, factor: int) -> tuple[float, float]:
        """Compute the change from the lower to the upper end of a setting, averaged over the others.

        Returns:
            The change, and the half width of its 95 % interval.
        """
        own = (self.degrees > 0).sum(axis=1) == (self.degrees[:, factor] > 0)
        ends = np.zeros((2, self.degrees.shape[1]))
        ends[:, factor] = -1, 1
        terms = np.where(own, self.basis(ends), 0.0)
        contrast = terms[1] - terms[0]
        return float(contrast @ self.coefficients), self.student * math.sqrt(contrast @ self.covariance @ contrast)

    @property
    def mean_variance(self) -> float:
        """Variance of the polynomial, averaged over the range."""
        return float(np.trace(self.covariance))

    def removed(self, settings: np.ndarray, before: np.ndarray, after: int) -> np.ndarray:
        """Compute the mean variance that more beds of each of m designs would remove, shape [m].

        Args:
            settings: Settings of the designs, shape [m, k].
            before: Present beds of each design, shape [m].
            after: Beds of each design then.
        """
        terms, weight = self.basis(settings), self._added(before, after)
        pull = terms @ self.covariance  # Sherman-Morrison: each design adds one observation to the information
        return weight * (pull**2).sum(axis=1) / (1 + weight * (pull * terms).sum(axis=1))

    def with_beds(self, settings: np.ndarray, before: int, after: int) -> "Polynomial":
        """Return the polynomial with its covariance after more beds of one design; arguments as for `removed`."""
        (terms,), (weight,) = self.basis(settings), self._added(np.array([before]), after)
        pull = self.covariance @ terms
        return replace(self, covariance=self.covariance - weight * np.outer(pull, pull) / (1 + weight * terms @ pull))

    def _added(self, before: np.ndarray, after: int) -> np.ndarray:
        """Weights that more beds add to m designs, shape [m]: inverse variances of their means."""
        now, then = (beds / (self.misfit**2 * beds + self.scatter**2) for beds in (before, np.maximum(before, after)))
        return then - now


def legendre(function: Any, degree: int) -> np.ndarray:
    """Expand a function of u from -1 to 1 in orthonormal Legendre polynomials, from degree 1 to `degree`."""
    nodes, weights = np.polynomial.legendre.leggauss(2 * degree)
    values = function(nodes) * weights / 2
    return np.array([values @ _orthonormal(nodes, order) for order in range(1, degree + 1)])


def _orthonormal(u: np.ndarray, degree: int) -> np.ndarray:
    """Legendre polynomial with mean square 1 over -1 to 1."""
    return math.sqrt(2 * degree + 1) * np.polynomial.legendre.legval(u, [0] * degree + [1])


def _basis(u: np.ndarray, degrees: np.ndarray) -> np.ndarray:
    highest = int(degrees.max())
    powers = np.stack([_orthonormal(u, degree) for degree in range(highest + 1)])  # [degree, n, k]
    terms = np.ones((len(u), len(degrees)))
    for factor in range(u.shape[1]):
        terms *= powers[degrees[:, factor], :, factor].T
    return terms


def _degrees(factors: int) -> np.ndarray:
    """Degree of each term in each of k settings, shape [p, k], in order of the total degree."""
    highest = DEGREES[factors - 1] if factors <= len(DEGREES) else 2
    candidates = (degrees for degrees in product(range(highest + 1), repeat=factors) if sum(degrees) <= highest)
    return np.array(sorted(candidates, key=lambda degrees: (sum(degrees), degrees[::-1])))


def _hull(designs: np.ndarray) -> np.ndarray:
    """Half-spaces of the convex hull of m designs, shape [h, k + 1]."""
    if designs.shape[1] == 1:
        return np.array([[1.0, -designs.max()], [-1.0, designs.min()]])
    from scipy.spatial import ConvexHull, QhullError

    try:
        equations = ConvexHull(designs).equations
    except (QhullError, ValueError):
        raise ValueError(
            "the designs lie on a line or a plane, so that the effects of the keys cannot be separated"
        ) from None
    return np.unique(equations.round(12), axis=0)


def _fit(x: np.ndarray, degree: np.ndarray, mixed: np.ndarray, y: np.ndarray, seeds: np.ndarray, of_run: np.ndarray):
    """Fit p terms to n runs.

    Args:
        x: Terms at each run, shape [n, p].
        degree: Total degree of each term, shape [p].
        mixed: Number of settings in each term, shape [p].
        y: Values, shape [n].
        seeds: Seeds of the beds, shape [n].
        of_run: Index of the design of each run, shape [n].

    Returns:
        Coefficients, covariance, misfit, scatter, degrees of freedom and lack of fit.
    """
    beds = (seeds[:, None] == np.unique(seeds)).astype(float)
    points = (of_run[:, None] == np.arange(of_run.max() + 1)).astype(float)
    n, m, curved = len(y), points.shape[1], degree > 1
    freedom = n - int((~curved).sum())  # the plane takes its coefficients; the others have a proper prior
    spread = np.where(curved, (2.0 / np.maximum(degree, 1)) ** _DECAY * _MIXED ** (mixed - 1.0), np.inf)
    fits = []
    for share, misfit in product(_SHARES, _MISFITS):
        normal, determinant = _normal(x, y, beds, points, share, misfit)
        for size in _SIZES:
            prior = (size * spread) ** -2.0
            best, inverse, squares = _solved(normal, prior)
            # restricted likelihood: the plane and the scatter of runs are integrated out
            volume = determinant - float(np.linalg.slogdet(inverse)[1]) - float(np.log(prior[curved]).sum())
            likelihood = -0.5 * (volume + freedom * math.log(squares))
            fits.append((likelihood, share, misfit, size, best, inverse, squares / freedom))
    likelihood, share, misfit, size, best, inverse, scale = (np.array(column) for column in zip(*fits, strict=True))
    weights = np.exp(likelihood - likelihood.max()) * bed_prior(share)
    weights /= weights.sum()
    mean = weights @ best
    off = best - mean
    # law of total covariance: within each member of the average, and between members
    covariance = np.einsum("k,kij->ij", weights * scale, inverse) + np.einsum("k,ki,kj->ij", weights, off, off)
    # the test is for the surface alone: of the members without misfit, the most likely one
    top = int(np.argmax(np.where(misfit == 0, weights, 0)))
    lack = _lack_of_fit(x, y, beds, points, float(share[top]), (size[top] * spread) ** -2.0) if n > m else math.nan
    return mean, covariance, math.sqrt(weights @ (scale * misfit**2)), math.sqrt(weights @ scale), freedom, lack


def _lack_of_fit(
    x: np.ndarray, y: np.ndarray, beds: np.ndarray, points: np.ndarray, share: float, prior: np.ndarray
) -> float:
    """Probability of a larger misfit if the smooth surface were true.

    F test of the surface, with its effective number of parameters, against the scatter within designs (Hastie &
    Tibshirani, Generalized Additive Models, 1990, section 3.9).
    """
    from scipy.special import fdtrc

    normal, _ = _normal(x, y, beds, points, share, 0.0)
    best, inverse, _ = _solved(normal, prior)
    information = normal[:-1, :-1]
    parameters = float(np.trace(inverse @ information))  # effective number: a prior that binds takes less than one
    squares = float(normal[-1, -1] - 2 * normal[:-1, -1] @ best + best @ information @ best)
    _, _, pure = _solved(_normal(points, y, beds, points, share, 0.0)[0], np.zeros(points.shape[1]))
    n, m = points.shape
    if m - parameters < 0.5:
        return math.nan
    ratio = max(squares - pure, 0.0) / (m - parameters) / (pure / (n - m))
    return float(fdtrc(m - parameters, n - m, ratio))


def _normal(
    x: np.ndarray, y: np.ndarray, beds: np.ndarray, points: np.ndarray, share: float, misfit: float
) -> tuple[np.ndarray, float]:
    """Normal equations of weighted least squares, and ln of the determinant of the covariance.

    The covariance is (1 - share) I + share beds + misfit^2 points. The last row and column are those of y.
    """
    own, both = 1 - share, np.column_stack([x, y])
    inner, across = beds.T @ beds + own / share * np.eye(beds.shape[1]), beds.T @ both
    determinant = (len(y) - beds.shape[1]) * math.log(own) + beds.shape[1] * math.log(share)
    normal = both.T @ both
    if misfit:  # Woodbury's identity, with the diagonal block of the designs eliminated before that of the beds
        weight = 1 / (points.sum(axis=0) + own / misfit**2)
        sums, shared = points.T @ both, (beds.T @ points) * weight
        normal = normal - (sums.T * weight) @ sums
        inner, across = inner - shared @ (beds.T @ points).T, across - shared @ sums
        determinant += float(np.sum(np.log(misfit**2 / own / weight)))
    normal = (normal - across.T @ np.linalg.solve(inner, across)) / own
    return normal, determinant + float(np.linalg.slogdet(inner)[1])


def _solved(normal: np.ndarray, prior: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Solve the normal equations with a prior.

    Args:
        normal: Normal equations, as `_normal` gives them.
        prior: Prior precision of each coefficient, shape [p].

    Returns:
        Coefficients, their covariance over the variance of runs, and the weighted sum of squares.
    """
    inverse = np.linalg.inv(normal[:-1, :-1] + np.diag(prior))
    best = inverse @ normal[:-1, -1]
    return best, inverse, max(float(normal[-1, -1] - normal[:-1, -1] @ best), np.finfo(float).tiny)
