"""Strategy behind `accuracy.flow_rate`: replicates of a point until its flow rate is known well enough."""

import math
from typing import ClassVar

from labbook.campaign.strategy import Assignment, History, Proposal, Strategy
from labbook.scene.quantities import percent
from labbook.stats import Decision, StoppingRule
from labbook.stats.nested import TYPICAL, Beds, Design, Shares, cheapest, of_beds, shares

QUANTITY = "flow_rate"
_WRONG = 1.5
"""Factor by which a forecast of replicates has to be wrong to be reported."""


class Replicates(Strategy):
    """Strategy that adds replicates to one point by the stopping rule of `labbook.stats.stopping`.

    Replicates are beds, and all have as many discharges. Where `filling` is known, their number is the cheapest one: it
    only rises, by further discharges of the beds that there are.

    It waits for all runs so far, since replicates that end first may be biased towards fast flow.

    Args:
        rule: Stopping rule, which also gives the number of replicates to add.
        scatter: Standard deviation between runs, relative to the mean, on which the forecast was based; None without a
            forecast.
        filling: Cost of a filling, in discharges; None if the number of discharges of each bed is stated.
    """

    name: ClassVar[str] = "replicates"
    ahead: ClassVar[int] = 0

    rule: StoppingRule
    """Stopping rule, which also gives the number of replicates to add."""
    scatter: float | None = None
    """Standard deviation between runs, relative to the mean, on which the forecast was based."""
    filling: float | None = None
    """Cost of a filling, in discharges; None if the number of discharges of each bed is stated."""

    def propose(self, history: History) -> Proposal:
        """Propose more beds or discharges of the point, or end with the precision reached.

        Args:
            history: Complete generations of one point, with W [kg/s] of each run that has one.

        Returns:
            The numbers of beds and discharges in all; or the end, if the rule stops or allows no more runs.
        """
        ((at, beds),) = history.beds(QUANTITY)
        trials = list(history.trials)
        there = Design(len({trial.seed for trial in trials}), max(trial.discharge for trial in trials))
        decision = self.rule.decide(of_beds(beds), there.beds - len(beds))
        design, pooled = self._design(decision, beds, there), decision.pooled
        if design != there:
            precision = "no flow rate yet" if pooled is None else f"W to {percent(pooled.relative, '.2f')}"
            reason = (
                f"{precision} with {_design_text(there)}: {_design_text(design)} in all{self._in_words(decision, beds)}"
            )
            return Proposal((Assignment(at, design.beds, design.discharges),), reason, decision=decision)
        return Proposal((), self._reason(decision, beds, there), "end", decision)

    def _design(self, decision: Decision, beds: Beds, there: Design) -> Design:
        """Choose beds and discharges for the next look; at the end the present ones."""
        extended = Design(there.beds + decision.additional, there.discharges)
        if self.filling is None or decision.pooled is None or decision.ended not in (None, "cap"):
            return extended
        pooled, of, n = decision.pooled, shares(beds), len(beds)
        design, reached = cheapest(self.rule, pooled.value, of, self.filling, Design(n, there.discharges))
        if design.discharges == there.discharges or n < self.rule.first:
            return extended
        if decision.ended == "cap" and not (reached and design.beds == n):
            return there
        number = there.discharges + 1  # not more at a time: shares known from few beds may be wrong
        narrower = math.sqrt(of.of_means(number) / of.of_means(there.discharges))
        added = min(self.rule.following(n, narrower * pooled.relative), self.rule.cap - there.beds)
        return Design(there.beds + added, number)

    def _reason(self, decision: Decision, beds: Beds, there: Design) -> str:
        if decision.ended is None:
            return ""
        if decision.pooled is None:
            runs = there.beds * there.discharges
            return f"none of {runs} runs has a flow rate, so no more are made: labbook report tells why"
        short = ": the requested error is not reached, and accuracy.max_replicates allows no more runs"
        short = "" if decision.ended == "tolerance" else short
        precision, n = percent(decision.pooled.relative, ".2f"), decision.pooled.n
        why = self._in_words(decision, beds)
        with_these = _design_text(Design(n, there.discharges))
        return f"flow rate to {precision} with {with_these}{self._forecast_error(n, there)}{short}{why}"

    def _in_words(self, decision: Decision, beds: Beds) -> str:
        if self.filling is None or decision.pooled is None or len(beds) < 2:
            return ""
        return f"; {in_words(self.rule, decision.pooled.value, shares(beds), self.filling)}"

    def _forecast_error(self, needed: int, there: Design) -> str:
        """Report a wrong forecast; empty if it was right."""
        if self.scatter is None:
            return ""
        predicted = self.rule.forecast(scatter_of_beds(self.scatter, there.discharges))
        wrong = max(needed, predicted) > _WRONG * min(needed, predicted)
        return f" ({predicted} were expected, from a scatter of {percent(self.scatter, '.2f')})" if wrong else ""


def scatter_of_beds(scatter: float, discharges: int) -> float:
    """Standard deviation between means over some discharges of a bed, with the shares of other scenes.

    `scatter`: standard deviation of single runs.
    """
    return scatter * TYPICAL.of_means(discharges) ** 0.5


def in_words(rule: StoppingRule, mean: float, of: Shares, filling: float) -> str:
    """Describe both shares of the variance of W, and the cheapest number of discharges with its basis."""
    flow, bed = (percent(fraction, ".0f") for fraction in (of.flow, of.bed))
    where = f"{flow} of the variance of W is made in the flow, {bed} in the bed"
    where += "" if of.measured else " (as in other scenes)"
    number = cheapest(rule, mean, of, filling)[0].discharges
    cheap = f"{number} discharge{' a bed is' if number == 1 else 's a bed are'} cheapest"
    return f"{where}; {cheap}, as a filling takes {float(f'{filling:.2g}'):g} times a discharge"


def _design_text(design: Design) -> str:
    """Write a design as `7 replicates` or `7 replicates of 3 discharges`."""
    beds = f"{design.beds} replicate{'' if design.beds == 1 else 's'}"
    return beds if design.discharges == 1 else f"{beds} of {design.discharges} discharges"
