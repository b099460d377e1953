"""Fit of a law to flow rates with known errors."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from labbook.fit.law import Context, Law
from labbook.fit.profile import LowerMinimum, Minimum, interval, minimise
from labbook.fit.result import FitError, FitResult, Parameter, widened
from labbook.fit.weights import Weights, pooled_weights
from labbook.scene.quantities import format_distinct
from labbook.stats.choice import aicc, best_laws, deviance
from labbook.stats.pooling import student

_RESTARTS = 8
_RESOLUTION = 1e-3
"""Difference of orifices [d] below which they count as one."""
_EXACT = 1e-6
"""Relative scatter about a law that counts as round-off: flow rates are counts of grains, and never lie so close."""
OUTLETS = 6
"""Outlets that determine k where Beverloo's law misses the points: with four degrees of freedom Student's t is 2.8."""
_UNDECIDED = 1.0
"""Width of the interval of k [d] above which k counts as undecided: such an interval excludes little."""
_DIVERGES = (
    "the fit did not converge: these flow rates do not determine its parameters; use outlets over a wider range or "
    "more replicates, or leave the law out of `fit`"
)


def fit(
    law: Law,
    D: Sequence[float] | np.ndarray,
    W: Sequence[float] | np.ndarray,
    error: Sequence[float] | np.ndarray,
    context: Context,
    replicates: Sequence[int] | np.ndarray | None = None,
    confidence: float = 0.95,
) -> FitResult:
    """Fit a law to mass flow rates.

    Residuals are those of ln W: the relative scatter of flow rates is the same at all orifices. Intervals come from the
    profile likelihood (`labbook.fit.profile`), with errors and Student's t of `labbook.fit.result.widened`.

    Args:
        law: The law.
        D: Orifices [m], shape [n].
        W: Mass flow rates [kg/s], shape [n].
        error: Standard errors of W over replicates [kg/s], shape [n]; NaN with one replicate.
        context: Properties of grains, slot and gravity.
        replicates: Number of replicates of each point, over which errors are pooled (`labbook.fit.weights`); None: the
            errors are known exactly.
        confidence: Confidence of the intervals.

    Returns:
        The fit.

    Raises:
        FitError: The data are unusable or do not determine the parameters, or the fit does not converge.
    """
    D, W, error = (np.asarray(a, float) for a in (D, W, error))
    _check(law, D, W, error, replicates, context)
    weights = pooled_weights(W, error, None if replicates is None else np.asarray(replicates))
    if not (weights.relative > 0).all():
        raise FitError(f"{law.name}: the errors of the flow rates are zero; give more replicates")
    log_W = np.log(W)

    def residuals(free: np.ndarray) -> np.ndarray:
        return (log_W - law.log_flow(D, free, context)) / weights.relative

    dof = len(D) - len(law.free)
    replicated = weights.degrees_of_freedom > 0
    allowed = _allowed(confidence, dof, weights.degrees_of_freedom)
    if why := law.without_minimum(D, W, weights.relative, context, allowed):
        raise FitError(f"{law.name}: {why}; use outlets over a wider range or more replicates")
    start = law.start(D, W, context)
    if np.isnan(law.log_flow(D, start, context)).any():
        raise FitError(f"{law.name}: log_flow gives NaN at the free parameters of start, {start}")
    # a profile that meets a lower minimum restarts the fit from there: the first minimum was a local one
    for _ in range(_RESTARTS):
        try:
            minimum = minimise(residuals, start)
            misfit = math.sqrt(minimum.chi2 / dof)
            if not replicated and misfit < _EXACT:
                no_scatter = "the points lie on the law, so that their scatter gives no errors; give more replicates"
                raise FitError(f"{law.name}: {no_scatter}")
            widening, _ = widened(minimum.chi2, dof, weights.degrees_of_freedom)
            parameters = _parameters(law, context, residuals, minimum, allowed(minimum.chi2), widening)
            break
        except LowerMinimum as lower:
            start = lower.free
        except RuntimeError as failure:
            raise FitError(f"{law.name}: {_DIVERGES}") from failure
    else:
        raise FitError(f"{law.name}: the fit keeps finding lower minima; the data do not determine its parameters")
    outside = law.outside(D, context)
    p_value = _p_value(minimum.chi2, dof, weights)
    notes = _notes(law, D, outside, weights, p_value, dof, context)
    if advice := _more_outlets(D, context, widening, parameters):
        notes = (*notes, advice)
    return FitResult(
        law=law,
        context=context,
        parameters=parameters,
        D=D,
        W=W,
        # without replicates weights are relative only; the misfit gives them their size
        relative_error=weights.relative if replicated else weights.relative * misfit,
        residuals=residuals(minimum.best) * weights.relative,
        outside=outside,
        chi2=minimum.chi2,
        dof=dof,
        p_value=p_value,
        error_dof=weights.degrees_of_freedom,
        aicc=aicc(minimum.chi2, len(D), len(law.free)),
        confidence=confidence,
        notes=notes,
        _minimum=minimum,
    )


def _allowed(confidence: float, dof: int, error_dof: float) -> Callable[[float], float]:
    """Function that gives the rise of chi2 over its minimum that bounds the intervals: t^2, widened by the misfit."""

    def allowed(least: float) -> float:
        factor, freedom = widened(least, dof, error_dof)
        return (student(confidence, freedom) * factor) ** 2

    return allowed


def _check(law: Law, D: np.ndarray, W: np.ndarray, error: np.ndarray, replicates, context: Context) -> None:
    if not D.shape == W.shape == error.shape or D.ndim != 1:
        raise FitError(f"{law.name}: orifices, flow rates and errors must be lists of equal length")
    orifices, least = _distinct(D, context), len(law.free) + 1
    if orifices < least:
        resolution = (
            f" (those that differ by less than {_RESOLUTION:g} d count as one)" if orifices < len(np.unique(D)) else ""
        )
        few = "orifice is too few" if orifices == 1 else "orifices are too few"
        raise FitError(f"{law.name}: {orifices} {few}{resolution}; its {least - 1} parameters need {least}")
    if not (np.isfinite(W).all() and (W > 0).all() and np.isfinite(D).all() and (D > 0).all()):
        raise FitError(f"{law.name}: orifices and flow rates must be positive and finite; leave out clogged points")
    replicated = np.ones(len(D), bool) if replicates is None else np.asarray(replicates) > 1
    if not (np.isfinite(error[replicated]).all() and (error[replicated] >= 0).all()):
        raise FitError(f"{law.name}: the error of a point with several replicates must be finite and not negative")


def _distinct(D: np.ndarray, context: Context) -> int:
    """Number of different orifices."""
    return min(len(D), 1) + int(np.sum(np.diff(np.unique(D)) >= _RESOLUTION * context.d))


def _parameters(law, context, residuals, minimum: Minimum, rise: float, widening: float) -> dict[str, Parameter]:
    reported = law.reported(context)
    ends = {i: interval(residuals, minimum, i, rise, law.endless) for i in {entry.free for entry in reported}}
    errors = np.sqrt(np.diag(minimum.covariance)) * widening
    parameters = {}
    for entry in reported:
        free = minimum.best[entry.free]
        # error propagation by a central difference: the derivative of a reported parameter by its free one
        slope = (entry.of(free + 1e-6) - entry.of(free - 1e-6)) / 2e-6
        low, high = sorted(entry.of(end) for end in ends[entry.free])
        error = abs(slope) * errors[entry.free] if math.isfinite(errors[entry.free]) else math.inf
        parameters[entry.name] = Parameter(entry.of(free), low, high, float(error), entry.unit)
    return parameters


def _p_value(chi2: float, dof: int, weights: Weights) -> float:
    from scipy.special import chdtrc, fdtrc

    if weights.degrees_of_freedom == 0:
        return math.nan
    if math.isinf(weights.degrees_of_freedom):
        return float(chdtrc(dof, chi2))
    # F and not chi2: the errors are estimates themselves, from finitely many replicates
    return float(fdtrc(dof, weights.degrees_of_freedom, chi2 / dof))


def _notes(law: Law, D, outside, weights: Weights, p_value: float, dof: int, context: Context) -> tuple[str, ...]:
    notes = []
    if outside.any():
        worst = ", ".join(format_distinct(ratio, law.least_ratio)[0] for ratio in D[outside] / context.d)
        notes.append(f"D/d = {worst} is below {law.least_ratio:g}, where the law is not meant to hold")
    if weights.degrees_of_freedom == 0:
        notes.append("no replicates: the errors are taken from the scatter about the law")
    if weights.uneven:
        notes.append("the relative scatter between replicates differs between points (Bartlett, p < 0.01)")
    if p_value < 0.05:
        notes.append(
            "the law misses the points by more than their errors; intervals are widened by sqrt(chi2/dof), with "
            f"Student's t of {dof} degree{'' if dof == 1 else 's'} of freedom"
        )
    return tuple(notes)


def _more_outlets(D: np.ndarray, context: Context, widening: float, parameters: dict[str, Parameter]) -> str:
    """Recommend OUTLETS if the points miss the law and fewer outlets leave k with an interval above _UNDECIDED."""
    outlets = _distinct(D, context)
    if "k" not in parameters or outlets >= OUTLETS or widening <= 1:
        return ""
    width = parameters["k"].high - parameters["k"].low
    if width <= _UNDECIDED:
        return ""
    size = f"an interval {width:.2g} d wide" if math.isfinite(width) else "an interval without end"
    return f"{outlets} outlets do not decide k, which has {size}; use {OUTLETS} outlets or more"


def contenders(results: Sequence[FitResult]) -> tuple[str, ...]:
    """Names of the laws between which the data do not decide; a single name is the preferred law.

    A law is beaten only if another one wins by AICc and by the likelihood alone. With 8 points a third parameter costs
    9 in AICc, so that a law with two would win by more than 4 on data that both fit equally well. Such a choice would
    rest on the number of parameters, not on the data.

    Args:
        results: Fitted laws.

    Returns:
        Names in the order of the fits.

    Raises:
        FitError: The laws were not fitted to the same points.
    """
    first = results[0]
    if any(not (np.array_equal(r.D, first.D) and np.array_equal(r.W, first.W)) for r in results):
        raise FitError("laws can be compared only on the same points")
    return best_laws({r.law.name: (r.aicc, deviance(r.chi2, len(r.D))) for r in results})
