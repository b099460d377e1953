"""Whether a run that exists covers what is asked: how far it went, and what it observed."""

from dataclasses import dataclass
from typing import Literal

from labbook.catalogue.record import Coverage, StopRule

Gap = Literal["none", "shorter", "unobserved"]


@dataclass(frozen=True)
class Shortfall:
    """What a run lacks: nothing (`none`), time (`shorter`: it can go on), or an observable (`unobserved`: run
    again)."""

    gap: Gap
    reason: str = ""


NOTHING = Shortfall("none")


def shortfall(
    outcome: str, had: Coverage, stop: StopRule, guards: dict[str, float], probes: frozenset[str]
) -> Shortfall:
    """What a run that ended as `outcome` with coverage `had` lacks of `stop` and `probes`, with the reason in
    words."""
    missing = sorted(probes - set(had.probes))
    if missing:
        return Shortfall("unobserved", f"not observed: {', '.join(missing)}")
    if outcome == "emptied" or had.discharged >= stop.discharged:
        return NOTHING
    if outcome == "diverged":
        changed = [name for name, value in guards.items() if had.guards.get(name) != value]
        return Shortfall("shorter", f"diverged under another {' and '.join(changed)}") if changed else NOTHING
    if had.waiting >= stop.stall:
        return NOTHING
    if had.duration >= stop.max_time * (1 - 1e-12):
        return NOTHING
    return Shortfall(
        "shorter",
        f"{outcome} after {had.duration:.4g} s with {had.discharged:.1%} discharged; "
        f"asked: {stop.discharged:.1%}, {stop.max_time:.4g} s, stall {stop.stall:.4g} s",
    )
