"""Goals: strategies with a promise that is tested on held-out runs.

A goal proposes generations until it estimates that its promise is kept, then further beds of the same design. These are
held out: they take no part in the choice, and the last line of the campaign states if they agree with the promise.
"""

import re
from abc import abstractmethod
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, Field, PrivateAttr, model_validator

from labbook.campaign.strategy import Assignment, Generation, History, Proposal, Strategy, Trial, Values, point_key
from labbook.fit.interpolation import CLOGGED
from labbook.scene.model import Fault, Internal, Model, refuse
from labbook.scene.quantities import Duration, duration, whole
from labbook.warning import rename_in_subclass

HELD_OUT = 8
"""Number of held-out beds."""
SCATTER = 0.022
"""Relative scatter of the flow rate between runs, for forecasts before there are any (typical of the bundled
studies)."""


def _runs(number: Any) -> Any:
    """Parse `60 runs` as 60."""
    match = _COUNTED.fullmatch(number) if isinstance(number, str) else None
    return whole(match[1] if match else number)


_COUNTED = re.compile(r"\s*(\S+)\s+runs?\s*")


class CampaignBudget(Model):
    """Largest cost of a campaign: a number of runs, a device time, or both."""

    runs: Annotated[int | None, Field(strict=True, ge=16, le=200_000), BeforeValidator(_runs)] = None
    """Largest number of runs."""
    device_time: Duration | None = None
    """Largest device time [s]."""

    @model_validator(mode="before")
    @classmethod
    def _of_text(cls, budget: Any) -> Any:
        """Convert `60 runs`, 60 and `10 min` to a mapping."""
        if isinstance(budget, Mapping):
            if not budget:
                refuse([Fault("", "runs or device_time is needed", "write {runs: 60, device_time: 10 min}")])
            return budget
        counts = not isinstance(budget, str) or _COUNTED.fullmatch(budget) or isinstance(whole(budget), int)
        return {"runs" if counts else "device_time": budget}


class Budgeted(Model):
    """Keys beside the goal of a study."""

    budget: CampaignBudget | None = None
    """Largest cost of the campaign; none: no limit but `accuracy.max_replicates` of a point."""


@dataclass(frozen=True)
class DeviceTime:
    """Device time of runs and of their fillings.

    Args:
        total: Sum of the known times [s], of each filling once.
        beds: Number of beds all of whose times are known.
        gaps: Number of runs of which a time is not recorded.
    """

    total: float
    beds: int
    gaps: int

    @classmethod
    def of(cls, trials: Iterable[Trial]) -> "DeviceTime":
        """Add the times of runs."""
        runs = list(trials)
        # by key: runs of one bed share its filling
        times = {key: time for trial in runs for key, time in trial.device_time.items() if time is not None}
        complete = [trial for trial in runs if trial.device_time and None not in trial.device_time.values()]
        beds = {(point_key(trial.at), trial.seed) for trial in complete}
        return cls(sum(times.values()), len(beds), len(runs) - len(complete))

    def in_words(self, budget: float) -> str:
        """Describe the part of a budget [s] that is used."""
        words = f"{duration(self.total)} of {duration(budget)} of device time used"
        number = f"{self.gaps} run{'' if self.gaps == 1 else 's'}"
        return f"{words}, not counting {number} without a recorded device time" if self.gaps else words


@dataclass(frozen=True)
class Step:
    """Next proposal of a goal.

    Args:
        proposal: The proposal.
        holds_out: Its runs are held out.
    """

    proposal: Proposal
    holds_out: bool = False


class Goal(Strategy):
    """Base class of strategies with a promise. A goal waits for all runs of a generation before the next.

    A subclass defines `first`, `step` and `verdict`.

    Attributes:
        testing: Number of held-out beds, at all points together.
        beds: Beds of each point of the start.
        point_noun: Word for the points of the start.
        budget: Largest number of runs, stated beside the goal; None: no limit.
        device_time: Largest device time [s], stated in the same way. It ends a campaign and has no influence on points.
    """

    ahead: ClassVar[int] = 0
    testing: ClassVar[int] = HELD_OUT
    beds: ClassVar[int] = 2
    point_noun: ClassVar[str] = "points"

    budget: Annotated[int | None, Internal()] = None
    """Largest number of runs, stated beside the goal."""
    device_time: Annotated[float | None, Internal(), Field(exclude_if=lambda time: time is None)] = None
    """Largest device time [s], stated beside the goal."""
    _latest: tuple[Any, tuple[str, ...], Step] | None = PrivateAttr(default=None)
    """Study, keys of all runs, and the step after them."""

    def __init_subclass__(cls, **further: Any):
        rename_in_subclass(cls, "places", "point_noun")
        super().__init_subclass__(**further)

    def propose(self, history: History) -> Proposal:
        """Propose the next generation; after the held-out runs, end with the verdict on the promise.

        Args:
            history: The complete generations with their runs, and those in flight.

        Returns:
            `Proposal.wait()` while a generation is in flight; then the next step of the goal, or the end.
        """
        if history.pending:
            return Proposal.wait()
        proposal = self._proposal(history.study, history.generations)
        if self.device_time is None or not history.generations:
            return proposal
        used = DeviceTime.of(_trials(history.generations)).in_words(self.device_time)
        return replace(proposal, reason=f"{proposal.reason}; {used}")

    def _proposal(self, study: Any, generations: Sequence[Generation]) -> Proposal:
        # computed again instead of stored: the history alone decides, also after a restart
        if generations and self._next(study, generations[:-1]).holds_out:
            trials = _trials(generations[:-1])
            return Proposal.end(self.verdict(study, trials, self.withheld(trials, generations[-1].trials or ())))
        return self._next(study, generations).proposal

    @abstractmethod
    def first(self, study: Any) -> Sequence[Values]:
        """Return the points of the first generation."""

    def start(self, study: Any) -> Proposal:
        """Propose the first generation: all its points, with equal numbers of beds."""
        points = self.first(study)
        assignments = tuple(Assignment(at, self.beds) for at in points)
        return Proposal(assignments, f"{len(points)} {self.point_noun} over the range, with {self.beds} beds each")

    def obstacles(self, measures: Sequence[str], points: Sequence[Any]) -> Iterator[Fault]:
        """Yield faults of a study: of its range, of its measures, and further ones of this goal."""
        faults = [*self.range_faults(points)]
        yield from faults
        subject, giving = self.needs()
        if giving and not {*giving} & {*measures}:
            yield Fault(self.name, f"{subject} not measured", f"add {giving[0]} to measure")
        if not faults:
            yield from self.further_faults(measures, points)

    def range_faults(self, points: Sequence[Any]) -> Iterable[Fault]:
        """List faults of the range of a study."""
        return ()

    def needs(self) -> tuple[str, Sequence[str]]:
        """Describe what has to be measured (`stops are`), and name the measures of which one gives it."""
        return "", ()

    def further_faults(self, measures: Sequence[str], points: Sequence[Any]) -> Iterable[Fault]:
        """List further faults of a study that has a range."""
        return ()

    @abstractmethod
    def step(self, study: Any, trials: Sequence[Trial]) -> Step:
        """Propose the next runs from all runs so far.

        Args:
            study: The study as its author stated it.
            trials: All runs.

        Returns:
            More runs, held-out runs, or an end without them, with the reason.
        """

    def withheld(self, trials: Sequence[Trial], latest: Sequence[Trial]) -> list[Trial]:
        """Select the held-out runs of the `latest` generation.

        They are at points that no earlier run has, or of beds that no earlier run at any point has.
        """
        points, seed = {point_key(trial.at) for trial in trials}, max(trial.seed for trial in trials)
        return [trial for trial in latest if trial.seed > seed or point_key(trial.at) not in points]

    @abstractmethod
    def verdict(self, study: Any, trials: Sequence[Trial], withheld: Sequence[Trial]) -> str:
        """State the agreement of held-out runs with the promise.

        Args:
            study: The study.
            trials: Runs on which the promise rests.
            withheld: Held-out runs.

        Returns:
            Sentences for the last line of the campaign.
        """

    def _next(self, study: Any, generations: Sequence[Generation]) -> Step:
        """Compute the step after some generations; the latest is cached, as each is needed twice."""
        trials = _trials(generations)
        keys = tuple(trial.key for trial in trials)
        if self._latest is None or self._latest[0] is not study or self._latest[1] != keys:
            self._latest = study, keys, self._within_budget(study, trials)
        return self._latest[2]

    def _within_budget(self, study: Any, trials: Sequence[Trial]) -> Step:
        step = self.step(study, trials) if trials else Step(self.start(study))
        if step.proposal.state != "go" or step.holds_out:
            return step
        exceeded = self._exceeded(study, new_beds(step.proposal.assignments, trials) + self.testing, trials)
        if not exceeded:
            return step
        reason = f"the budget of {exceeded} does not allow more, and the promise is not reached"
        return Step(Proposal.end(f"{reason}: {step.proposal.reason}"))

    def _exceeded(self, study: Any, beds: int, trials: Sequence[Trial]) -> str:
        """Name the budget that does not allow further beds; empty if all do."""
        if self.budget is not None and len(trials) + beds * study.discharges_per_bed > self.budget:
            return f"{self.budget} runs"
        if self.device_time is not None:
            used = DeviceTime.of(trials)
            # further beds are expected to take the mean time of those so far
            if used.beds and used.total * (1 + beds / used.beds) > self.device_time:
                return f"{duration(self.device_time)} of device time"
        return ""

    @property
    def is_limited(self) -> bool:
        """True if a budget is stated."""
        return self.budget is not None or self.device_time is not None

    def limits(self, limit: int | None = None) -> str:
        """Describe the budget, as `, at most 60 runs`. `limit`: number of runs without a stated budget."""
        runs = self.budget if self.is_limited else limit
        parts = [] if runs is None else [f"{runs} runs"]
        parts += [] if self.device_time is None else [f"{duration(self.device_time)} of device time"]
        return f", at most {' and '.join(parts)}" if parts else ""


def _trials(generations: Sequence[Generation]) -> list[Trial]:
    """Collect the runs of some generations, each once: a point that is proposed again has its earlier runs in each."""
    runs = {trial.key: trial for generation in generations for trial in generation.trials or ()}
    return list(runs.values())


def new_beds(assignments: Sequence[Assignment], trials: Sequence[Trial]) -> int:
    """Count the beds of assignments that have no run yet."""
    there = {(point_key(trial.at), trial.seed) for trial in trials}
    proposed = {
        (point_key(assignment.at), seed) for assignment in assignments for seed in range(1, assignment.replicates + 1)
    }
    return len(proposed - there)


def held_out(at: Any, trials: Sequence[Trial], reason: str) -> Step:
    """Propose beds of one point with seeds that no run at any point has."""
    latest = max(trial.seed for trial in trials)
    return Step(
        Proposal((Assignment(at, latest + HELD_OUT),), f"{reason}; {HELD_OUT} beds are held out to test it"), True
    )


def clogged_places(trials: Sequence[Trial]) -> set[tuple]:
    """Points, by `point_key`, at which so many runs clogged that the others are a biased sample."""
    runs = Counter(point_key(trial.at) for trial in trials)
    clogged = Counter(point_key(trial.at) for trial in trials if trial.outcome == "clogged")
    return {at for at, number in clogged.items() if number > CLOGGED * runs[at]}


@dataclass(frozen=True)
class KeyRange:
    """Range of the only swept key of a study.

    Args:
        key: The key.
        values: Values that the sweep lists, ascending [SI].
    """

    key: str
    values: tuple[float, ...]

    def within(self, low: float, high: float) -> "KeyRange":
        """Reduce it to a smaller range, whose ends count as listed."""
        inner = (value for value in self.values if low < value < high)
        return KeyRange(self.key, (low, *inner, high))


def only_swept(points: Sequence[Any]) -> KeyRange | None:
    """Find the swept key of a study that sweeps one key over numbers; None otherwise."""
    keys = dict.fromkeys(key for point in points for key in point.at)
    if len(keys) != 1:
        return None
    (key,) = keys
    values = [point.at.get(key) for point in points]
    if any(isinstance(value, str) or value is None for value in values):
        return None
    return KeyRange(key, tuple(sorted({float(value) for value in values if value is not None})))


def spread(sweep: KeyRange, number: int, digits: int = 4) -> tuple[float, ...]:
    """Spread settings evenly over a sweep; listed values are taken if they are as many, or up to twice as many."""
    if number <= len(sweep.values) <= 2 * number:
        return sweep.values
    low, high = sweep.values[0], sweep.values[-1]
    inner = [rounded(low + (high - low) * k / (number - 1), digits) for k in range(1, number - 1)]
    return (low, *inner, high)


def rounded(value: float, digits: int = 4) -> float:
    """Round a setting to some digits, as a study would state it: runs at it are then those of such a study."""
    return float(f"{value:.{digits}g}")


def of_one_key(goal: str, key: str, points: Sequence[Any]) -> list[Fault]:
    """List faults of a study that does not sweep `key` alone, over a range; `goal`: name in messages."""
    sweep = only_swept(points)
    if sweep is None or sweep.key != key:
        swept = ", ".join(dict.fromkeys(name for point in points for name in point.at)) or "nothing"
        reason = f"the range of {key} is that of `sweep`, and the study sweeps {swept}"
        return [Fault(goal, reason, f"sweep {key} alone, with numbers: its smallest and largest value are the range")]
    if len(sweep.values) < 2:
        return [Fault(goal, f"the sweep has one value of {key}, which is no range", "list two values or more")]
    return []
