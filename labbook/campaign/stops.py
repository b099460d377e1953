"""Strategy behind `accuracy.clogging`: replicates of a point until enough of them have stopped."""

import math
from collections.abc import Iterable
from typing import ClassVar

from labbook.campaign.strategy import Assignment, History, Proposal, Strategy, Trial
from labbook.scene.quantities import percent
from labbook.stats.rates import events_needed

COUNT = "clogging_stops"
"""Quantity: stops of a run beyond its transient; absent without a stop, or without grains that count."""


class Stops(Strategy):
    """Strategy that adds replicates to one point until the probability of a stop has a relative error.

    That error is known in advance, from the number of stops alone: stops are a Poisson number, so that k >= (1.96 /
    error)^2 (`labbook.stats.rates.events_needed`). A point whose runs hardly ever stop ends at the cap, with the upper
    bound that its grains set.

    Args:
        error: Half width of the 95 % interval to reach, relative to the probability.
        cap: Largest number of replicates.
    """

    name: ClassVar[str] = "stops"
    ahead: ClassVar[int] = 0

    error: float
    """Half width of the 95 % interval to reach, relative to the probability."""
    cap: int
    """Largest number of replicates."""

    def propose(self, history: History) -> Proposal:
        """Propose more beds of the point, or end with the number of stops.

        Args:
            history: Complete generations of one point; there is at least one run.

        Returns:
            The number of beds in all, at most twice the present one; or the end, with enough stops or at the cap.
        """
        trials = list(history.trials)
        at, beds = trials[0].at, len({trial.seed for trial in trials})
        discharges = max(trial.discharge for trial in trials)
        stops_so_far, needed = stops(trials), events_needed(self.error)
        progress = f"{stops_so_far} of {needed} stops for {percent(self.error)} with {beds} replicates"
        if stops_so_far >= needed:
            return Proposal.end(progress)
        if beds >= self.cap:
            bound = "; without a stop there is an upper bound only" if not stops_so_far else ""
            short = "the requested error of q is not reached, and accuracy.max_replicates allows no more runs"
            return Proposal.end(f"{progress}: {short}{bound}")
        # few stops are too uncertain for a large order
        following = min(self.expected(stops_so_far, beds), 2 * beds, self.cap)
        return Proposal((Assignment(at, following, discharges),), f"{progress}: {following} in all")

    def expected(self, stops_so_far: int, beds: int) -> int:
        """Forecast the number of replicates if further beds stop as often.

        Args:
            stops_so_far: Stops so far.
            beds: Beds so far.

        Returns:
            The number in all, at most the cap.
        """
        if not stops_so_far:
            return self.cap
        return min(self.cap, max(beds + 1, math.ceil(events_needed(self.error) * beds / stops_so_far)))

    def in_words(self, stops_so_far: int, beds: int) -> str:
        """Describe the number of stops in some beds, and the expected number of replicates."""
        needed = events_needed(self.error)
        if not stops_so_far:
            return f"{needed} stops are needed for {percent(self.error)}; the replicates for them are not known yet"
        expected = beds if stops_so_far >= needed else self.expected(stops_so_far, beds)
        short = " (accuracy.max_replicates)" if stops_so_far * expected < needed * beds else ""
        return f"{stops_so_far} of {needed} stops with {beds} replicates; {expected} replicates expected{short}"


def stops(trials: Iterable[Trial]) -> int:
    """Count the stops in all runs."""
    return round(sum(trial.numbers.get(COUNT, 0.0) for trial in trials))
