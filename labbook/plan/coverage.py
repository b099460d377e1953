"""Whether a run that exists covers what is asked: how far it went, and what it observed."""

from collections.abc import Mapping
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
    outcome: str,
    had: Coverage,
    stop: StopRule,
    guards: Mapping[str, float],
    probes: frozenset[str],
    recording: float | None = None,
) -> Shortfall:
    """What a run that ended as `outcome` with coverage `had` lacks of what is asked, with the reason in
    words.

    `recording`: time between frames [s] if the run is to be recorded; a finer recording will do.
    """
    missing = sorted(probes - set(had.probes))
    if missing:
        return Shortfall("unobserved", f"not observed: {', '.join(missing)}")
    if recording is not None and (had.recording is None or had.recording > recording * (1 + 1e-9)):
        what = "not recorded" if had.recording is None else f"recorded only every {had.recording:.3g} s"
        return Shortfall("unobserved", what)
    if outcome == "emptied" or had.discharged >= stop.discharged:
        return NOTHING
    if stop.fill_height is not None and had.fill_height is not None and had.fill_height <= stop.fill_height:
        return NOTHING
    if outcome == "diverged":
        changed = [name for name, value in guards.items() if had.guards.get(name) != value]
        return Shortfall("shorter", f"diverged under another {' and '.join(changed)}") if changed else NOTHING
    if had.waiting >= stop.stall:
        return NOTHING
    if had.duration >= stop.max_time * (1 - 1e-12):
        return NOTHING
    ended = "out of time" if outcome in ("time-limit", "interrupted") else outcome  # the latter in older indexes
    return Shortfall(
        "shorter",
        f"{ended} after {had.duration:.4g} s with {had.discharged:.1%} discharged; "
        f"asked: {stop.discharged:.1%}, {stop.max_time:.4g} s, stall {stop.stall:.4g} s",
    )
