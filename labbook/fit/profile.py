"""Least squares with intervals from the profile likelihood.

The interval of a parameter holds all values at which the sum of squares, minimised over all other parameters,
exceeds its minimum by less than a given rise (Bates & Watts, Nonlinear Regression Analysis, 1988, section
6.1; Venzon & Moolgavkar, Appl. Statist. 37 (1988) 87). Unlike value +- error it follows curved valleys, and
it says so where the data set no limit.
"""

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cache

import numpy as np

Residuals = Callable[[np.ndarray], np.ndarray]
"""Residuals in units of their standard errors, shape [n], of free parameters, shape [p]."""

_IMPOSSIBLE = 1e30
"""Sum of squares of parameters for which the law has no value."""
_FARTHEST = 1e3
"""Standard errors from the best value beyond which an interval counts as having no end."""


@dataclass(frozen=True)
class Minimum:
    """Best parameters, sum of squares there, and their covariance, shape [p, p] (infinite if singular)."""

    best: np.ndarray
    chi2: float
    covariance: np.ndarray


class LowerMinimum(Exception):
    """A profile came upon a lower sum of squares: the minimum that it started from was a local one."""

    def __init__(self, found: np.ndarray):
        super().__init__("the minimum was not the lowest one")
        self.found = found


def _least_squares(residuals: Residuals, start: np.ndarray):
    from scipy.optimize import leastsq

    with np.errstate(all="ignore"):  # a law may have no value far from its data: that is a sum of squares of infinity
        solution = leastsq(residuals, start, full_output=True, ftol=1e-12, xtol=1e-10, maxfev=2000)
    best, _, info, message, status = solution  # pyright: ignore[reportAssignmentType]
    chi2 = float(np.sum(info["fvec"] ** 2))
    return best, chi2 if math.isfinite(chi2) else _IMPOSSIBLE, message, status


def minimise(residuals: Residuals, start: np.ndarray) -> Minimum:
    """The minimum of the sum of squares. Raises RuntimeError if none is found."""
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
    """Central-difference derivative of a vector function, shape [n, p]."""
    columns = []
    for i in range(len(at)):
        step = np.zeros_like(at)
        step[i] = 6e-6 * max(1.0, abs(at[i]))
        columns.append((function(at + step) - function(at - step)) / (2 * step[i]))
    return np.column_stack(columns)


def interval(
    residuals: Residuals,
    minimum: Minimum,
    index: int,
    rise: float,
    endless: Callable[[np.ndarray], Collection[int]] = lambda free: (),
) -> tuple[float, float]:
    """Ends of the interval of free parameter `index` in which the profile rises by less than `rise`.

    An end that the data do not set is infinite; so is one at whose free parameters, shape [p], the parameter is among
    those that `endless` gives. Raises LowerMinimum if `minimum` turns out to be a local one.
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
    others = np.delete(np.arange(len(minimum.best)), index)
    # Along the valley the other parameters move in proportion, as the covariance says.
    with np.errstate(invalid="ignore"):
        along = minimum.covariance[others, index] / minimum.covariance[index, index]
    along = np.where(np.isfinite(along), along, 0.0)
    guess = {0.0: minimum.best[others]}

    @cache
    def excess(steps: float) -> float:
        """Root of the rise, less the root asked for: nearly linear in the distance."""
        if steps == 0:
            return -math.sqrt(rise)
        fixed = centre + steps * unit

        def constrained(free: np.ndarray) -> np.ndarray:
            full = np.empty(len(minimum.best))
            full[index], full[others] = fixed, free
            return residuals(full)

        near = min(guess, key=lambda known: abs(known - steps))
        start = guess[near] + along * unit * (steps - near)
        free, chi2, *_ = _least_squares(constrained, start)
        guess[steps] = free
        if chi2 < minimum.chi2 * (1 - 1e-6) - 1e-9:
            raise LowerMinimum(np.insert(free, index, fixed))
        return math.sqrt(max(chi2 - minimum.chi2, 0.0)) - math.sqrt(rise)

    inner, outer = 0.0, math.sqrt(rise)
    while excess(outer) < 0:
        inner, outer = outer, 1.6 * outer
        if outer > _FARTHEST:
            return math.copysign(math.inf, unit)
    steps: float = brentq(excess, inner, outer, xtol=1e-9, rtol=1e-6)  # type: ignore[assignment]
    nearest = min(guess, key=lambda known: abs(known - steps))
    if index in endless(np.insert(guess[nearest], index, centre + steps * unit)):
        return math.copysign(math.inf, unit)
    return float(centre + unit * steps)
