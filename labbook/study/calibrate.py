"""The `calibrate` section: parameters with their priors, and what is requested of them. The measured values are those
of `reference`."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pydantic import TypeAdapter, ValidationError

from labbook.campaign import Calibrate, Measurement, Prior, point_key
from labbook.campaign.goal import CampaignBudget
from labbook.measure import MEASURES
from labbook.scene.quantities import parse
from labbook.study.keys import Key, find, nearest
from labbook.study.point import Point
from labbook.study.problems import Problem, instead, quote
from labbook.study.reference import condition
from labbook.study.schema import Reference, ReferenceEntry, Settings
from labbook.study.source import Location, StudyText, dotted

_KEYS = ("parameters", "discrepancy", "accuracy", "predict", "batch", "budget")
_PRIORS = ("uniform", "loguniform")
_PARAMETERS = 8
"""Parameters of a calibration."""
_EXAMPLE = "write {contact.friction: {uniform: [0.1, 0.9]}}"
_NO_PREDICTION = "write [{container.orifice: 21 mm}]"


class CalibrateReader:
    """Reads `calibrate`; problems are collected in `problems`."""

    def __init__(
        self, source: StudyText, points: Sequence[Point], reference: Reference | None, settings: Settings | None
    ):
        self._source, self._points, self._reference, self._settings = source, points, reference, settings
        self.problems: list[Problem] = []

    def read(self) -> Calibrate | None:
        """Give the strategy; None if there is no such section, or something is wrong with it."""
        if "calibrate" not in self._source.data:
            return None
        raw = self._source.data["calibrate"]
        if not isinstance(raw, Mapping):
            self._problem((), "a mapping of keys is needed", "write `parameters:` and `discrepancy:` below it")
            return None
        for key in raw:
            if key not in _KEYS:
                self._problem((key,), "unknown key", instead(str(key), _KEYS))
        if not self._points or self._settings is None:
            return None
        if self._settings.adapt is not None:
            self._problem((), "the study has `adapt` as well", "leave one of the two out")
        if self._settings.discharges_per_bed == "auto":
            remedy = "state discharges_per_bed as a number"
            self._problem((), "a calibration decides how many beds a point has, so that no number is cheapest", remedy)
        parameters = self._parameters(raw.get("parameters"))
        discrepancy = self._fraction(raw.get("discrepancy"), ("discrepancy",), least=0.0)
        accuracy = self._accuracy(raw.get("accuracy", {}), parameters)
        predict = tuple(self._predict(raw.get("predict", [])))
        measurements = tuple(self._measurements(parameters, predict))
        batch, budget = self._batch(raw), self._budget(raw)
        if batch is not None and not 8 <= batch <= 1024:
            self._problem(("batch",), f"{batch} runs are no round", "write a number from 8 to 1024")
        if not self.problems and not any(not one.withheld for one in measurements):
            remedy = "state measured values under `reference`, such as reference: {file: measured.csv}"
            self._problem((), "there is no measured value to calibrate with", remedy)
        if self.problems:
            return None
        entry = budget if batch is None else {**budget, "batch": batch}
        return Calibrate(
            parameters=parameters,
            measurements=measurements,
            discrepancy=discrepancy,
            accuracy=accuracy,
            predict=predict,
            **entry,
        )

    def _parameters(self, raw: Any) -> dict[str, Prior]:
        if not isinstance(raw, Mapping) or not raw:
            self._problem(("parameters",), "parameters with their priors are needed", _EXAMPLE)
            return {}
        if len(raw) > _PARAMETERS:
            self._problem(("parameters",), f"{len(raw)} parameters are too many", f"state at most {_PARAMETERS}")
        priors = {}
        for key, entry in raw.items():
            place_of = ("parameters", key)
            declared = next((one for one in find(str(key)) if one.sweepable and one.type == "quantity"), None)
            if declared is None:
                self._problem(place_of, "there is no such key that takes a quantity", nearest(str(key)))
            elif any(key in point.at for point in self._points):
                self._problem(place_of, "this key is swept as well", "leave it out of `sweep`")
            elif (prior := self._prior(entry, declared, place_of)) is not None:
                priors[str(key)] = prior
        return priors

    def _prior(self, entry: Any, key: Key, place_of: Location) -> Prior | None:
        if not (isinstance(entry, Mapping) and len(entry) == 1 and next(iter(entry)) in _PRIORS):
            self._problem(place_of, f"{quote(entry)} is no prior", f"name one of {', '.join(_PRIORS)}: {_EXAMPLE}")
            return None
        ((kind, ends),) = entry.items()
        if not (isinstance(ends, list | tuple) and len(ends) == 2):
            self._problem((*place_of, kind), "two values are needed", _EXAMPLE)
            return None
        try:
            diameter = self._points[0].scene.grains.diameter
            low, high = (float(condition(end, key, diameter)) for end in ends)
        except ValueError as error:
            self._problem((*place_of, kind), str(error), key.remedy)
            return None
        if not low < high or (kind == "loguniform" and low <= 0):
            need = "the first above 0 and below the second" if kind == "loguniform" else "the first below the second"
            self._problem((*place_of, kind), f"{ends[0]} and {ends[1]} are no range", f"write two values, {need}")
            return None
        return Prior(low=low, high=high, logarithmic=kind == "loguniform")

    def _accuracy(self, raw: Any, parameters: Mapping[str, Prior]) -> dict[str, float]:
        if not isinstance(raw, Mapping):
            self._problem(("accuracy",), "a mapping of parameters is needed", "write {contact.friction: 5 %}")
            return {}
        fractions = {}
        for key, entry in raw.items():
            if key not in parameters and not self.problems:
                self._problem(("accuracy", key), "this is no parameter", f"name one of {', '.join(parameters)}")
            fractions[str(key)] = self._fraction(entry, ("accuracy", key), least=1e-4)
        return fractions

    def _predict(self, raw: Any) -> Iterator[dict[str, float]]:
        if not isinstance(raw, list | tuple) or not all(isinstance(one, Mapping) and one for one in raw):
            self._problem(("predict",), "a list of conditions is needed", _NO_PREDICTION)
            return
        for number, entry in enumerate(raw):
            at = {}
            for key, value in entry.items():
                declared = next((one for one in find(str(key)) if one.sweepable and one.type == "quantity"), None)
                try:
                    if declared is None:
                        raise ValueError("there is no such key that takes a quantity")
                    at[str(key)] = float(condition(value, declared, self._points[0].scene.grains.diameter))
                except ValueError as error:
                    self._problem(("predict", number, key), str(error), _NO_PREDICTION)
            yield at

    def _measurements(
        self, parameters: Mapping[str, Prior], predict: Sequence[Mapping[str, float]]
    ) -> Iterator[Measurement]:
        """Measured values of the reference that runs can have."""
        swept = list(dict.fromkeys(key for point in self._points for key in point.at))
        withheld = {point_key(at) for at in predict}
        for entry in self._reference.entries if self._reference is not None else ():
            problem = self._unusable(entry, swept, parameters)
            if problem is not None:
                self._problem((), f"reference, {entry.quantity}: {problem[0]}", problem[1])
                continue
            at = {key: float(value) for key, value in entry.at.items() if key in swept}
            name, error = entry.quantity.rpartition(".")[2], entry.error or 0.0
            yield Measurement(quantity=name, at=at, value=entry.value, error=error, withheld=point_key(at) in withheld)

    def _unusable(
        self, entry: ReferenceEntry, swept: Sequence[str], parameters: Mapping[str, Prior]
    ) -> tuple[str, str] | None:
        """Reason why a measured value cannot be used, and the remedy."""
        assert self._settings is not None
        name = entry.quantity.rpartition(".")[2]
        measures = [MEASURES[one] for one in self._settings.measure if one in MEASURES]
        pooled = {
            quantity.name
            for measure in measures
            for quantity in measure.declared
            if quantity.pooled and quantity.estimator == "mean"
        }
        if name not in pooled:
            return "this is no quantity of the runs", f"measured values may be of {', '.join(sorted(pooled))}"
        if not entry.error:
            return "the standard error is missing", "state `error`, in the unit of the value"
        if entry.value <= 0:
            return "a value above 0 is needed", "leave it out"
        lacking = [key for key in swept if key not in entry.at]
        if lacking:
            return f"it does not say at which {', '.join(lacking)}", "state all swept keys of each measured value"
        if any(isinstance(entry.at[key], str) for key in swept):
            return "its conditions are words", "calibrate with conditions that are numbers"
        if any(key in parameters for key in entry.at):
            return "it states a parameter of the calibration", "leave that key out"
        return None

    def _fraction(self, raw: Any, place_of: Location, least: float) -> float:
        try:
            fraction = parse(raw, "") if isinstance(raw, str) else float(raw)
        except (ValueError, TypeError):
            fraction = math.nan
        if not least <= fraction < 1:
            meaning = " (standard deviation between the model and reality, over the value)" * (place_of[0] == _KEYS[1])
            self._problem(place_of, f"a fraction from {least:g} to 1 is needed{meaning}", "write 3 %")
        return fraction

    def _batch(self, raw: Mapping[str, Any]) -> int | None:
        try:
            return TypeAdapter(int | None).validate_python(raw.get("batch"))
        except ValidationError:
            self._problem(("batch",), f"{quote(raw['batch'])} is no number of runs", "write a number from 8 to 1024")
            return None

    def _budget(self, raw: Mapping[str, Any]) -> dict[str, Any]:
        """Fields of the strategy with the stated budget; none without one."""
        if raw.get("budget") is None:
            return {}
        try:
            budget = TypeAdapter(CampaignBudget).validate_python(raw["budget"], context={"units": "required"})
        except ValidationError:
            remedy = "write 900 runs (at least 16), a device time such as 10 min, or {runs: 900, device_time: 10 min}"
            self._problem(("budget",), f"{quote(raw['budget'])} is no budget", remedy)
            return {}
        return {"budget": budget.runs, "device_time": budget.device_time}

    def _problem(self, below: Location, message: str, remedy: str) -> None:
        location = ("calibrate", *below)
        line = self._source.line(location)
        self.problems.append(Problem(self._source.path, line, quote(dotted(location)), message, remedy))
