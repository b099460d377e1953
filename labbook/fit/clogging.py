"""Laws of the mean avalanche against D/d, fitted to stops and grains by maximum likelihood."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from labbook.fit.law import exponential
from labbook.fit.profile import LowerMinimum, Residuals, interval, minimise
from labbook.fit.result import FitError, Parameter
from labbook.stats.choice import best_laws
from labbook.stats.pooling import student

DECADES = 3.0
"""Decades of the mean avalanche that outlets have to span before the laws can be distinguished."""
_RESTARTS = 8
_LIMIT = 300.0
"""Bound of |ln ⟨s⟩|, within which e^x and its inverse stay finite in double precision."""


class AvalancheLaw(ABC):
    """Law of the mean avalanche ⟨s⟩ [grains] through an outlet of D/d diameters.

    The probability of a stop per grain is 1 / ⟨s⟩. A subclass defines its formula and source, the names of its free
    parameters, and the methods below.
    """

    name: ClassVar[str]
    formula: ClassVar[str]
    source: ClassVar[str]
    free: ClassVar[tuple[str, ...]]

    @abstractmethod
    def log_mean(self, x: np.ndarray, free: np.ndarray, context: "Outlets") -> np.ndarray:
        """ln ⟨s⟩ of the law.

        Args:
            x: Outlets D/d, shape [n].
            free: Free parameters, shape [p].
            context: Properties of the outlets.

        Returns:
            Shape [n]; infinite where the flow never stops.
        """

    @abstractmethod
    def starts(self, x: np.ndarray, log_mean: np.ndarray, context: "Outlets") -> list[np.ndarray]:
        """Free parameters to start fits from.

        Args:
            x: Outlets D/d with stops, shape [n].
            log_mean: Rough ln ⟨s⟩ at each, shape [n].
            context: Properties of the outlets.

        Returns:
            Starts, each of shape [p].
        """

    @abstractmethod
    def reported(self, free: float, index: int, context: "Outlets") -> tuple[str, float]:
        """Reported parameter that corresponds to a free one.

        Args:
            free: Value of the free parameter.
            index: Its index.
            context: Properties of the outlets.

        Returns:
            Name and value, a monotone function of `free`.
        """


@dataclass(frozen=True)
class Outlets:
    """Properties of the outlets of a fit.

    Args:
        dimension: Dimension of the region of arches: 2 for a slot, 3 for a hole.
        widest: Widest outlet with a stop [d].
    """

    dimension: int
    widest: float


class CriticalSize(AvalancheLaw):
    """⟨s⟩ = A / (R_c - D/d)^gamma: outlets wider than R_c never clog (Zuriguel et al. 2005)."""

    name = "critical size"
    formula = "⟨s⟩ = A / (R_c - D/d)^gamma"
    source = "Zuriguel et al. 2005"
    free = ("R_c - D/d of the widest outlet with a stop", "gamma", "A")

    def log_mean(self, x: np.ndarray, free: np.ndarray, context: Outlets) -> np.ndarray:
        away = context.widest + exponential(float(free[0])) - x
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(away > 0, free[2] - exponential(float(free[1])) * np.log(away), math.inf)

    def starts(self, x: np.ndarray, log_mean: np.ndarray, context: Outlets) -> list[np.ndarray]:
        starts = []
        for beyond in (0.3, 1.0, 3.0):
            slope, offset = np.polyfit(np.log(context.widest + beyond - x), log_mean, 1)
            starts.append(np.array([math.log(beyond), math.log(max(-slope, 0.1)), offset]))
        return starts

    def reported(self, free: float, index: int, context: Outlets) -> tuple[str, float]:
        value = exponential(free)
        return ("R_c", "gamma", "A")[index], value + context.widest if index == 0 else value


class NoCriticalSize(AvalancheLaw):
    """ln(1 + ⟨s⟩/s_1) = C ((D/d)^alpha - 1), alpha the dimension: every outlet clogs (Thomas & Durian 2015)."""

    name = "no critical size"
    formula = "ln(1 + ⟨s⟩/s_1) = C ((D/d)^alpha - 1)"
    source = "after Thomas and Durian 2015"
    free = ("s_1", "C")

    def log_mean(self, x: np.ndarray, free: np.ndarray, context: Outlets) -> np.ndarray:
        power = exponential(float(free[1])) * (x**context.dimension - 1)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            # ln(e^power - 1) is power itself, to double precision, from 30 on, where expm1 would soon overflow
            return free[0] + np.where(power > 30, power, np.log(np.expm1(np.minimum(power, 30))))

    def starts(self, x: np.ndarray, log_mean: np.ndarray, context: Outlets) -> list[np.ndarray]:
        slope, offset = np.polyfit(x**context.dimension - 1, log_mean, 1)
        return [np.array([offset + shift, math.log(max(slope, 1e-3))]) for shift in (0.0, 1.0, -1.0)]

    def reported(self, free: float, index: int, context: Outlets) -> tuple[str, float]:
        return ("s_1", "C")[index], exponential(free)


AVALANCHE_LAWS: tuple[AvalancheLaw, ...] = (CriticalSize(), NoCriticalSize())


@dataclass(frozen=True, eq=False)
class AvalancheFit:
    """A law fitted to stops and grains at n outlets.

    Attributes:
        law: The law.
        context: Of the outlets.
        parameters: With intervals from the profile likelihood, by name.
        x: D/d of the outlets, shape [n].
        deviance: -2 ln of the likelihood, over that of a rate of its own at each outlet.
        p_value: Probability of a larger deviance if the law holds; NaN without degrees of freedom.
        aicc: Akaike's criterion for few points; NaN for too few.
        best: Free parameters.
    """

    law: AvalancheLaw
    context: Outlets
    parameters: Mapping[str, Parameter]
    x: np.ndarray
    deviance: float
    p_value: float
    aicc: float
    best: np.ndarray

    def mean(self, x: np.ndarray) -> np.ndarray:
        """Mean avalanche of the law.

        Args:
            x: Outlets D/d, shape [m].

        Returns:
            ⟨s⟩ [grains], shape [m]; infinite where the flow never stops.
        """
        with np.errstate(over="ignore"):
            return np.exp(self.law.log_mean(np.asarray(x, float), self.best, self.context))


def fit_avalanches(
    law: AvalancheLaw,
    x: Sequence[float] | np.ndarray,
    stops: Sequence[int] | np.ndarray,
    grains: Sequence[float] | np.ndarray,
    dimension: int,
) -> AvalancheFit:
    """Fit a law to the stops among the grains that left through each outlet.

    The number of stops is a Poisson number of mean grains / ⟨s⟩. Its signed deviance residuals make the likelihood a
    sum of squares, whose profile gives the intervals (95 %). An outlet without a stop counts too.

    Args:
        law: The law.
        x: D/d of each outlet.
        stops: Stops at each outlet.
        grains: Grains that left through each outlet, beyond the transients.
        dimension: 2 of a slot, 3 of a hole.

    Returns:
        The fit.

    Raises:
        FitError: Fewer outlets with stops than the law has parameters, or no convergence.
    """
    from scipy.special import chdtrc

    at, k, passed = (np.asarray(values, float) for values in (x, stops, grains))
    stopped, number = k > 0, len(law.free)
    if len(np.unique(at[stopped])) < number:
        few = f"{len(np.unique(at[stopped]))} outlets with stops"
        raise FitError(f"{law.name}: {few}; its {number} parameters need {number}; use more outlets or longer runs")
    context = Outlets(dimension, float(at[stopped].max()))
    residuals = _deviances(law, at, k, passed, context)
    starts = law.starts(at[stopped], np.log(passed[stopped] / k[stopped]), context)
    minimum = None
    for start in starts:
        try:
            trial = minimise(residuals, start)
        except RuntimeError:
            continue
        minimum = trial if minimum is None or trial.chi2 < minimum.chi2 else minimum
    allowed = student(0.95, math.inf) ** 2  # chi2 of one degree of freedom: Poisson counts have no unknown variance
    for _ in range(_RESTARTS):
        if minimum is None:
            break
        try:
            ends = [interval(residuals, minimum, index, allowed) for index in range(number)]
            break
        except LowerMinimum as lower:
            minimum = minimise(residuals, lower.free)
        except RuntimeError:
            minimum = None
    else:
        minimum = None
    if minimum is None:
        raise FitError(f"{law.name}: the fit did not converge; use outlets over a wider range")
    errors = np.sqrt(np.diag(minimum.covariance))
    parameters = {}
    for index, (low, high) in enumerate(ends):
        name, value = law.reported(float(minimum.best[index]), index, context)
        slope = (law.reported(float(minimum.best[index]) + 1e-6, index, context)[1] - value) / 1e-6
        bottom, top = (law.reported(end, index, context)[1] for end in (low, high))
        parameters[name] = Parameter(value, bottom, top, abs(slope) * float(errors[index]), "")
    dof = len(at) - number
    aicc = minimum.chi2 + 2 * number + 2 * number * (number + 1) / (dof - 1) if dof > 1 else math.nan
    p_value = float(chdtrc(dof, minimum.chi2)) if dof > 0 else math.nan
    return AvalancheFit(law, context, parameters, at, minimum.chi2, p_value, aicc, minimum.best)


def _deviances(law: AvalancheLaw, x: np.ndarray, k: np.ndarray, grains: np.ndarray, context: Outlets) -> Residuals:
    """Signed square roots of the deviance of each outlet; their sum of squares is -2 ln of the likelihood ratio."""
    from scipy.special import xlogy

    def residuals(free: np.ndarray) -> np.ndarray:
        log_mean = np.clip(law.log_mean(x, free, context), -_LIMIT, _LIMIT)
        expected = np.maximum(grains * np.exp(-log_mean), 1e-300)
        deviance = 2 * (xlogy(k, k / expected) - k + expected)
        return np.sign(k - expected) * np.sqrt(np.maximum(deviance, 0.0))

    return residuals


def preferred(fits: Sequence[AvalancheFit]) -> tuple[str, ...]:
    """Names of the laws between which the data do not decide; a single name is the preferred law.

    A law is beaten only by 4 or more, in AICc and in the likelihood alone, as for laws of the flow rate. If there are
    too few outlets for the criterion, nothing is beaten.

    Args:
        fits: Fits of laws to the same outlets.

    Returns:
        Names in the order of the fits.
    """
    return best_laws({fit.law.name: (fit.aicc, fit.deviance) for fit in fits})
