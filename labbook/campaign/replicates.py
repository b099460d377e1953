"""The strategy behind `accuracy.flow_rate`: replicates of a point until its flow rate is known well enough."""

from typing import ClassVar

from labbook.campaign.strategy import Assignment, History, Proposal, Strategy
from labbook.scene.quantities import percent
from labbook.stats import Decision, StoppingRule

QUANTITY = "flow_rate"
_WRONG = 1.5
"""A forecast of replicates that is off by this factor is reported."""


class Replicates(Strategy):
    """Adds replicates to one point by the stopping rule of `labbook.stats.stopping`.

    It waits for all runs so far, since replicates that end first may flow fast: no fair sample.
    """

    name: ClassVar[str] = "replicates"
    ahead: ClassVar[int] = 0

    rule: StoppingRule
    """When to stop, and how many to add."""
    scatter: float | None = None
    """Standard deviation between runs, relative to the mean, by which their number was foreseen."""

    def propose(self, history: History) -> Proposal:
        """Propose more seeds of the point of `history`, or end with the precision that was reached."""
        trials = list(history.trials)
        values = [value for _, seeds in history.values(QUANTITY) for value in seeds]
        decision = self.rule.decide(values, len(trials) - len(values))
        if decision.more:
            pooled = decision.pooled
            known = "no flow rate yet" if pooled is None else f"W to {percent(pooled.relative, '.2f')}"
            reason = f"{known} with {len(trials)} replicates: {decision.more} more"
            return Proposal((Assignment(trials[0].at, len(trials) + decision.more),), reason, decision=decision)
        return Proposal((), self._reason(decision, len(trials)), "end", decision)

    def _reason(self, decision: Decision, runs: int) -> str:
        if decision.ended is None:
            return ""
        if decision.pooled is None:
            return f"none of {runs} runs has a flow rate, so no more are made: labbook report tells why"
        short = ": the requested error is not reached, and accuracy.max_replicates allows no more runs"
        short = "" if decision.ended == "tolerance" else short
        known = percent(decision.pooled.relative, ".2f")
        return f"flow rate to {known} with {decision.pooled.n} replicates{self._foreseen(decision.pooled.n)}{short}"

    def _foreseen(self, needed: int) -> str:
        """Report a forecast that was wrong."""
        if self.scatter is None:
            return ""
        foreseen = self.rule.forecast(self.scatter)
        wrong = max(needed, foreseen) > _WRONG * min(needed, foreseen)
        return f" ({foreseen} were expected, from a scatter of {percent(self.scatter, '.2f')})" if wrong else ""
