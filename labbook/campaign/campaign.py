"""One campaign: a strategy is asked for generation after generation, and what it proposed is kept.

Which generation rests on which results is fixed by their numbers, so that timing never enters: generation n is proposed
from the generations before n - ahead; if the strategy then waits, from all before n, once they are complete.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

from labbook.campaign.strategy import STRATEGIES, Assignment, Generation, History, Proposal, Strategy, Trial

Evaluate = Callable[[Generation], tuple[Trial, ...] | None]
"""Gives the finished runs of a generation; None as long as some are missing."""


@dataclass(frozen=True)
class Proposed:
    """All that was proposed so far, oldest first, and why the strategy ended the campaign (None while it goes on)."""

    generations: tuple[Generation, ...] = ()
    ended: str | None = None


class Store(Protocol):
    """Keeps proposals, so that a campaign that was killed, or that several processes share, has one course."""

    def read(self) -> Proposed:
        """Give all that is kept."""
        ...

    def keep(self, number: int, proposal: Proposal) -> Proposed:
        """Keep a proposal of generation `number` unless another process has kept one; give all that is kept then."""
        ...


class _Memory:
    """Keeps proposals in this process only."""

    def __init__(self):
        self._kept = Proposed()

    def read(self) -> Proposed:
        return self._kept

    def keep(self, number: int, proposal: Proposal) -> Proposed:
        self._kept = with_proposal(self._kept, number, proposal)
        return self._kept


def with_proposal(kept: Proposed, number: int, proposal: Proposal) -> Proposed:
    """Add the proposal of generation `number` to what is kept, unless that has one or has ended."""
    if kept.ended is not None or len(kept.generations) > number:
        return kept
    if len(kept.generations) < number:
        raise ValueError(f"generation {number + 1} is proposed, and {len(kept.generations)} are kept")
    if proposal.state == "end":
        return replace(kept, ended=proposal.reason)
    return replace(kept, generations=(*kept.generations, Generation(number, proposal.assignments, proposal.reason)))


class Campaign:
    """The generations that a strategy has proposed so far for a study.

    Attributes:
        generations: All that were proposed, oldest first; those complete have `trials`.
        ended: Why the strategy ended the campaign; None while it goes on.
    """

    def __init__(self, strategy: Strategy, study: Any = None, store: Store | None = None):
        """Take up a campaign where its store has it.

        Args:
            strategy: Proposes.
            study: As its author stated it; see `History.study`.
            store: Keeps what is proposed; None: this object alone.
        """
        self.strategy, self.study = strategy, study
        self._store: Store = store or _Memory()
        self.generations: list[Generation] = []
        self.ended: str | None = None
        self._take(self._store.read())

    def advance(self, evaluate: Evaluate) -> bool:
        """Evaluate the generations that are complete by now, and propose all that may be in flight.

        Args:
            evaluate: Gives the runs of a generation once all of them are finished.

        Returns:
            Whether there are new assignments.
        """
        before, complete = len(self.generations), self._evaluated(evaluate)
        while self.ended is None and len(self.generations) <= complete + self.strategy.ahead:
            proposal = self._proposal(complete)
            if proposal.state == "wait":
                break
            self._take(self._store.keep(len(self.generations), proposal))
            complete = self._evaluated(evaluate)  # its runs may be there already
        return len(self.generations) > before

    @property
    def assignments(self) -> list[Assignment]:
        """Every point that was proposed so far, once, in the order of the first proposals, with the most replicates."""
        points: dict[tuple, Assignment] = {}
        for generation in self.generations:
            for assignment in generation.assignments:
                place = tuple(sorted(assignment.at.items()))
                had = points.get(place, assignment)
                points[place] = replace(had, replicates=max(had.replicates, assignment.replicates))
        return list(points.values())

    @property
    def lines(self) -> list[str]:
        """What was proposed and why, a line for each generation, and why the campaign ended."""
        lines = [f"Generation {one.number + 1} of {self.strategy.name}: {one.reason}" for one in self.generations]
        return lines + ([f"{self.strategy.name} has ended: {self.ended}"] if self.ended is not None else [])

    def _take(self, proposed: Proposed) -> None:
        """Take up what the store has beyond what is known here."""
        self.generations += proposed.generations[len(self.generations) :]
        self.ended = proposed.ended

    def _evaluated(self, evaluate: Evaluate) -> int:
        """Take in the runs of complete generations; how many are complete before the first that is not."""
        for place, generation in enumerate(self.generations):
            if generation.trials is None:
                trials = evaluate(generation)
                if trials is None:
                    return place
                ordered = tuple(sorted(trials, key=lambda trial: trial.key))
                self.generations[place] = replace(generation, trials=ordered)
        return len(self.generations)

    def _proposal(self, complete: int) -> Proposal:
        number = len(self.generations)
        for basis in dict.fromkeys((max(0, number - self.strategy.ahead), number)):
            if basis > complete:
                break
            # what is in flight may be complete by now, which is a matter of time: it is shown without its results
            pending = tuple(replace(one, trials=None) for one in self.generations[basis:])
            history = History(self.study, tuple(self.generations[:basis]), pending, number)
            with STRATEGIES.calling(self.strategy.name):
                proposal = self.strategy.propose(history)
            if proposal.state == "wait" and not pending:
                reason = f"the strategy {self.strategy.name} waits, and no run of it is in flight"
                raise ValueError(f"{reason}; let it propose assignments or end")
            if proposal.state == "go" and not proposal.assignments:
                raise ValueError(f"the strategy {self.strategy.name} proposes no assignments; let it wait or end")
            if proposal.state != "wait":
                return proposal
        return Proposal.wait()
