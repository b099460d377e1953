"""One campaign: a strategy is asked for generation after generation, and what it proposed is kept.

Which generation rests on which results is fixed by their numbers, so that timing never enters: generation n is proposed
from the generations before n - ahead; if the strategy then waits, from all before n, once they are complete.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from labbook.campaign.registry import STRATEGIES
from labbook.campaign.strategy import Assignment, Generation, History, Proposal, Strategy, Trial, place

Evaluate = Callable[[Generation], tuple[Trial, ...] | None]
"""Gives the finished runs of a generation; None as long as some are missing."""


@dataclass(frozen=True)
class Proposed:
    """All that was proposed so far, oldest first, and why the strategy ended the campaign (None while it goes on)."""

    generations: tuple[Generation, ...] = ()
    ended: str | None = None


Keep = Callable[[int, Proposal], Proposed]
"""Keeps the proposal of a generation, by its number, unless another process has kept one; gives all that is kept."""


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

    def __init__(self, strategy: Strategy, study: Any, proposed: Proposed | None = None, keep: Keep | None = None):
        """Take up a campaign as far as it has come.

        Args:
            strategy: Proposes.
            study: As its author stated it; see `History.study`.
            proposed: All that was proposed before; None: nothing.
            keep: Keeps what is proposed from here on; None: this object alone does.
        """
        self.strategy, self.study, self._keep = strategy, study, keep
        self.generations: list[Generation] = []
        self.ended: str | None = None
        self._take(proposed or Proposed())

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
            self._take(self._stored(proposal))
            complete = self._evaluated(evaluate)  # its runs may be there already
        return len(self.generations) > before

    @property
    def assignments(self) -> list[Assignment]:
        """Every point that was proposed so far, once, in the order of the first proposals, with the most replicates."""
        points: dict[tuple, Assignment] = {}
        for generation in self.generations:
            for assignment in generation.assignments:
                had = points.get(place(assignment.at), assignment)
                points[place(assignment.at)] = replace(had, replicates=max(had.replicates, assignment.replicates))
        return list(points.values())

    @property
    def lines(self) -> list[str]:
        """What was proposed and why, a line for each generation, and why the campaign ended."""
        rule = self.strategy.plan_rule(self.study)
        lines = [f"Goal: {rule}"] if rule else []
        lines += [f"Generation {one.number + 1} of {self.strategy.name}: {one.reason}" for one in self.generations]
        return lines + ([f"{self.strategy.name} has ended: {self.ended}"] if self.ended is not None else [])

    def _stored(self, proposal: Proposal) -> Proposed:
        """Keep a proposal, and give all that is kept then."""
        number = len(self.generations)
        if self._keep is not None:
            return self._keep(number, proposal)
        return with_proposal(Proposed(tuple(self.generations), self.ended), number, proposal)

    def _take(self, proposed: Proposed) -> None:
        """Take up what the store has beyond what is known here."""
        self.generations += proposed.generations[len(self.generations) :]
        self.ended = proposed.ended

    def _evaluated(self, evaluate: Evaluate) -> int:
        """Take in the runs of complete generations; how many are complete before the first that is not."""
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
