"""Parameters that a study was calibrated for, from the runs that the lab has: values, ridge, sensitivities,
predictions, the next experiment, and a material card."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from labbook.campaign import Calibrate, Inference, NotInferred, Trial
from labbook.campaign.inference import Experiment, Interval, Prediction
from labbook.measure import MEASURES
from labbook.results import display
from labbook.results.study import StudyResults
from labbook.scene.quantities import percent
from labbook.study.proposed import written_at
from labbook.study.source import as_yaml

_SECTIONS = ("grains", "contact", "walls")
"""Sections of a study from which a material card takes what belongs to a parameter."""


class NoPosterior(ValueError):
    """The results give no posterior; the message says why and what helps."""


@dataclass(frozen=True)
class Agreement:
    """A measured value beside that of the model with the inferred parameters [SI]."""

    quantity: str
    at: Mapping[str, float]
    value: float
    error: float
    model: Interval


@dataclass(frozen=True, eq=False)
class CalibrationResults:
    """Parameters from measurements.

    Attributes:
        study: Name of the study.
        goal: As the study states it.
        inference: Posterior and emulators.
        source: Keys and values of the study.
    """

    study: str
    goal: Calibrate
    inference: Inference
    source: Mapping[str, Any]

    @cached_property
    def lacking(self) -> str:
        """Reason why there is no answer yet; empty if there is one."""
        return self.inference.lacking()

    @cached_property
    def parameters(self) -> Mapping[str, Interval]:
        """Median and 95 % interval of each parameter [SI]."""
        return self.inference.intervals()

    @cached_property
    def predictions(self) -> list[Prediction]:
        """Measurements that took no part, and quantities at the conditions of `predict`, by the posterior."""
        quantities = dict.fromkeys(entry.quantity for entry in self.goal.measurements)
        return self.inference.predictions([(name, at) for at in self.goal.predict for name in quantities])

    @cached_property
    def experiments(self) -> list[Experiment]:
        """Measurements that could be made next, the best one first."""
        return self.inference.experiments()

    @cached_property
    def agreements(self) -> list[Agreement]:
        """Each measured value of the calibration beside the model."""
        draws, agreements = self.inference.draws(), []
        for entry in (entry for entry in self.goal.measurements if not entry.withheld):
            mean, covariance = self.inference.joint(entry.quantity, draws, [entry.at])
            logs = mean[:, 0] + np.sqrt(covariance[:, 0, 0]) * np.random.default_rng(2).normal(size=len(draws))
            ends = np.exp(np.quantile(logs, (0.025, 0.5, 0.975)) + self.inference.trends[entry.quantity].at(entry.at))
            agreements.append(
                Agreement(entry.quantity, entry.at, entry.value, entry.error, Interval(*map(float, ends)))
            )
        return agreements

    @property
    def ends(self) -> Iterator[str]:
        """Parameters whose interval reaches an end of the prior: the measurements do not bound them there."""
        for key in self.goal.parameters:
            low, high = (
                float(self._axis(key).unit(end)) for end in (self.parameters[key].low, self.parameters[key].high)
            )
            open_ends = [name for name, at_end in (("below", low < 0.03), ("above", high > 0.97)) if at_end]
            if open_ends:
                yield f"{display.key(key).name} is not bounded {' and '.join(open_ends)} by the measurements"

    def lines(self) -> Iterator[str]:
        """The results in sentences."""
        runs = len(self.inference.trials)
        if self.lacking:
            yield f"No answer yet: {self.lacking}"
        for key, entry in self.parameters.items():
            yield f"{self.interval(key, entry)}{' (preliminary)' * bool(self.lacking)}"
        yield from self.ends
        if self.lacking:
            return
        ridge = self.inference.ridge
        if len(ridge.components) > 1:
            parts = ", ".join(
                f"{display.key(key).name} {component:+.2f}" for key, component in ridge.components.items()
            )
            yield f"Ridge: {parts} (of the prior ranges); {percent(ridge.remaining)} of the prior remains along it"
        best = self.experiments[0]
        share = f"volume of the posterior / {best.gain:.2g}"
        yield f"Next experiment: {self.quantity_label(best)} to {percent(best.error)}, {share}"
        for entry in self.predictions:
            yield self._predicted(entry)
        clogged = sum(trial.outcome == "clogged" for trial in self.inference.trials)
        diverged = sum(trial.outcome == "diverged" for trial in self.inference.trials)
        share = f"the emulator's variance is {self.inference.share:.2g} of that of the measurements"
        yield f"From {runs} runs ({clogged} clogged, {diverged} diverged: left out); {share}"

    def interval(self, key: str, entry: Interval) -> str:
        """A parameter in a sentence."""
        unit, error = display.key(key), (entry.high - entry.low) / 4
        low, median, high = (display.number(x, error, unit.scale) for x in (entry.low, entry.median, entry.high))
        return f"{unit.name} = {median} {unit.unit}".rstrip() + f" (95 %: {low} to {high})"

    def quantity_label(self, entry: Experiment | Prediction | Agreement) -> str:
        """A quantity with its conditions."""
        at = display.label(entry.at)
        return f"{display.quantity(entry.quantity).name}{f' at {at}' if at else ''}"

    def amount(self, quantity: str, entry: Interval) -> str:
        """Median and interval of a quantity, in the unit that people read."""
        unit = display.quantity(quantity)
        low, median, high = (display.number(x, (entry.high - entry.low) / 4, unit.scale)
                             for x in (entry.low, entry.median, entry.high))  # fmt: skip
        return f"{median} {unit.unit}".rstrip() + f" (95 %: {low} to {high})"

    def _predicted(self, entry: Prediction) -> str:
        unit = display.quantity(entry.quantity)
        line = f"Prediction: {self.quantity_label(entry)} = {self.amount(entry.quantity, entry.interval)}"
        if entry.measured is None:
            return line
        measured = f"{display.with_error(entry.measured, entry.error or math.nan, unit.scale)} {unit.unit}".rstrip()
        return f"{line}; measured {measured}, {'inside' if entry.agrees else 'outside'}"

    def card(self) -> str:
        """Write the material card: YAML that a study takes in by `include`. Raises NoPosterior without an answer."""
        if self.lacking:
            raise NoPosterior(f"there is no material card: {self.lacking}")
        card = {key: _copy(self.source[key]) for key in _SECTIONS if key in self.source and self._belongs(key)}
        if "grains" in card:
            card["grains"] = {key: value for key, value in card["grains"].items() if key in self._own("grains")}
        for key, text in written_at({key: _rounded(entry) for key, entry in self.parameters.items()}).items():
            *path, leaf = key.split(".")
            below = card
            for part in path:
                below = below.setdefault(part, {})
            below[leaf] = _number(text)
        lines = [f"# Material card of the study {self.study}: medians of a calibration, with 95 % intervals"]
        lines += [f"# {self.interval(key, entry)}" for key, entry in self.parameters.items()]
        lines += [f"# measured: {self.quantity_label(entry)}" for entry in self.agreements]
        return "\n".join(lines) + "\n" + as_yaml(card)

    def _belongs(self, section: str) -> bool:
        return section == "contact" or bool(self._own(section))

    def _own(self, section: str) -> set[str]:
        return {key.split(".")[1] for key in self.parameters if key.startswith(f"{section}.")}

    def plain(self) -> dict[str, Any]:
        """All results as plain values in SI, for programs."""
        inference, parameters = self.inference, {}
        for key, entry in self.parameters.items():
            parameters[key] = {"median": entry.median, "low": entry.low, "high": entry.high}
        correlation = np.sqrt(np.outer(*[np.diag(inference.posterior.covariance)] * 2))
        indices = [
            {"quantity": quantity, "number": number, "first": {key: entry for key, (entry, _) in of.items()},
             "total": {key: entry for key, (_, entry) in of.items()}}
            for (quantity, number), of in inference.sobol_indices().items()
        ]  # fmt: skip
        return {
            "study": self.study,
            "lacking": self.lacking or None,
            "runs": len(inference.trials),
            "emulator_share": inference.share,
            "parameters": parameters,
            "correlation": (inference.posterior.covariance / correlation).tolist(),
            "ridge": {"parts": dict(inference.ridge.components), "remaining": inference.ridge.remaining},
            "sobol_indices": indices,
            "next": [{**vars(entry), "at": dict(entry.at)} for entry in self.experiments[:5]],
            "measured": [
                {**vars(entry), "at": dict(entry.at), "model": vars(entry.model)} for entry in self.agreements
            ],
            "predictions": [
                {**vars(entry), "at": dict(entry.at), "interval": vars(entry.interval)} for entry in self.predictions
            ],
            "card": None if self.lacking else self.card(),
        }

    def _axis(self, key: str) -> Any:
        return next(axis for axis in self.inference.parameters if axis.key == key)


def calibration(results: StudyResults) -> CalibrationResults:
    """Infer the parameters of a study from its results.

    Raises:
        NoPosterior: The study has no `calibrate`, or too few runs.
        LearnMissing: A package of the extra `learn` is not installed.
    """
    goal = results.study.adapt
    if not isinstance(goal, Calibrate):
        remedy = "state its parameters under `calibrate` (for the effect of numerics there is labbook pilot)"
        raise NoPosterior(f"{results.study.name} has no parameters to calibrate; {remedy}")
    trials = trials_of(results)
    unmeasured = dict.fromkeys(
        entry.name
        for measure in (MEASURES[name] for name in results.study.measure)
        for entry in measure.declared
        if entry.pooled and entry.estimator == "mean"
        and all(t.numbers.get(entry.name, 0.0) > 0 for t in trials if t.numbers)  # emulators are of logarithms
    )  # fmt: skip
    try:
        inference = goal.infer(results.study, trials, tuple(unmeasured))
    except NotInferred as problem:
        raise NoPosterior(f"{results.study.name}: {problem}") from None
    return CalibrationResults(results.study.name, goal, inference, results.study.definition)


def trials_of(results: StudyResults) -> list[Trial]:
    """Give all runs as strategies see them."""
    trials = []
    for point in results.points:
        for run in point.runs:
            numbers = {name: entry.value for name, entry in run.measured.items()} if run.counted else {}
            finite = {name: value for name, value in numbers.items() if math.isfinite(value)}
            trials.append(Trial(point.point.at, run.seed, run.run_key, run.outcome, finite, run.discharge))
    return sorted(trials, key=lambda trial: trial.key)


def _rounded(entry: Interval) -> float:
    """The median, to a hundredth of the width of its interval."""
    digits = math.ceil(math.log10(abs(entry.median) / (entry.high - entry.low))) + 2
    return float(f"{entry.median:.{max(2, digits)}g}")


def _number(text: str) -> float | str:
    """A number without a unit, which YAML has without quotes; other text as it is."""
    try:
        return float(text)
    except ValueError:
        return text


def _copy(value: Any) -> Any:
    return {key: _copy(entry) for key, entry in value.items()} if isinstance(value, Mapping) else value
