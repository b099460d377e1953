"""Strategies: from the results so far, the next runs, and the reason in a sentence.

A package adds one by the entry-point group `labbook.strategies`; a study names it under `adapt`:

    adapt: {bisect: {flow_rate: 50 g/s, within: 1 %}}

The fields of a strategy are its keys in the study, with units as everywhere.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

from labbook.scene.model import Fault, Model
from labbook.scene.quantities import DIGITS
from labbook.stats import Decision, Pooled, pool
from labbook.stats.nested import Beds, by_bed, of_beds

EXPOSURE = ".exposure"
"""Suffix of the names of exposures of rates, such as the grains that left for the probability of a stop."""
Values = Mapping[str, float | str]
"""Dotted keys of a study, with values in SI; text for keys that take words."""


def point_key(values: Values) -> tuple[tuple[str, float | str], ...]:
    """Identify a point by its values, with numbers rounded to the digits of a sweep.

    A value that was computed in two ways is then one point.
    """
    rounded = {key: value if isinstance(value, str) else float(f"{value:.{DIGITS}g}") for key, value in values.items()}
    return tuple(sorted(rounded.items()))


@dataclass(frozen=True)
class Assignment:
    """Runs of one point.

    Args:
        at: Values of its keys.
        replicates: Number of replicates that it shall have in all: beds, with seeds 1, 2, 3 ...
        discharges: Number of discharges of each bed; strategies of studies leave it to `discharges_per_bed`.
    """

    at: Values
    replicates: int = 1
    discharges: int = 1


@dataclass(frozen=True)
class Proposal:
    """Assignments of a generation, and the reason for them in a sentence.

    Args:
        assignments: The assignments.
        reason: The reason.
        state: `go` with assignments; `wait` until the generations in flight are complete; `end` of the campaign, for
            the reason given.
        decision: Statistics of replicates on which it rests; None for most strategies.
    """

    assignments: tuple[Assignment, ...]
    reason: str
    state: Literal["go", "wait", "end"] = "go"
    decision: Decision | None = None

    @classmethod
    def wait(cls) -> "Proposal":
        """Return a proposal that waits for the generations in flight."""
        return cls((), "", "wait")

    @classmethod
    def end(cls, reason: str) -> "Proposal":
        """Return a proposal that ends the campaign."""
        return cls((), reason, "end")


@dataclass(frozen=True)
class Trial:
    """A finished run, as strategies see it.

    Args:
        at: Values of the swept keys [SI].
        seed: Seed of its bed.
        key: Key of the run.
        outcome: Outcome of the run, such as `clogged` or `diverged`.
        numbers: Finite numbers by name of their quantity [SI], with the exposures of rates (EXPOSURE). Empty for a run
            that diverged or is suspect.
        discharge: Number of the discharge of its bed, from 1.
        device_time: Device time [s] of the run and of its filling, by their keys, as several runs may have one filling.
            None where a record of an older version has none. It depends on the machine: use it to end a campaign, never
            to choose a point.
    """

    at: Values
    seed: int
    key: str
    outcome: str
    numbers: Mapping[str, float] = field(default_factory=dict)
    discharge: int = 1
    device_time: Mapping[str, float | None] = field(default_factory=dict)


@dataclass(frozen=True)
class Generation:
    """Assignments of one proposal.

    Args:
        number: Number of the generation, from 0.
        assignments: Assignments of the proposal.
        reason: Its reason.
        trials: Its runs in the order of their keys; None until all are finished.
    """

    number: int
    assignments: tuple[Assignment, ...]
    reason: str
    trials: tuple[Trial, ...] | None = None


@dataclass(frozen=True)
class History:
    """Everything on which a strategy may base a proposal.

    Args:
        study: The study as its author stated it (`labbook.Study`); its points are the range of the sweep.
        generations: Complete generations.
        pending: Generations in flight, without results.
        number: Number of the generation to be proposed.
    """

    study: Any
    generations: tuple[Generation, ...] = ()
    pending: tuple[Generation, ...] = ()
    number: int = 0

    @property
    def trials(self) -> Iterator[Trial]:
        """All finished runs, by generation and key."""
        return (trial for generation in self.generations for trial in generation.trials or ())

    def values(self, quantity: str) -> list[tuple[Values, list[float]]]:
        """Collect the numbers of one quantity at each point.

        Args:
            quantity: Name of the quantity, such as `flow_rate` [kg/s].

        Returns:
            The values of the swept keys of each point, with the numbers of its beds in the order of their seeds; for
            several discharges of a bed their mean. The list is empty if no run of a point has a number. Points are in
            the order of their first proposals.
        """
        return [(at, of_beds(beds)) for at, beds in self.beds(quantity)]

    def beds(self, quantity: str) -> list[tuple[Values, Beds]]:
        """Collect the numbers of one quantity at each point, by bed, with those of all its discharges."""
        beds_by_point: dict[tuple, tuple[Values, dict[tuple[int, int], float]]] = {}
        for trial in self.trials:
            _, repeats = beds_by_point.setdefault(point_key(trial.at), (trial.at, {}))
            value = trial.numbers.get(quantity, math.nan)
            if math.isfinite(value):
                repeats[trial.seed, trial.discharge] = value
        return [
            (at, by_bed((seed, value) for (seed, _), value in sorted(of.items()))) for at, of in beds_by_point.values()
        ]

    def pooled(self, quantity: str) -> list[tuple[Values, Pooled]]:
        """Pool one quantity at each point that has numbers: mean with 95 % interval (Student's t)."""
        return [(at, pool(numbers)) for at, numbers in self.values(quantity) if numbers]


class Strategy(Model, ABC):
    """Base class of strategies, which propose the runs of a campaign from the results so far.

    A proposal may depend on the study and on the history alone, never on time, chance or the machine: a campaign that
    was killed asks again and has to get the same answer. Fields are the keys of the strategy in a study.

    Attributes:
        name: Name under `adapt` in studies.
        version: Version; raise it when proposals change. Campaigns of an older version then start again; finished runs
            are not repeated.
        ahead: Generations in flight beside the oldest incomplete one; with 1 a device has work meanwhile. A strategy
            that needs the results of all answers `Proposal.wait`.
    """

    name: ClassVar[str]
    version: ClassVar[int] = 1
    ahead: ClassVar[int] = 1

    @abstractmethod
    def propose(self, history: History) -> Proposal:
        """Propose the generation `history.number`.

        Args:
            history: The complete generations with their runs, and those in flight.

        Returns:
            Assignments with their reason; `Proposal.wait()` until the generations in flight are complete; or
            `Proposal.end(reason)`.
        """

    def obstacles(self, measures: Sequence[str], points: Sequence[Any]) -> Iterable[Fault]:
        """List faults of a study that prevent this strategy.

        Args:
            measures: Names of the measures that the study takes.
            points: Points of the study (`labbook.study.Point`).

        Returns:
            Faults by keys below `adapt`, which end the reading of the study.
        """
        return ()

    def plan_rule(self, study: Any) -> str:
        """State in a sentence when the campaign ends, and the expected number of runs; empty if there is no rule."""
        return ""
