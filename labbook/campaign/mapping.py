"""Goal `map`: a quantity over several swept keys, to a stated error on most of their range.

    adapt:
      map: {flow_rate: 2 %, over: [contact.friction, container.angle], on: 95 %}

The quantity has an emulator over the keys (`labbook.stats.emulator`). Runs are made where they lower its error most,
until the half width of the 95 % interval is small enough on the stated part of 1024 settings all over the range.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import model_validator

from labbook.campaign.goal import SCATTER, Goal, Step
from labbook.campaign.space import FEWEST_REPEATS, Axis, BedValues, SpaceTrend, one_bed_more, sobol
from labbook.campaign.strategy import Assignment, Proposal, Trial, point_key
from labbook.fit.interpolation import CLOGGED
from labbook.measure import MEASURES
from labbook.scene.model import Fault, Internal, refuse
from labbook.scene.quantities import parse, percent
from labbook.stats.emulator import Emulator, best_settings, check_installed

BATCH = 16
"""Runs of a generation after the start."""
LIMIT = 2000
"""Largest number of runs, unless `budget` is stated."""
_BEDS = 4
_TESTING = 32
"""Number of held-out runs."""
_LARGEST, _BEYOND = 1.33, 5
"""Root mean square of 32 standardised residuals, and number of residuals beyond 1.96, each exceeded in 0.5 % of all
cases."""
_PLACES, _CANDIDATES = 1024, 512
"""Number of settings at which the error is evaluated, and from which runs are chosen."""
_DONE = 0.1
"""Weight of settings that are known well enough, over that of the others."""
_NORMAL = 1.96


class Map(Goal):
    """Goal: a map of a quantity over several swept keys, to a stated error.

    ln(quantity) has an emulator over the keys (`labbook.stats.emulator`). Its half width is 1.96 standard errors, and
    has to be at most ln(1 + error).

    Args:
        quantity: Name of the quantity; it has to be pooled by the mean over beds.
        error: Half width of the 95 % interval to reach, relative to the quantity.
        over: The swept keys.
        on: Fraction of the range on which it is reached, 95 % by default.
    """

    name: ClassVar[str] = "map"
    version: ClassVar[int] = 2
    testing: ClassVar[int] = _TESTING
    beds: ClassVar[int] = _BEDS

    quantity: Annotated[str, Internal()]
    error: Annotated[float, Internal()]
    over: Annotated[tuple[str, ...], Internal()]
    on: Annotated[float, Internal()]

    @model_validator(mode="before")
    @classmethod
    def _of_mapping(cls, mapping: Any) -> Any:
        """Convert {quantity: part, over: [key, ...], on: part} to fields."""
        if isinstance(mapping, Mapping) and mapping.keys() >= {"quantity", "error", "over", "on"}:
            return mapping
        names = [name for name in mapping if name not in ("over", "on")] if isinstance(mapping, Mapping) else []
        if len(names) != 1 or "over" not in mapping:
            refuse([Fault("", "one quantity with its error, and `over` are needed", _EXAMPLE)])
        (quantity,) = names
        pooled = {
            q.name for measure in MEASURES.values() for q in measure.declared if q.pooled and q.estimator == "mean"
        }
        if quantity not in pooled:
            refuse([Fault(str(quantity), "this is no quantity that is pooled over beds", "write flow_rate")])
        over = mapping["over"]
        over = [over] if isinstance(over, str) else over
        if not isinstance(over, list | tuple) or not over or not all(isinstance(key, str) for key in over):
            refuse([Fault("over", "a list of swept keys is needed", _EXAMPLE)])
        error = _fraction(mapping[quantity], str(quantity), 1e-3)
        return {
            "quantity": quantity,
            "error": error,
            "over": tuple(over),
            "on": _fraction(mapping.get("on", 0.95), "on", 0.1),
        }

    def range_faults(self, points: Sequence[Any]) -> Iterator[Fault]:
        """Yield faults of the range of a study."""
        swept = dict.fromkeys(key for point in points for key in point.at)
        for key in dict.fromkeys((*self.over, *swept)):
            values = {point.at.get(key) for point in points}
            if key not in swept:
                yield Fault(
                    "map.over", f"the range of {key} is that of `sweep`, which does not have it", f"sweep {key}"
                )
            elif key not in self.over:
                yield Fault("map.over", f"{key} is swept as well", "add it to over, or leave it out of `sweep`")
            elif len(values) < 2 or any(isinstance(value, str) or value is None for value in values):
                yield Fault("map.over", f"the sweep of {key} is no range", "sweep two numbers or more")

    def needs(self) -> tuple[str, tuple[str, ...]]:
        """Describe what has to be measured, and name the measures of which one gives it."""
        giving = (name for name, measure in MEASURES.items() if any(q.name == self.quantity for q in measure.declared))
        return f"{self.quantity} is", tuple(giving)

    def plan_rule(self, study: Any) -> str:
        """State the end of the campaign, and the expected number of runs."""
        d = len(self.over)
        # four runs for each coefficient of a surface of second order, times (scatter / allowed standard error)^2
        needed = math.ceil(2 * (d + 1) * (d + 2) * (_NORMAL * SCATTER / self.error) ** 2)
        expected = max(_BEDS * len(self.first(study)), needed) + _TESTING
        return (
            f"{self.quantity} to {percent(self.error)} (half width of the 95 % interval) on {percent(self.on)} of the "
            f"range of {', '.join(self.over)}. {_BEDS * len(self.first(study))} runs over the range, then {BATCH} at a "
            f"time where they lower the error most, then {_TESTING} held-out runs. About {expected} runs"
            f"{self.limits(LIMIT)} (scatter of a run: {percent(SCATTER)})"
        )

    def first(self, study: Any) -> list[dict[str, float]]:
        """Return the first settings: a Sobol sequence. Raises LearnMissing, before anything runs."""
        check_installed()
        return self._settings(study, sobol(max(16, 4 * (len(self.over) + 1)), len(self.over)))

    def step(self, study: Any, trials: Sequence[Trial]) -> Step:
        """Propose runs where they lower the error most, or held-out runs once it is small enough.

        If the number of beds limits the error, more beds in the middle of the range are proposed.

        Args:
            study: The study, whose sweep is the range.
            trials: All runs so far.

        Returns:
            Runs of the next generation; held-out runs all over the range; or the end, if many runs clogged, few have a
            value, or no more runs are allowed.
        """
        values, _ = self._values(study, trials)
        clogged = sum(trial.outcome == "clogged" for trial in trials)
        if clogged > CLOGGED * len(trials):
            reason = f"{clogged} of {len(trials)} runs clogged, so the others are a biased sample"
            return Step(Proposal.end(f"{reason}; sweep a range without clogging"))
        if values.repeats < FEWEST_REPEATS or values.points < 2 * len(self.over):
            reason = (
                f"{self.quantity} has a value in {len(values.values)} of {len(trials)} runs, too few for an emulator"
            )
            return Step(Proposal.end(f"{reason}; change `sweep`"))
        # the settings below are the same at each call: a campaign that is resumed has to come to the same end
        emulator = values.emulator()
        _, errors = emulator.at(sobol(_PLACES, len(self.over), stream=5))
        reached = float(np.mean(_NORMAL * errors <= math.log1p(self.error)))
        progress = f"{percent(self.error)} on {percent(reached)} of the range from {len(trials)} runs"
        if reached >= self.on:
            tested = self._settings(study, sobol(_TESTING, len(self.over), stream=6))
            new = {
                point_key(at): Assignment(at, 1)
                for at in tested
                if point_key(at) not in {point_key(t.at) for t in trials}
            }
            reason = f"{progress}; {len(new)} runs are held out to test it"
            return Step(Proposal(tuple(new.values()), reason), holds_out=True)
        if not self.is_limited and len(trials) + BATCH > LIMIT:
            reason = f"{LIMIT} runs are made without a stated budget, and the promise is not reached"
            return Step(Proposal.end(f"{reason}: {progress}"))
        # runs of one seed share their packing: this part of the variance falls with the number of seeds only
        if values.of_bed_means > 0.5 * (math.log1p(self.error) / _NORMAL) ** 2:
            middle = min(trials, key=lambda trial: (self._off(study, trial), trial.key))
            beds = max(trial.seed for trial in trials if point_key(trial.at) == point_key(middle.at))
            reason = f"{progress}, limited by what beds have in common: {BATCH} beds more in the middle"
            return Step(Proposal((Assignment(middle.at, beds + BATCH),), reason))
        candidates = sobol(_CANDIDATES, len(self.over), skip=len(trials), stream=7)
        covariance = emulator.covariance(candidates)
        wide = _NORMAL * np.sqrt(np.diag(covariance)) > math.log1p(self.error)
        picks = best_settings([covariance], [values.variance], [np.where(wide, 1.0, _DONE)], BATCH)
        assignments = one_bed_more(self._settings(study, candidates[picks]), trials)
        return Step(Proposal(assignments, f"{progress}: {len(picks)} runs where they lower its error most"))

    def verdict(self, study: Any, trials: Sequence[Trial], withheld: Sequence[Trial]) -> str:
        """Compare held-out runs with the map.

        The promise is kept if the root mean square of the standardised residuals, and the number of large ones, are
        below values that a correct map exceeds in 0.5 % of all cases each.

        Args:
            study: The study.
            trials: Runs on which the map rests.
            withheld: Held-out runs all over the range.

        Returns:
            The part of the range with the stated error, and the verdict, in sentences.
        """
        emulator, values, trend = self.emulator(study, trials)
        _, errors = emulator.at(sobol(_PLACES, len(self.over), stream=5))
        reached = float(np.mean(_NORMAL * errors <= math.log1p(self.error)))
        answer = f"{self.quantity} is known to {percent(self.error)} on {percent(reached)} of the range "
        answer += f"from {len(trials)} runs"
        axes, residuals = self.axes(study), list[float]()
        for trial in withheld:
            value = trial.numbers.get(self.quantity, math.nan)
            if trial.outcome == "clogged" or not value > 0:
                continue
            mean, error = emulator.at(np.array([[float(axis.unit(float(trial.at[axis.key]))) for axis in axes]]))
            # a single run deviates from the map by the error of the map, its own noise and the contribution of its bed
            spread = math.sqrt(float(error[0]) ** 2 + values.variance + values.of_beds)
            residuals.append((math.log(value) - trend.at(trial.at) - float(mean[0])) / spread)
        if len(residuals) < _TESTING // 2:
            return f"{answer}. Promise not tested: {len(residuals)} of {len(withheld)} held-out runs have a value"
        rms, beyond = math.sqrt(float(np.mean(np.square(residuals)))), int(np.sum(np.abs(residuals) > _NORMAL))
        word = "kept" if rms <= _LARGEST and beyond <= _BEYOND else "not kept"
        return (
            f"{answer}. Promise {word}: the residuals of {len(residuals)} held-out runs are {rms:.2f} standard errors "
            f"(root mean square, at most {_LARGEST} is expected), {beyond} of them beyond {_NORMAL} (at most {_BEYOND})"
        )

    def emulator(self, study: Any, trials: Sequence[Trial]) -> tuple[Emulator, BedValues, SpaceTrend]:
        """Fit the map to runs. Raises LearnMissing."""
        values, trend = self._values(study, trials)
        return values.emulator(), values, trend

    def axes(self, study: Any) -> tuple[Axis, ...]:
        """Return the axes of the keys, with the ranges of the sweep."""
        values = {key: [float(point.at[key]) for point in study.points] for key in self.over}
        return tuple(Axis(key, min(of), max(of)) for key, of in values.items())

    def _values(self, study: Any, trials: Sequence[Trial]) -> tuple[BedValues, SpaceTrend]:
        axes = self.axes(study)
        trend = SpaceTrend.of(self.quantity, axes, study.points[0].scene)
        return BedValues.of(trials, self.quantity, axes, trend), trend

    def _settings(self, study: Any, points: np.ndarray) -> list[dict[str, float]]:
        axes = self.axes(study)
        return [{axis.key: axis.setting(float(u)) for axis, u in zip(axes, point, strict=True)} for point in points]

    def _off(self, study: Any, trial: Trial) -> float:
        """Squared distance of a run from the middle of the range."""
        return sum((float(axis.unit(float(trial.at[axis.key]))) - 0.5) ** 2 for axis in self.axes(study))


def _fraction(raw: Any, key: str, least: float) -> float:
    try:
        fraction = parse(raw, "") if isinstance(raw, str) else float(raw)
    except (ValueError, TypeError):
        fraction = math.nan
    if not least <= fraction < 1:
        refuse([Fault(key, f"{raw}: a fraction from {least:g} to 1 is needed", "write 2 %")])
    return fraction


_EXAMPLE = "write {flow_rate: 2 %, over: [contact.friction, container.angle], on: 95 %}"
