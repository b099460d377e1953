"""A campaign: generations of proposals of a strategy, which are stored.

The results on which a generation rests are fixed by number, so that timing has no influence. Generation n is proposed
from the generations before n - ahead; if the strategy then waits, from all before n, once they are complete.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from labbook.campaign.registry import STRATEGIES
from labbook.campaign.strategy import Assignment, Generation, History, Proposal, Strategy, Trial, point_key

Evaluate = Callable[[Generation], tuple[Trial, ...] | None]
"""Function that returns the finished runs of a generation; None while some are missing."""


@dataclass(frozen=True)
class Proposed:
    """All proposals so far.

    Args:
        generations: Generations, the oldest first.
        ended: Reason for the end of the campaign; None while it goes on.
    """

    generations: tuple[Generation, ...] = ()
    ended: str | None = None


Keep = Callable[[int, Proposal], Proposed]
"""Function that stores the proposal of a generation, by number, unless another process has stored one; returns all
stored proposals."""


def with_proposal(stored: Proposed, number: int, proposal: Proposal) -> Proposed:
    """Add the proposal of generation `number` to stored proposals, unless they have one or have ended."""
    if stored.ended is not None or len(stored.generations) > number:
        return stored
    if len(stored.generations) < number:
        raise ValueError(f"generation {number + 1} is proposed, and {len(stored.generations)} are kept")
    if proposal.state == "end":
        return replace(stored, ended=proposal.reason)
    return replace(stored, generations=(*stored.generations, Generation(number, proposal.assignments, proposal.reason)))


class Campaign:
    """Generations that a strategy has proposed so far for a study.

    Attributes:
        generations: All generations, the oldest first; complete ones have `trials`.
        ended: Reason for the end of the campaign; None while it goes on.
    """

    def __init__(self, strategy: Strategy, study: Any, proposed: Proposed | None = None, keep: Keep | None = None):
        """Resume a campaign from its stored proposals.

        Args:
            strategy: The strategy.
            study: The study as its author stated it; see `History.study`.
            proposed: Earlier proposals; None: none.
            keep: Stores further proposals; None: only this object has them.
        """
        self.strategy, self.study, self._keep = strategy, study, keep
        self.generations: list[Generation] = []
        self.ended: str | None = None
        self._take(proposed or Proposed())

    def advance(self, evaluate: Evaluate) -> bool:
        """Evaluate the generations that are complete, and propose all that may be in flight.

        Args:
            evaluate: Returns the runs of a generation once all of them are finished.

        Returns:
            True if there are new assignments.
        """
        before, complete = len(self.generations), self._evaluated(evaluate)
        while self.ended is None and len(self.generations) <= complete + self.strategy.ahead:
            proposal = self._proposal(complete)
            if proposal.state == "wait":
                break
            self._take(self._stored(proposal))
            complete = self._evaluated(evaluate)  # its runs may be there already
        return len(self.generations) > before

    @property
    def assignments(self) -> list[Assignment]:
        """All proposed points, each once, in the order of their first proposals, with the most replicates."""
        points: dict[tuple, Assignment] = {}
        for generation in self.generations:
            for assignment in generation.assignments:
                had = points.get(point_key(assignment.at), assignment)
                points[point_key(assignment.at)] = replace(had, replicates=max(had.replicates, assignment.replicates))
        return list(points.values())

    @property
    def lines(self) -> list[str]:
        """Reasons of the proposals, a line for each generation, and the reason for the end of the campaign."""
        rule = self.strategy.plan_rule(self.study)
        lines = [f"Goal: {rule}"] if rule else []
        lines += [
            f"Generation {generation.number + 1} of {self.strategy.name}: {generation.reason}"
            for generation in self.generations
        ]
        return lines + ([f"{self.strategy.name} has ended: {self.ended}"] if self.ended is not None else [])

    def _stored(self, proposal: Proposal) -> Proposed:
        """Store a proposal, and return all stored proposals."""
        number = len(self.generations)
        if self._keep is not None:
            return self._keep(number, proposal)
        return with_proposal(Proposed(tuple(self.generations), self.ended), number, proposal)

    def _take(self, proposed: Proposed) -> None:
        """Add the stored proposals that are not known here."""
        self.generations += proposed.generations[len(self.generations) :]
        self.ended = proposed.ended

    def _evaluated(self, evaluate: Evaluate) -> int:
        """Evaluate complete generations; return their number before the first incomplete one."""
        for number, generation in enumerate(self.generations):
            if generation.trials is None:
                trials = evaluate(generation)
                if trials is None:
                    return number
                ordered = tuple(sorted(trials, key=lambda trial: trial.key))
                self.generations[number] = replace(generation, trials=ordered)
        return len(self.generations)

    def _proposal(self, complete: int) -> Proposal:
        number = len(self.generations)
        for basis in dict.fromkeys((max(0, number - self.strategy.ahead), number)):
            if basis > complete:
                break
            # whether a run in flight is finished by now depends on timing: its results must not reach the strategy
            pending = tuple(replace(generation, trials=None) for generation in self.generations[basis:])
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
