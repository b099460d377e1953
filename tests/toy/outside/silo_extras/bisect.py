"""A strategy: bisects the range of the sweep for the outlet that gives a flow rate."""

from typing import Annotated, ClassVar

from labbook.campaign import Assignment, History, Proposal, Strategy
from labbook.scene.quantities import quantity

ORIFICE = "container.orifice"
FlowRate = Annotated[float, *quantity("kg/s")]


class Bisect(Strategy):
    """Halves the range of outlets until it is within a part of its middle."""

    name: ClassVar[str] = "bisect"

    flow_rate: FlowRate
    """Flow rate that the outlet shall give."""
    within: float = 0.05
    """Width of the last range over its middle."""
    replicates: int = 2
    """Runs at each outlet."""

    def propose(self, history: History) -> Proposal:
        """Propose both ends of the range first, and then its middle until it is narrow enough."""
        stated = [float(point.at[ORIFICE]) for point in history.study.points]
        low, high = min(stated), max(stated)
        if history.number == 0:
            ends = tuple(Assignment({ORIFICE: end}, self.replicates) for end in (low, high))
            return Proposal(ends, f"the ends of the range, {1e3 * low:.4g} and {1e3 * high:.4g} mm")
        if history.pending:
            return Proposal.wait()
        for at, mean in history.pooled("flow_rate"):
            orifice = float(at[ORIFICE])
            if mean.value < self.flow_rate:
                low = max(low, orifice)
            else:
                high = min(high, orifice)
        middle = (low + high) / 2
        if high - low <= self.within * middle:
            return Proposal.end(f"the outlet lies between {1e3 * low:.4g} and {1e3 * high:.4g} mm")
        reason = f"it lies between {1e3 * low:.4g} and {1e3 * high:.4g} mm, whose middle is next"
        return Proposal((Assignment({ORIFICE: middle}, self.replicates),), reason)
