"""Strategy behind fed beds: one run continues until its own flow rate is known well enough."""

from typing import ClassVar

from labbook.campaign.strategy import Assignment, History, Proposal, Strategy
from labbook.scene.quantities import percent
from labbook.stats.tolerance import Tolerance

HALF_WIDTH = "flow_rate.half_width"
"""Quantity: half width of the 95 % interval of the flow rate from one run alone, relative to it; absent while the flow
has a trend."""


class PreciseRun(Strategy):
    """Strategy that lets one run of a fed bed continue from look to look.

    Each look is one trial of the run so far; looks are few (`labbook.stats.stopping.looks`), since each is a chance to
    stop on an error that came out small by accident.

    Args:
        error: Half width to reach, relative to the flow rate: the requested error less the bias of numerics.
    """

    name: ClassVar[str] = "precise"
    ahead: ClassVar[int] = 0

    error: float
    """Half width to reach, relative to the flow rate: the requested error less the bias of numerics."""

    def propose(self, history: History) -> Proposal:
        """Propose that the run of the latest trial continues, or end the campaign.

        Args:
            history: One generation for each look so far, each with one trial; there is at least one.

        Returns:
            The point of the run again; or the end, once the half width of its interval is small enough.
        """
        latest = list(history.trials)[-1]
        half_width = latest.numbers.get(HALF_WIDTH)
        if half_width is None:
            return Proposal((Assignment(latest.at),), "the flow has a trend, or too few grains have left")
        precision = f"W to {percent(half_width, '.2f')}, and {percent(self.error)} is asked"
        if Tolerance(self.error).met(half_width):
            return Proposal.end(precision)
        return Proposal((Assignment(latest.at),), precision)
