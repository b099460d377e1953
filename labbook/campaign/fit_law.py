"""Goal `fit`: parameters of a law of the flow rate, each to a stated error.

    adapt:
      fit: {beverloo: {C: 2 %, k: 2 %}}

Sensitivities of ln W to the parameters decide where beds are worth most: for two parameters, at both ends of the range.
A fifth of the beds stays inside it, for the test of lack of fit. The split between the ends is the one that reaches all
errors with the fewest beds.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import model_validator

from labbook.campaign.goal import (
    HELD_OUT,
    SCATTER,
    Goal,
    Step,
    clogged_places,
    of_one_key,
    only_swept,
    rounded,
    spread,
)
from labbook.campaign.strategy import Assignment, Proposal, Trial, Values, point_key
from labbook.fit import LAWS, Context, FitError, FitResult, fit, law_name
from labbook.fit.profile import derivative
from labbook.scene.model import Fault, Internal, refuse
from labbook.scene.quantities import parse, percent
from labbook.stats import pool
from labbook.stats.nested import by_bed, of_beds
from labbook.stats.pooling import student
from labbook.stats.stopping import widening

ORIFICE = "container.orifice"
_FLOW, _FRACTION = "flow_rate", "packing_fraction"
_SETTINGS = 8
"""Outlets of the start. With fewer outlets intervals are several times as wide if the points lie off the law by chance,
since few degrees of freedom estimate the misfit."""
_INSIDE = 0.2
"""Part of the beds at outlets between both ends."""
_SPLITS = np.linspace(0.1, 0.9, 33)
"""Parts of the other beds at the narrow end, from which the best is chosen."""
_GROWTH = 1.5
"""Largest growth of the number of beds in a generation: scatter and parameters are known from few."""
_LACK_OF_FIT = 0.01
"""p-value of the lack of fit above which a law passes; it is low since the test is repeated after each generation."""
_MISSES = 1e-4
"""p-value of the lack of fit below which the law is given up."""

Point = tuple[float, list[float]]
"""Outlet [m], with the flow rates of its beds [kg/s]."""


class FitLaw(Goal):
    """Goal: the parameters of a law of the flow rate, each to a stated error.

    Beds are allocated by the covariance of the parameters, (J^T diag(n) J)^-1 s^2, with J the derivatives of ln W at
    the outlets, n the beds there and s the scatter of ln W between beds.

    Args:
        law: Name of the law, one of `LAWS`.
        errors: Half width of the 95 % interval of each parameter to reach, relative to it.
    """

    name: ClassVar[str] = "fit"
    point_noun: ClassVar[str] = "outlets"
    testing: ClassVar[int] = 2 * HELD_OUT

    law: Annotated[str, Internal()]
    """Name of the law."""
    errors: Annotated[dict[str, float], Internal()]
    """Half width of the 95 % interval of each parameter to reach, relative to it."""

    @model_validator(mode="before")
    @classmethod
    def _of_mapping(cls, mapping: Any) -> Any:
        """Convert {law: {parameter: fraction}} to fields."""
        if isinstance(mapping, Mapping) and mapping.keys() >= {"law", "errors"}:
            return mapping
        if not (isinstance(mapping, Mapping) and len(mapping) == 1):
            refuse([Fault("", "one law with errors of its parameters is needed", _EXAMPLE)])
        ((law, errors),) = mapping.items()
        law = law_name(str(law))
        if law not in LAWS:
            refuse([Fault(str(law), "there is no such law", f"name one of: {', '.join(LAWS)}")])
        if not isinstance(errors, Mapping) or not errors:
            refuse([Fault(law, "errors of parameters are needed", _EXAMPLE)])
        faults, fractions = [], {}
        for name, fraction in errors.items():
            if name not in LAWS[law].parameters:
                names = ", ".join(LAWS[law].parameters)
                faults.append(Fault(f"{law}.{name}", "the law has no such parameter", f"name one of: {names}"))
            try:
                fractions[name] = parse(fraction, "") if isinstance(fraction, str) else float(fraction)
            except (ValueError, TypeError) as error:
                faults.append(Fault(f"{law}.{name}", f"{fraction}: {error}", _EXAMPLE))
            else:
                if not 1e-4 <= fractions[name] < 1:
                    faults.append(Fault(f"{law}.{name}", "a fraction from 0.0001 to 1 is needed", "write 2 %"))
        refuse(faults)
        return {"law": law, "errors": fractions}

    def range_faults(self, points: Sequence[Any]) -> list[Fault]:
        """List faults of the range of a study."""
        return of_one_key("fit", ORIFICE, points)

    def needs(self) -> tuple[str, Sequence[str]]:
        """Name the measure of the flow rate."""
        return "flow_rate is", (_FLOW,)

    def further_faults(self, measures: Sequence[str], points: Sequence[Any]) -> Iterator[Fault]:
        """Yield faults for a law that does not hold here, or has a parameter that is not measured."""
        law, scene = LAWS[self.law], points[0].scene
        if law.outlet not in (scene.container.outlet_form, "any"):
            yield Fault("fit", f"{self.law} is a law for a {law.outlet}", "name a law for the outlet of this container")
        reported = {parameter.name for parameter in law.reported(Context.of(scene, None))}
        if {*self.errors} - reported and "packing" not in measures:
            lacking = ", ".join({*self.errors} - reported)
            yield Fault("fit", f"{lacking} rests on the packing fraction", "add packing to measure, or name C_particle")
        low, high = self._range(points)
        if not low < high:
            narrowest = law.least_ratio * Context.of(scene, None).d
            remedy = f"sweep wider outlets: the law holds from {law.least_ratio:g} d, {1e3 * narrowest:.4g} mm"
            yield Fault("fit", "the sweep has no range in which the law is meant to hold", remedy)

    def plan_rule(self, study: Any) -> str:
        """State the end of the campaign, and the expected number of runs."""
        start = len(self._start(study)) * self.beds
        return (
            f"{self._wishes()} of {self.law} (half widths of the 95 % intervals). {start} beds over the range, then "
            f"beds where they are worth most, a fifth of them inside the range, then {HELD_OUT} held-out beds at each "
            f"end. About {self._expected(study) + self.testing} beds{self.limits()} (scatter of a run: "
            f"{percent(SCATTER)})"
        )

    def first(self, study: Any) -> list[Values]:
        """Return outlets over the range of the law."""
        return [{ORIFICE: D} for D in self._start(study)]

    def step(self, study: Any, trials: Sequence[Trial]) -> Step:
        """Propose beds where they are worth most, or held-out beds once all errors are reached.

        Args:
            study: The study, whose sweep of outlets is the range.
            trials: All runs so far; outlets with many clogged runs are left out.

        Returns:
            Beds of each outlet; held-out beds at both ends; or the end, if the law cannot be fitted or misses the
            points, or no more beds are allowed.
        """
        points = _points(trials)
        try:
            result = self._fit(study, trials, points)
        except FitError as problem:
            return Step(Proposal.end(f"no fit: {problem}"))
        n = np.array([len(values) for _, values in points], float)
        halves = self._halves(result, int(n.sum()))
        progress = ", ".join(f"{name} ±{percent(half, '.2f')}" for name, half in halves.items())
        progress = f"{progress} from {int(n.sum())} beds"
        if result.p_value < _MISSES:
            why = (
                f"{self.law} misses the points (p = {result.p_value:.1g}), so that its parameters do not describe them"
            )
            return Step(Proposal.end(f"{why}: {progress}"))
        if all(halves[name] <= fraction for name, fraction in self.errors.items()):
            return self._held_out(points, trials, progress)
        cap = study.accuracy.max_replicates
        target = np.minimum(self._allocation(result, n), cap)
        if (target <= n).all():
            reason = "accuracy.max_replicates allows no more beds, and the promise is not reached"
            return Step(Proposal.end(f"{reason}: {progress}"))
        assignments = tuple(
            Assignment({ORIFICE: D}, int(number))
            for (D, _), number, beds in zip(points, target, n, strict=True)
            if number > beds
        )
        outlets = ", ".join(
            f"{assignment.replicates} at {1e3 * float(assignment.at[ORIFICE]):.4g} mm" for assignment in assignments
        )
        return Step(Proposal(assignments, f"{progress}: beds in all {outlets}"))

    def verdict(self, study: Any, trials: Sequence[Trial], withheld: Sequence[Trial]) -> str:
        """Compare held-out beds at both ends with the law.

        The promise is kept if the deviation of each mean from the law, less the half width of its 95 % interval, is at
        most what the promised errors of the parameters allow there.

        Args:
            study: The study.
            trials: Runs on which the promise rests.
            withheld: Held-out runs at both ends of the range.

        Returns:
            The parameters with their half widths, and the verdict, in sentences.

        Raises:
            FitError: The law cannot be fitted.
        """
        points = _points(trials)
        result = self._fit(study, trials, points)
        halves = self._halves(result, sum(len(values) for _, values in points))
        values = ", ".join(f"{name} = {result.parameters[name].value:.4g} ±{percent(half, '.2f')}"
                           for name, half in halves.items())  # fmt: skip
        answer = f"{values} from {sum(len(values) for _, values in points)} beds"
        deviations, agrees = [], True
        for D, rates in _points(withheld):
            if len(rates) < 2:
                return f"{answer}. Promise not tested: {len(rates)} held-out beds at {1e3 * D:.4g} mm have a value"
            mean, expected = pool(rates), float(result.band(np.array([D]))[0][0])
            off, half = mean.value / expected - 1, mean.half_width / expected
            agrees &= abs(off) - half <= self._allowed(result, D)
            deviations.append(f"{percent(off, '+.2f')} ±{percent(half, '.2f')} at {1e3 * D:.4g} mm")
        if not deviations:
            return f"{answer}. Promise not tested: no held-out bed has a value"
        word = "kept" if agrees else "not kept"
        off = " and ".join(deviations)
        return f"{answer}. Promise {word}: {HELD_OUT} held-out beds at each end deviate from the law by {off}"

    def _wishes(self) -> str:
        return " and ".join(f"{name} to {percent(fraction)}" for name, fraction in self.errors.items())

    def _range(self, points: Sequence[Any]) -> tuple[float, float]:
        """Range of the sweep in which the law is meant to hold [m]."""
        swept = only_swept(points)
        assert swept is not None
        narrowest = LAWS[self.law].least_ratio * Context.of(points[0].scene, None).d
        low = swept.values[0] if swept.values[0] >= narrowest * (1 - 1e-9) else rounded(narrowest)
        return low, swept.values[-1]

    def _start(self, study: Any) -> tuple[float, ...]:
        swept = only_swept(study.points)
        assert swept is not None
        low, high = self._range(study.points)
        return spread(swept.within(low, high), _SETTINGS)

    def _fit(self, study: Any, trials: Sequence[Trial], points: Sequence[Point]) -> FitResult:
        """Fit the law to the means of points. Raises FitError."""
        fractions = [trial.numbers[_FRACTION] for trial in trials if _FRACTION in trial.numbers]
        context = Context.of(study.points[0].scene, float(np.mean(fractions)) if fractions else None)
        means = [pool(values) for _, values in points]
        D, W = [D for D, _ in points], [mean.value for mean in means]
        return fit(LAWS[self.law], D, W, [mean.error for mean in means], context, [mean.n for mean in means])

    def _halves(self, result: FitResult, beds: int) -> dict[str, float]:
        """Half widths of the intervals of the requested parameters, relative to them."""
        factor = float(widening(beds)) * _reach(result)
        return {
            name: factor * result.parameters[name].error / abs(result.parameters[name].value) for name in self.errors
        }

    def _sensitivities(self, law: Any, free: np.ndarray, context: Context, D: np.ndarray) -> np.ndarray:
        """Derivatives of ln W at n outlets by the free parameters, shape [n, p]."""
        return derivative(lambda values: law.log_flow(D, values, context), free)

    def _relative(self, law: Any, free: np.ndarray, context: Context) -> dict[str, tuple[int, float]]:
        """For each requested parameter, the index of its free parameter, and its relative derivative by that."""
        slopes = {}
        for parameter in law.reported(context):
            if parameter.name in self.errors:
                at, of = float(free[parameter.free]), parameter.of
                slopes[parameter.name] = parameter.free, (of(at + 1e-6) - of(at - 1e-6)) / 2e-6 / of(at)
        return slopes

    def _needed(
        self, law: Any, free: np.ndarray, context: Context, D: np.ndarray, scatter: float, t: float
    ) -> tuple[float, np.ndarray]:
        """Find the fewest beds that reach all errors, and their fraction at each outlet, shape [n]."""
        J, slopes, inner = self._sensitivities(law, free, context, D), self._relative(law, free, context), len(D) - 2
        best = math.inf, np.full(len(D), 1 / len(D))
        for split in _SPLITS:
            fraction = np.full(len(D), _INSIDE / inner)
            fraction[[0, -1]] = (1 - _INSIDE) * np.array([split, 1 - split])
            # covariance of the parameters for one bed in all; it falls as 1/beds
            covariance = np.linalg.inv(J.T @ (J * fraction[:, None])) * scatter**2
            halves = [t * math.sqrt(covariance[index, index]) * abs(slope) / self.errors[name]
                      for name, (index, slope) in slopes.items()]  # fmt: skip
            best = min(best, (max(halves) ** 2, fraction), key=lambda pair: pair[0])
        return best

    def _allocation(self, result: FitResult, n: np.ndarray) -> np.ndarray:
        """Number of beds at each outlet after the next generation, shape [n]."""
        scatter = math.sqrt(float(np.mean(result.relative_error**2 * n)))
        t = _reach(result) * result.widening * float(widening(int(n.sum())))
        needed, fraction = self._needed(result.law, result.best, result.context, result.D, scatter, t)
        number = min(max(needed, n.sum() + 4), _GROWTH * n.sum())
        return np.maximum(n, np.ceil(fraction * number))

    def _expected(self, study: Any) -> int:
        """Expected number of beds before there is any, by the law with the parameters of Beverloo's at k = 1.4."""
        law, context = LAWS[self.law], Context.of(study.points[0].scene, 0.6)
        D = np.array(self._start(study))
        # Z, the depth of a slot, is NaN for a hole
        W = context.unit_flow * (D / context.d - 1.4) ** (1.5 if context.Z == context.Z else 2.5)
        needed, _ = self._needed(law, law.start(D, W, context), context, D, SCATTER, student(0.95, math.inf))
        return max(len(D) * self.beds, math.ceil(needed))

    def _held_out(self, points: Sequence[Point], trials: Sequence[Trial], progress: str) -> Step:
        """Propose beds at both ends with seeds that no run has."""
        latest = max(trial.seed for trial in trials)
        ends = tuple(Assignment({ORIFICE: D}, latest + HELD_OUT) for D in (points[0][0], points[-1][0]))
        reason = f"{progress}; {HELD_OUT} beds are held out at each end to test the law"
        return Step(Proposal(ends, reason), holds_out=True)

    def _allowed(self, result: FitResult, D: float) -> float:
        """Deviation of ln W at an outlet that the promised errors allow, added in quadrature."""
        (J,) = self._sensitivities(result.law, result.best, result.context, np.array([D]))
        slopes = self._relative(result.law, result.best, result.context)
        return math.hypot(*(self.errors[name] / slope * J[index] for name, (index, slope) in slopes.items()))


def _reach(result: FitResult) -> float:
    """Half width of an interval over the standard error of the fit.

    If the law passes the test of lack of fit, the errors are those of the replicates, however the points happen to lie
    about it.
    """
    if result.p_value >= _LACK_OF_FIT:
        return student(0.95, result.error_dof) / result.widening
    return student(0.95, result.freedom)


def _points(trials: Sequence[Trial]) -> list[Point]:
    """Collect flow rates of beds by outlet, for outlets at which few runs clogged."""
    lost, points = clogged_places(trials), dict[float, list[tuple[int, float]]]()
    for trial in sorted(trials, key=lambda trial: (point_key(trial.at), trial.seed, trial.discharge)):
        value = trial.numbers.get(_FLOW, math.nan)
        if point_key(trial.at) not in lost and value > 0:
            points.setdefault(float(trial.at[ORIFICE]), []).append((trial.seed, value))
    return [(D, of_beds(by_bed(values))) for D, values in sorted(points.items())]


_EXAMPLE = "write {beverloo: {C: 2 %, k: 2 %}}"
