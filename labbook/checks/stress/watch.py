"""Course of one member, beat by beat: every value has to be finite, and a guard must keep the last good state."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from labbook.backend import Emptied, Ensemble, Event, Failed, Member, Overflow, Status
from labbook.backend.probes import Ledger, Probe
from labbook.checks.stress.case import Broken, Ending
from labbook.checks.verify.platform import MemberStart, Platform, Trajectory
from labbook.scene.packing import Packing

GUARDS = ("state", "speed", "overlap")


@dataclass(frozen=True, eq=False)
class RunOutcome:
    """Trajectory of a member, with the named error that ended it, if one did.

    Args:
        trajectory: The trajectory; None if it never began.
        guard: `state`, `speed` or `overlap`, or `room` for lists that are too short; empty if nothing ended it.
        message: Message of the error.
    """

    trajectory: Trajectory | None
    guard: str = ""
    message: str = ""


def follow(
    platform: Platform, start: MemberStart, beats: int, steps_per_beat: int = 1000, probes: Sequence[Probe] = ()
) -> RunOutcome:
    """Follow one member for `beats` beats, or until an error is reported. A Ledger is always read.

    Args:
        stand: The platform.
        start: Start of the member.
        beats: Largest number of beats.
        steps_per_beat: Steps of a beat.
        probes: Probes to read.

    Raises:
        Broken: A state or a row is not finite, the member does not advance, or the state after an error is not that of
            the beat before.
    """
    all_probes = (*probes, *([] if any(isinstance(p, Ledger) for p in probes) else [Ledger()]))
    with platform.admitted([start], steps_per_beat, all_probes) as admitted:
        ensemble, (member,) = admitted.ensemble, admitted.members
        try:
            good, status = _state(ensemble, member)
        except Overflow as error:  # before anything ran: the start is the last good state
            return RunOutcome(None, "room", str(error))
        events: list[Event] = []
        guard = message = ""
        for _ in range(beats):
            try:
                new = ensemble.advance(1)
            except Overflow as error:
                guard, message = "room", str(error)
                _check_state_kept(ensemble, member, good, status)
                break
            events += new
            if failed := next((event for event in new if isinstance(event, Failed)), None):
                guard, message = failed.guard, failed.message
                _check_message(failed, status, steps_per_beat)
                _check_state_kept(ensemble, member, good, status)
                if ensemble.advance(1):
                    raise Broken("a member runs on after a guard stopped it")
                break
            if any(isinstance(event, Emptied) for event in new):
                break
            before = status.step
            good, status = _state(ensemble, member)
            if status.step != before + steps_per_beat:
                raise Broken(f"a beat of {steps_per_beat} steps took {status.step - before}, and no event says why")
        (trajectory,) = admitted.trajectories(events)
    _check_tables(trajectory)
    return RunOutcome(trajectory, guard, message)


def _state(ensemble: Ensemble, member: Member) -> tuple[Packing, Status]:
    try:
        packing = ensemble.packing(member)  # refuses what is not finite
    except ValueError as error:
        raise Broken(f"no guard has named this: {error}") from None
    status = ensemble.status(member)
    if not math.isfinite(status.kinetic):
        raise Broken(f"the kinetic energy is {status.kinetic} at step {status.step}, and no guard has named it")
    return packing, status


def _check_message(failed: Failed, before: Status, steps: int) -> None:
    """Check that an error names the guard, the grain and the remedy, at a step of the beat that it stopped."""
    if failed.guard not in GUARDS:
        raise Broken(f"no guard is called {failed.guard!r}")
    if f"grain {failed.grain}" not in failed.message or "numerics." not in failed.message:
        raise Broken(f"the message names no grain or no remedy: {failed.message!r}")
    if not before.step <= failed.step <= before.step + steps:
        raise Broken(f"the guard names step {failed.step}, outside the beat from step {before.step}")


def _check_state_kept(ensemble: Ensemble, member: Member, good: Packing, status: Status) -> None:
    packing, now = _state(ensemble, member)
    if now.step != status.step:
        raise Broken(f"after the error the member stands at step {now.step}, not at {status.step}, the last good beat")
    for name, array in good.arrays().items():
        if not np.array_equal(array, packing.arrays()[name]):
            raise Broken(f"after the error {name} is not that of the last good beat")


def _check_tables(trajectory: Trajectory) -> None:
    for probe, table in trajectory.tables.items():
        for name, column in table.items():
            if not np.isfinite(column).all():
                raise Broken(f"the column {name} of {probe} is not finite")


def sound(outcome: RunOutcome) -> Trajectory:
    """Return the motion of a course without error. Raises Broken with the message of an error."""
    if outcome.trajectory is None or outcome.guard:
        raise Broken(f"stopped, but the motion should be correct: {outcome.message}")
    return outcome.trajectory


def guard_error(part: str, run_outcome: RunOutcome, guards: Sequence[str] = GUARDS) -> Ending:
    """Expect an error: `named error` if one of `guards` ended the course, `failed` if another did, or none."""
    if not run_outcome.guard:
        return Ending(part, "failed", "silence: no guard reported anything")
    outcome = "named error" if run_outcome.guard in guards else "failed"
    return Ending(part, outcome, one_line(run_outcome.message))


def refused(part: str, do: Callable[[], object], words: str, kinds: tuple[type[Exception], ...]) -> Ending:
    """Expect an exception: `named error` if `do` raises one of `kinds` whose text has `words`, else `failed`."""
    try:
        do()
    except kinds as error:
        outcome = "named error" if words in str(error) else "failed"
        return Ending(part, outcome, one_line(str(error)))
    return Ending(part, "failed", "silence: nothing was refused")


def one_line(message: str) -> str:
    """Join the words of a message in one line."""
    return " ".join(message.split())
