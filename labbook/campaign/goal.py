"""Goals: strategies with a promise, which says when they are done and is tested on runs that they did not see.

A goal proposes generations until its promise is kept by its own reckoning, then further beds of the same design. These
are held out: they take no part in the choice, and the last line of the campaign says if they agree with the promise.
"""

import re
from abc import abstractmethod
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, Field, PrivateAttr

from labbook.campaign.strategy import Assignment, Generation, History, Proposal, Strategy, Trial, Values, place
from labbook.fit.interpolation import CLOGGED
from labbook.scene.model import Fault, Internal, Model
from labbook.scene.quantities import whole

HELD_OUT = 8
"""Beds that are held out."""
SCATTER = 0.022
"""Scatter of the flow rate between runs, relative to it, by which runs are foreseen before there are any (the typical
one of the studies that ship)."""


def _runs(number: Any) -> Any:
    """`60 runs` as 60."""
    match = re.fullmatch(r"\s*(\S+)\s+runs?\s*", number) if isinstance(number, str) else None
    return whole(match[1] if match else number)


Budget = Annotated[int | None, Field(strict=True, ge=16, le=200_000), BeforeValidator(_runs)]


class Budgeted(Model):
    """Keys beside the goal of a study."""

    budget: Budget = None
    """Largest number of runs of the campaign; none: no limit but `accuracy.max_replicates` of a point."""


@dataclass(frozen=True)
class Step:
    """Next proposal of a goal, and if its runs are held out."""

    proposal: Proposal
    holds_out: bool = False


class Goal(Strategy):
    """A strategy with a promise. It waits for all runs of a generation: each rests on all results so far."""

    ahead: ClassVar[int] = 0
    testing: ClassVar[int] = HELD_OUT
    """Beds that are held out, at all points together."""
    beds: ClassVar[int] = 2
    """Beds of each point of the start."""
    places: ClassVar[str] = "points"
    """Word for the points of the start."""

    budget: Annotated[int | None, Internal()] = None
    """Largest number of runs, stated beside the goal."""
    _latest: tuple[Any, tuple[str, ...], Step] | None = PrivateAttr(default=None)
    """Study, keys of all runs, and the step after them."""

    def propose(self, history: History) -> Proposal:
        """Propose the next generation; after the runs that are held out, end with what they say of the promise."""
        if history.pending:
            return Proposal.wait()
        generations = history.generations
        if generations and self._next(history.study, generations[:-1]).holds_out:
            trials = _trials(generations[:-1])
            return Proposal.end(
                self.verdict(history.study, trials, self.withheld(trials, generations[-1].trials or ()))
            )
        return self._next(history.study, generations).proposal

    @abstractmethod
    def first(self, study: Any) -> Sequence[Values]:
        """Give the points of the first generation."""

    def start(self, study: Any) -> Proposal:
        """Propose the first generation: all its points, with as many beds each."""
        points = self.first(study)
        assignments = tuple(Assignment(at, self.beds) for at in points)
        return Proposal(assignments, f"{len(points)} {self.places} over the range, with {self.beds} beds each")

    def obstacles(self, measures: Sequence[str], points: Sequence[Any]) -> Iterator[Fault]:
        """Find what a study lacks: a range, what has to be measured, and what only this goal needs."""
        faults = [*self.range_faults(points)]
        yield from faults
        subject, giving = self.needs()
        if giving and not {*giving} & {*measures}:
            yield Fault(self.name, f"{subject} not measured", f"add {giving[0]} to measure")
        if not faults:
            yield from self.further_faults(measures, points)

    def range_faults(self, points: Sequence[Any]) -> Iterable[Fault]:
        """Find what a study lacks of the range."""
        return ()

    def needs(self) -> tuple[str, Sequence[str]]:
        """Say what has to be measured (`stops are`), and give the measures of which one gives it."""
        return "", ()

    def further_faults(self, measures: Sequence[str], points: Sequence[Any]) -> Iterable[Fault]:
        """Find what else a study with a range lacks."""
        return ()

    @abstractmethod
    def step(self, study: Any, trials: Sequence[Trial]) -> Step:
        """Propose what follows from all runs so far.

        Args:
            study: As its author stated it.
            trials: All runs.

        Returns:
            More runs, those that are held out, or an end without them, with the reason.
        """

    def withheld(self, trials: Sequence[Trial], latest: Sequence[Trial]) -> list[Trial]:
        """Pick the held-out runs of the `latest` generation: those at points that no run so far has, or of beds that
        no run at any point has."""
        points, seed = {place(trial.at) for trial in trials}, max(trial.seed for trial in trials)
        return [trial for trial in latest if trial.seed > seed or place(trial.at) not in points]

    @abstractmethod
    def verdict(self, study: Any, trials: Sequence[Trial], withheld: Sequence[Trial]) -> str:
        """Say what the `withheld` runs say of the promise, which rests on `trials`."""

    def _next(self, study: Any, generations: Sequence[Generation]) -> Step:
        """Give the step after some generations; the latest one is remembered, as each is looked at twice."""
        trials = _trials(generations)
        keys = tuple(trial.key for trial in trials)
        if self._latest is None or self._latest[0] is not study or self._latest[1] != keys:
            self._latest = study, keys, self._within_budget(study, trials)
        return self._latest[2]

    def _within_budget(self, study: Any, trials: Sequence[Trial]) -> Step:
        step = self.step(study, trials) if trials else Step(self.start(study))
        if self.budget is None or step.proposal.state != "go" or step.holds_out:
            return step
        new = new_beds(step.proposal.assignments, trials) + self.testing
        if len(trials) + new * study.discharges_per_bed <= self.budget:
            return step
        reason = f"the budget of {self.budget} runs does not allow more, and the promise is not reached"
        return Step(Proposal.end(f"{reason}: {step.proposal.reason}"))


def _trials(generations: Sequence[Generation]) -> list[Trial]:
    """All runs of some generations, each once: a point that is proposed again has its earlier runs in each."""
    runs = {trial.key: trial for generation in generations for trial in generation.trials or ()}
    return list(runs.values())


def new_beds(assignments: Sequence[Assignment], trials: Sequence[Trial]) -> int:
    """Count the beds of assignments that are not among the runs."""
    there = {(place(trial.at), trial.seed) for trial in trials}
    proposed = {(place(one.at), seed) for one in assignments for seed in range(1, one.replicates + 1)}
    return len(proposed - there)


def held_out(at: Any, trials: Sequence[Trial], reason: str) -> Step:
    """Propose beds of one point that no run so far has, at any point."""
    latest = max(trial.seed for trial in trials)
    return Step(
        Proposal((Assignment(at, latest + HELD_OUT),), f"{reason}; {HELD_OUT} beds are held out to test it"), True
    )


def clogged_places(trials: Sequence[Trial]) -> set[tuple]:
    """Give the points at which so many runs clogged that the others are no fair sample, by `place`."""
    runs = Counter(place(trial.at) for trial in trials)
    clogged = Counter(place(trial.at) for trial in trials if trial.outcome == "clogged")
    return {at for at, number in clogged.items() if number > CLOGGED * runs[at]}


@dataclass(frozen=True)
class KeyRange:
    """The only swept key of a study, with the values that the sweep lists [SI]."""

    key: str
    values: tuple[float, ...]

    def within(self, low: float, high: float) -> "KeyRange":
        """Cut it to a smaller range, whose ends count as listed."""
        inner = (value for value in self.values if low < value < high)
        return KeyRange(self.key, (low, *inner, high))


def only_swept(points: Sequence[Any]) -> KeyRange | None:
    """Give the swept key of a study that has one alone, with numbers; None otherwise."""
    keys = dict.fromkeys(key for point in points for key in point.at)
    if len(keys) != 1:
        return None
    (key,) = keys
    values = [point.at.get(key) for point in points]
    if any(isinstance(value, str) or value is None for value in values):
        return None
    return KeyRange(key, tuple(sorted({float(value) for value in values if value is not None})))


def spread(sweep: KeyRange, number: int, digits: int = 4) -> tuple[float, ...]:
    """Spread settings evenly over the range of a sweep: those that it lists, if there are as many or a few more."""
    if number <= len(sweep.values) <= 2 * number:
        return sweep.values
    low, high = sweep.values[0], sweep.values[-1]
    inner = [rounded(low + (high - low) * k / (number - 1), digits) for k in range(1, number - 1)]
    return (low, *inner, high)


def rounded(value: float, digits: int = 4) -> float:
    """Round a setting to so many digits, as people write it: runs at it are those of a study with that number."""
    return float(f"{value:.{digits}g}")


def of_one_key(goal: str, key: str, points: Sequence[Any]) -> list[Fault]:
    """Check that a study sweeps `key` alone, over a range; the faults are those of the goal."""
    sweep = only_swept(points)
    if sweep is None or sweep.key != key:
        swept = ", ".join(dict.fromkeys(name for point in points for name in point.at)) or "nothing"
        reason = f"the range of {key} is that of `sweep`, and the study sweeps {swept}"
        return [Fault(goal, reason, f"sweep {key} alone, with numbers: its smallest and largest value are the range")]
    if len(sweep.values) < 2:
        return [Fault(goal, f"the sweep has one value of {key}, which is no range", "list two values or more")]
    return []
