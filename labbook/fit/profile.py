"""Least squares with intervals from the profile likelihood.

The interval of a parameter holds all values at which the sum of squares, minimised over all other parameters, exceeds
its minimum by less than a given rise (Bates & Watts, Nonlinear Regression Analysis, 1988, section 6.1; Venzon &
Moolgavkar, Appl. Statist. 37 (1988) 87). Unlike value +- error it follows curved valleys, and it is infinite where the
data set no limit.
"""

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cache

import numpy as np

Residuals = Callable[[np.ndarray], np.ndarray]
"""Function of free parameters, shape [p], that returns residuals over their standard errors, shape [n]."""

_IMPOSSIBLE = 1e30
"""Sum of squares for parameters at which the law has no value."""
_FARTHEST = 1e3
"""Distance from the best value, in standard errors, beyond which an interval counts as unbounded."""


@dataclass(frozen=True)
class Minimum:
    """Least-squares solution.

    Attributes:
        best: Parameters, shape [p].
        chi2: Sum of squares.
        covariance: Covariance of the parameters, shape [p, p]; infinite if the data do not determine them.
    """

    best: np.ndarray
    chi2: float
    covariance: np.ndarray


class LowerMinimum(Exception):
    """A profile met a lower sum of squares at the parameters `free`: the minimum that it started from was local."""

    def __init__(self, free: np.ndarray):
        super().__init__("the minimum was not the lowest one")
        self.free = free


def _least_squares(residuals: Residuals, start: np.ndarray):
    from scipy.optimize import leastsq

    with np.errstate(all="ignore"):  # a law may have no value far from its data: that is a sum of squares of infinity
        solution = leastsq(residuals, start, full_output=True, ftol=1e-12, xtol=1e-10, maxfev=2000)
    best, _, info, message, status = solution  # pyright: ignore[reportAssignmentType]
    chi2 = float(np.sum(info["fvec"] ** 2))
    return best, chi2 if math.isfinite(chi2) else _IMPOSSIBLE, message, status


def minimise(residuals: Residuals, start: np.ndarray) -> Minimum:
    """Minimise the sum of squares.

    Args:
        residuals: The residuals.
        start: Parameters to start from, shape [p].

    Returns:
        The minimum; its covariance is infinite if the data do not determine the parameters.

    Raises:
        RuntimeError: The iteration does not converge.
    """
    best, chi2, message, status = _least_squares(residuals, np.asarray(start, float))
    if status not in (1, 2, 3, 4) or not np.isfinite(best).all() or chi2 == _IMPOSSIBLE:
        raise RuntimeError(f"the fit did not converge: {message}")
    jacobian = derivative(residuals, best)
    try:
        covariance = np.linalg.inv(jacobian.T @ jacobian)
    except np.linalg.LinAlgError:
        covariance = np.full((len(best), len(best)), np.inf)
    if not (np.diag(covariance) > 0).all():
        covariance = np.full((len(best), len(best)), np.inf)
    return Minimum(best, chi2, covariance)


def derivative(function: Residuals, at: np.ndarray) -> np.ndarray:
    """Central-difference derivative of a vector function.

    Args:
        function: Function of p parameters with n values.
        at: Parameters, shape [p].

    Returns:
        Derivative of each value by each parameter, shape [n, p].
    """
    columns = []
    for i in range(len(at)):
        step = np.zeros_like(at)
        step[i] = 6e-6 * max(1.0, abs(at[i]))  # the cube root of the rounding error balances it with truncation
        columns.append((function(at + step) - function(at - step)) / (2 * step[i]))
    return np.column_stack(columns)


def interval(
    residuals: Residuals,
    minimum: Minimum,
    index: int,
    rise: float,
    endless: Callable[[np.ndarray], Collection[int]] = lambda free: (),
) -> tuple[float, float]:
    """Interval of a free parameter by its profile likelihood.

    Args:
        residuals: The residuals.
        minimum: Their minimum.
        index: Index of the parameter.
        rise: Rise of the profile that bounds the interval.
        endless: Indices of parameters without an end at free parameters of shape [p], which only a bound stops.

    Returns:
        Lower and upper end; infinite where the data set none.

    Raises:
        LowerMinimum: `minimum` is a local one.
    """
    error = math.sqrt(minimum.covariance[index, index])
    unit = error if math.isfinite(error) else 1.0
    low, high = (_end(residuals, minimum, index, rise, sign * unit, endless) for sign in (-1, 1))
    return low, high


def _end(
    residuals: Residuals,
    minimum: Minimum,
    index: int,
    rise: float,
    unit: float,
    endless: Callable[[np.ndarray], Collection[int]],
) -> float:
    from scipy.optimize import brentq

    centre = minimum.best[index]
    remaining = np.delete(np.arange(len(minimum.best)), index)
    # along the valley the other parameters change in proportion to their covariance: a good start for each step
    with np.errstate(invalid="ignore"):
        along = minimum.covariance[remaining, index] / minimum.covariance[index, index]
    along = np.where(np.isfinite(along), along, 0.0)
    guess = {0.0: minimum.best[remaining]}

    @cache
    def excess(steps: float) -> float:
        """Square root of the rise, less that of the target: nearly linear in the distance, so that brentq is fast."""
        if steps == 0:
            return -math.sqrt(rise)
        fixed = centre + steps * unit

        def constrained(free: np.ndarray) -> np.ndarray:
            full = np.empty(len(minimum.best))
            full[index], full[remaining] = fixed, free
            return residuals(full)

        near = min(guess, key=lambda solved: abs(solved - steps))
        start = guess[near] + along * unit * (steps - near)
        free, chi2, *_ = _least_squares(constrained, start)
        guess[steps] = free
        if chi2 < minimum.chi2 * (1 - 1e-6) - 1e-9:  # lower by more than the tolerance of the minimiser
            raise LowerMinimum(np.insert(free, index, fixed))
        return math.sqrt(max(chi2 - minimum.chi2, 0.0)) - math.sqrt(rise)

    inner, outer = 0.0, math.sqrt(rise)
    while excess(outer) < 0:
        inner, outer = outer, 1.6 * outer
        if outer > _FARTHEST:
            return math.copysign(math.inf, unit)
    steps: float = brentq(excess, inner, outer, xtol=1e-9, rtol=1e-6)  # type: ignore[assignment]
    nearest = min(guess, key=lambda solved: abs(solved - steps))
    if index in endless(np.insert(guess[nearest], index, centre + steps * unit)):
        return math.copysign(math.inf, unit)
    return float(centre + unit * steps)
