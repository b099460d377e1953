"""Strategies: from the results so far, the runs to make next, and the reason in a sentence.

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
"""End of the names of numbers that rates are over, such as the grains that left of a probability of a stop."""
Values = Mapping[str, float | str]
"""Dotted keys of a study, with values in SI; the word itself for keys that take words."""


def place(values: Values) -> tuple[tuple[str, float | str], ...]:
    """Identify a point by its values, with numbers to as many digits as a sweep has: a value that was computed in two
    ways is one point."""
    rounded = {key: value if isinstance(value, str) else float(f"{value:.{DIGITS}g}") for key, value in values.items()}
    return tuple(sorted(rounded.items()))


@dataclass(frozen=True)
class Assignment:
    """Runs of one point: the values of its keys, how many replicates it shall have in all (beds, with seeds 1, 2, 3
    ...), and how many discharges each of these; strategies of studies leave that to `discharges_per_bed`."""

    at: Values
    replicates: int = 1
    discharges: int = 1


@dataclass(frozen=True)
class Proposal:
    """The assignments of a generation, and the reason for them in a sentence.

    `state`: `go` with assignments; `wait` for the generations in flight to be complete, after which the strategy is
    asked again; `end` of the campaign, whose reason says why. `decision`: the statistics of replicates on which it
    rests.
    """

    assignments: tuple[Assignment, ...]
    reason: str
    state: Literal["go", "wait", "end"] = "go"
    decision: Decision | None = None

    @classmethod
    def wait(cls) -> "Proposal":
        """Nothing before the generations in flight are complete."""
        return cls((), "", "wait")

    @classmethod
    def end(cls, reason: str) -> "Proposal":
        """Nothing more."""
        return cls((), reason, "end")


@dataclass(frozen=True)
class Trial:
    """A finished run as strategies see it.

    `at`: values of the swept keys [SI]; `key`: of the run; `numbers`: its finite numbers by name of their quantity
    [SI], and of rates what they are over (EXPOSURE); none of a run that diverged or is suspect: `outcome` says how it
    ended; `seed`: of its bed, of which it is the first, second ... `discharge`.
    """

    at: Values
    seed: int
    key: str
    outcome: str
    numbers: Mapping[str, float] = field(default_factory=dict)
    discharge: int = 1


@dataclass(frozen=True)
class Generation:
    """Assignments that were proposed together. `trials`: its runs by key; None until all are finished."""

    number: int
    assignments: tuple[Assignment, ...]
    reason: str
    trials: tuple[Trial, ...] | None = None


@dataclass(frozen=True)
class History:
    """All that a strategy may rest a proposal on.

    `study`: as its author stated it (`labbook.Study`), whose points are the range of its sweep; `generations`: those
    complete; `pending`: those in flight, whose results are not known; `number`: of the generation to be proposed.
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
        """The numbers of one quantity at each point.

        Args:
            quantity: its name, such as `flow_rate` [kg/s].

        Returns:
            Each point's values of the swept keys, with the numbers of its beds in the order of their seeds, of several
            discharges of a bed their mean; a point none of whose runs has a number has an empty list. Points are in the
            order in which they were proposed.
        """
        return [(at, of_beds(beds)) for at, beds in self.beds(quantity)]

    def beds(self, quantity: str) -> list[tuple[Values, Beds]]:
        """The numbers of one quantity at each point, by bed: as `values`, with those of all its discharges."""
        places: dict[tuple, tuple[Values, dict[tuple[int, int], float]]] = {}
        for trial in self.trials:
            _, repeats = places.setdefault(place(trial.at), (trial.at, {}))
            value = trial.numbers.get(quantity, math.nan)
            if math.isfinite(value):
                repeats[trial.seed, trial.discharge] = value
        return [(at, by_bed((seed, value) for (seed, _), value in sorted(of.items()))) for at, of in places.values()]

    def pooled(self, quantity: str) -> list[tuple[Values, Pooled]]:
        """The mean of one quantity at each point that has numbers, with its 95 % interval (Student's t)."""
        return [(at, pool(numbers)) for at, numbers in self.values(quantity) if numbers]


class Strategy(Model, ABC):
    """Proposes the runs of a campaign from the results so far.

    A proposal may depend on the study and on the history alone, never on time, chance or the machine: a campaign that
    was killed asks again and has to be answered the same.
    """

    name: ClassVar[str]
    """As studies name it under `adapt`."""
    version: ClassVar[int] = 1
    """Raised when its proposals change: campaigns that were begun by an older version begin anew, and finished runs are
    not repeated."""
    ahead: ClassVar[int] = 1
    """Generations in flight beside the oldest that is not complete: with 1 a device has work meanwhile. A strategy that
    needs the results of all answers `Proposal.wait`."""

    @abstractmethod
    def propose(self, history: History) -> Proposal:
        """Propose the generation `history.number`.

        Args:
            history: the complete generations with their runs, and those in flight.

        Returns:
            Assignments with their reason; or `Proposal.wait()` until what is in flight is complete; or
            `Proposal.end(reason)`.
        """

    def obstacles(self, measures: Sequence[str], points: Sequence[Any]) -> Iterable[Fault]:
        """Find what a study lacks for this strategy.

        Args:
            measures: Names of the measures that the study takes.
            points: Its points (`labbook.study.Point`).

        Returns:
            Faults by keys below `adapt`, which end the reading of the study.
        """
        return ()

    def plan_rule(self, study: Any) -> str:
        """Say in a sentence when the campaign ends, and how many runs are expected; empty for nothing to say."""
        return ""
