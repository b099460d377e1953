"""Fillings: grains placed at random fall into the closed container until they rest."""

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from labbook.backend import Checkpoint, EndState, Ensemble, Event, Failed, Member, Settled, Status
from labbook.backend.contract import StoredState
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe, Table
from labbook.filling import PlacingError, Pouring, Refill, place
from labbook.filling.bed import at_rest, outside_container
from labbook.filling.placing import STARTS
from labbook.lab import identity
from labbook.lab.folder import Claim
from labbook.lab.identity import Keys
from labbook.lab.index import packing_row
from labbook.lab.journal import PROGRESS, Saved
from labbook.lab.packings import PackingRecord, write_packing
from labbook.lab.records import Unreadable
from labbook.plan.demand import Demand, PackingsOf
from labbook.plan.forecast import fill_time, settling_time
from labbook.run.job import BeatCost, Job, JobContext, JobFailed, JobOutput, LabEntry, failure
from labbook.run.ledger import ledger
from labbook.scene import BedTop, Packing, Scene, Spheres
from labbook.scene.timescales import collision

_LOOK_INTERVAL = 20  # beats: a look copies the state of a member from its device
_LOOKS_AT_REST = 2  # on end that have to find it at rest
HOVERING = 1e-4
"""Kinetic energy per grain [m g d] below which a bed whose energy no longer falls counts as hovering.

Its grains jitter by much less than their overlap at rest.
"""
_HOVER_TIMES = 5.0  # expected times of a filling in which the energy of a hovering bed has not halved,
_MIN_HOVER_TIME = 100.0  # and so many times sqrt(d/g) at least
_MAX_LEVEL_CHANGE = 0.01  # d: by which the mean height of the grains of a hovering bed may change meanwhile
_MAX_ACCEPTED = 1e-3  # m g d: a bed that moves faster is not to be accepted as it is
_MIN_GRAINS_MOVING = 100  # grains: of fewer, fill.moving is no remedy, since a single grain may move in any case


class FillJob(Job):
    """The packing of a demand, and of all demands with the same packing key."""

    kind = "packing"

    def __init__(
        self, context: JobContext, demand: Demand, keys: Keys, claim: Claim, serves: str = "",
        placed_grains: "Future[Packing] | None" = None,
    ):  # fmt: skip
        """Prepare a filling.

        Args:
            context: Lab, backend and device.
            demand: A run that starts from the packing.
            keys: Keys of that run.
            claim: Claim of the packing's key.
            serves: Label of the points whose runs start from it; empty if all points do.
            placed_grains: Start of the grains, if another process places them.
        """
        self._served_points, self._placed_grains = serves, placed_grains
        self._failure: Failed | None = None
        self.max_time: float | None = None
        """Time limit [s] that ended the filling, if that was the reason."""
        super().__init__(context, demand, keys, keys.packing, context.lab.packing(keys.packing), claim)
        self.scene, self._lifted_walls = demand.shared.closed, demand.shared.lifted
        self._stage, self._stage_start = 0, 0.0
        """Number of the stage, and the time [s] at which it began."""
        self.settled_below = demand.filling.settled_below
        if self.scene.gravity > 0:
            self.settled_beats = STARTS[demand.filling.kind].quiet_beats(self.scene, self.numerics.beat)
        self._max_time = demand.shared.longest_filling
        self._quiet_looks = 0
        self._lowest_energy, self._halved_at, self._max_energy, self._has_warned = math.inf, 0.0, 0.0, False
        self._heights: tuple[tuple[float, float], ...] = ()
        self._last_look: tuple[float, Packing] | None = None
        self._losses = ""
        self._end_time = demand.filling.until
        self._start: Packing | None = None
        """Start of the grains, if the filling ends there."""
        self._entered = 0 if demand.filling.stream else self.scene.grains.count
        """Number of grains that have entered; `_entered_before`: before the last beat."""
        self._entered_before = self._entered
        self._has_advanced = False

    @cached_property
    def _pouring(self) -> Pouring | None:
        """Stream that brings the grains; None where all are placed at once. Raises JobFailed."""
        if (stream := self.demand.filling.stream) is None:
            return None
        try:
            return Pouring(self.scene, stream, self.demand.filling.seed, self.numerics.beat)
        except PlacingError as error:
            raise JobFailed(f"{self.label}: {error}") from error

    def begin(self) -> Packing | Checkpoint:
        """Return the start of the member. Raises JobFailed, also if another backend has to make this packing."""
        guest, own = self.demand.shared.packings_of, self.context.backend.capabilities
        if guest is not None and guest != PackingsOf(own, self.demand.shared.numerics.precision):
            raise JobFailed(
                f"{self.label}: {guest.backend.name} has to make this packing first, in {guest.precision} precision"
            )
        return super().begin()

    @property
    def stage(self) -> int:
        """Number of the stage: 0 until the first rest; with mobilised friction 1 while walls move, then 2."""
        return self._stage

    @property
    def stepped(self) -> Scene:
        """Closed scene; in stage 1 with its upright walls moving."""
        return self._lifted_walls if self._lifted_walls is not None and self._walls_move else self.scene

    @property
    def widest(self) -> Scene:
        """Scene with moving walls, if walls move in any stage."""
        return self._lifted_walls or self.scene

    @property
    def _walls_move(self) -> bool:
        return self._stage == 1

    @property
    def _stage_time(self) -> float:
        """Time [s] in the present stage."""
        return self.status.time - self._stage_start

    @property
    def numerics(self) -> Numerics:
        """Numerics of the filling."""
        return self.demand.shared.filling_numerics

    @property
    def is_placed(self) -> bool:
        """True if the filling can begin: no other process is still placing its grains."""
        return self._placed_grains is None or self._placed_grains.done()

    def release(self) -> None:
        """Release the claim, and cancel the placing of grains."""
        if self._placed_grains is not None:
            self._placed_grains.cancel()
        super().release()

    def fresh(self) -> Packing:
        """Place the grains, or the first ones of a stream."""
        placed, self._placed_grains = self._placed_grains, None
        try:
            filling = self.demand.filling
            if self._pouring is not None:
                start = self._pouring.first()
                self._entered = len(start)
            else:
                start = placed.result() if placed else place(self.scene, filling.kind, filling.seed, filling.file)
            self._start = start if self._end_time == 0 else None
            return start
        except PlacingError as error:
            raise JobFailed(f"{self.label}: {error}") from error

    def recall(self, saved: Saved | None) -> Saved | None:
        """Restore the state of a save. Raises Unreadable."""
        if saved is not None:
            self.check(saved, self.journal.folder)
            quiet = saved.state.get("quiet", 0)
            # `type`, not `isinstance`: true and false of JSON are integers to Python
            if type(quiet) is not int or not 0 <= quiet < _LOOKS_AT_REST:
                raise Unreadable(f"{self.journal.folder / PROGRESS}: state.quiet: {quiet} looks that found it at rest")
            stage, stage_start = saved.state.get("stage", 0), saved.state.get("since", 0.0)
            if stage not in ((0,) if self._lifted_walls is None else (0, 1, 2)) or not 0 <= stage_start < math.inf:
                raise Unreadable(f"{self.journal.folder / PROGRESS}: state.stage: stage {stage} since {stage_start} s")
            self._quiet_looks, self._stage, self._stage_start, self._halved_at = quiet, stage, stage_start, stage_start
            entered, count = saved.state.get("poured", self.scene.grains.count), self.scene.grains.count
            if type(entered) is not int or not 0 < entered <= count or (self._pouring is None and entered != count):
                raise Unreadable(f"{self.journal.folder / PROGRESS}: state.poured: {entered} of {count} grains")
            self._entered = entered
        return saved

    def state(self) -> dict[str, Any]:
        """Return the number of looks at rest, the stage, the number of entered grains, and a guard's message."""
        stage = {"stage": self._stage, "since": self._stage_start} if self._stage else {}
        entered = {} if self._pouring is None else {"poured": self._entered}
        return {"quiet": self._quiet_looks, **stage, **entered} | (
            {"failed": self._failure.message} if self._failure else {}
        )

    def after(self, status: Status, tables: Mapping[Probe, Table], cost: BeatCost) -> None:
        """Account for a beat, and note when the kinetic energy last halved."""
        self._has_advanced, self._entered_before = status.step > self.status.step, self._entered
        super().after(status, tables, cost)
        if self._pours:  # grains that enter bring energy: it may fall for good only after the last one
            self._watch_energy(math.inf)
        elif status.kinetic <= self._lowest_energy / 2:
            self._watch_energy(status.kinetic)
        self._max_energy = max(self._max_energy, status.kinetic)

    @property
    def _pours(self) -> bool:
        """True while grains of a stream have still to enter."""
        return self._entered < self.scene.grains.count

    @property
    def needs_refill(self) -> bool:
        """True while grains of a stream have still to enter, after a good beat."""
        return self._pours and self._end_time != 0 and self._has_advanced and self.status.grains == self._entered_before

    @property
    def floor(self) -> float:
        """Height z [m] above which grains of the bed may be in the way of the stream."""
        assert self._pouring is not None
        return self._pouring.floor

    def refill(self, bed: BedTop) -> Refill:
        """Return the bed with the stream whose grains enter after this beat."""
        assert self._pouring is not None
        return Refill(self._pouring, bed, self.status.step // self.numerics.steps_per_beat)

    def refilled(self, grains: Packing) -> None:
        """Count grains that have entered."""
        self._entered += len(grains)

    @property
    def stalled(self) -> bool:
        """True if the kinetic energy has not halved during the expected time of a whole filling."""
        usual = self._expected_time
        return not self._walls_move and self._stage_time > 2 * usual and self.status.time - self._halved_at > usual

    @property
    def hovers(self) -> bool:
        """True if the bed stands still, but for a jitter slightly above the energy at rest that does not decay."""
        grains = self.scene.grains
        min_time = max(
            _HOVER_TIMES * self._expected_time, _MIN_HOVER_TIME * math.sqrt(grains.diameter / self.scene.gravity)
        )
        if (
            self._walls_move
            or self._max_energy >= HOVERING
            or self.status.time - self._halved_at < min_time
            or not self._heights
        ):
            return False
        (_, before), (_, now) = self._heights
        return abs(now - before) < _MAX_LEVEL_CHANGE * grains.diameter

    def warning(self) -> str | None:
        """Warn once of a filling that does not seem to come to rest."""
        if self._has_warned or not self.stalled:
            return None
        self._has_warned = True
        return (
            f"{self.label}: does not seem to come to rest: {self._state_text()}. The filling goes on until "
            f"fill.max_time ({self._max_time:.3g} s). If it never rests, {self._remedy()}."
        )

    def _remedy(self) -> str:
        """Suggest what would let the bed come to rest, or count as such, the most likely remedy first."""
        scene, several = self.scene, self.scene.grains.count >= _MIN_GRAINS_MOVING
        energy = _rounded_up(1.2 * self._max_energy)
        accept = (
            [f"use fill.settled_below: {short(energy)}, which accepts it as it is"] if energy <= _MAX_ACCEPTED else []
        )
        friction = []
        if isinstance(scene.grains, Spheres) and scene.contact.rolling_friction == 0:
            friction.append("use contact.rolling_friction: 0.01, without which spheres roll for ever")
        if scene.contact.friction == 0:
            friction.append("use fill.friction: 0.1, without which grains slide for ever")
        moving = [f"let more grains move (fill.moving, now {self.demand.filling.moving:g})"] if several else []
        step = ["use a smaller numerics.dt"]
        jitters = self._max_energy < HOVERING  # a jitter; what moves faster should rather be stopped than accepted
        return ", or ".join([*accept, *friction, *step] if jitters else [*friction, *moving, *accept, *step])

    def _state_text(self) -> str:
        """Describe energy, threshold and time step."""
        fraction = self.numerics.dt / collision(self.scene.stiffened(self.numerics.stiffness_scale))
        return (
            f"at {self.status.time:.3g} s its kinetic energy is {short(self.status.kinetic)} m g d per grain, "
            f"at rest below {short(self.settled_below or 0)}, and has not halved since {self._halved_at:.3g} s; "
            f"the step is {self.numerics.dt:.3g} s, {fraction:.2g} of a collision"
        )

    def _watch_energy(self, kinetic: float) -> None:
        """Start to watch for the kinetic energy per grain to fall to half of `kinetic`."""
        self._lowest_energy, self._halved_at, self._max_energy = kinetic, self.status.time, 0.0

    def absorb(self, probe: Probe, table: Table) -> None:
        """Ignore rows: fillings observe nothing."""

    @property
    def may_save(self) -> bool:
        """True unless the backend counts beats at rest: that count is not in a checkpoint."""
        assert self.settled_below is not None
        return self._end_time != 0 and (self._walls_move or self._pours or self.status.kinetic >= self.settled_below)

    @property
    def looks(self) -> bool:
        """True if grains have left, or a look is due.

        Where some grains may move, a look every _LOOK_INTERVAL beats decides when the bed is at rest. Else looks are
        due only once the filling takes much longer than expected.
        """
        if self.status.grains < self._entered_before:
            return True
        if self._pours or self._end_time == 0:
            return False
        if self.status.step % (_LOOK_INTERVAL * self.numerics.steps_per_beat):
            return False
        return self.demand.filling.moving > 0 or self._stage_time > 2 * self._expected_time

    def look(self, ensemble: Ensemble, member: Member) -> None:
        """Examine each grain: whether it is in the container, the height of the bed and, where some may move,
        speeds."""
        packing = ensemble.packing(member)
        self._losses = self._losses or losses(self.scene, self.status.time, packing, self._last_look, self._entered)
        self._last_look = self.status.time, packing
        if len(packing):
            level = self.status.time, float(packing.x[:, 2].mean())
            since = self._heights[0] if self._heights and self._heights[0][0] >= self._halved_at else level
            self._heights = since, level
        moving = self.demand.filling.moving
        if moving == 0:
            return
        assert self.settled_below is not None
        rests = not (self._walls_move or self._pours) and at_rest(self.scene, packing, self.settled_below, moving)
        self._quiet_looks = self._quiet_looks + 1 if rests else 0

    def verdict(self, events: Sequence[Event]) -> str | None:
        """Decide: settled, stopped by a guard, grains lost, hovering, or out of time; None if it goes on, or enters a
        stage."""
        self._failure = failure(events)
        if self._failure:
            return "failed"
        if self._losses:
            return "lost"
        if self._is_over(events):
            if self._stage == (0 if self._lifted_walls is None else 2):
                return "settled"
            self._stage, self._stage_start, self._quiet_looks = self._stage + 1, self.status.time, 0
            self._watch_energy(math.inf)
        elif self._stage_time >= self._max_time and not self._walls_move:
            return "late"
        return "hovering" if self.hovers else None

    def _is_over(self, events: Sequence[Event]) -> bool:
        """True once the bed is at rest; in stage 1 once walls have moved their distance."""
        if self._walls_move:
            mobilise = self.demand.filling.mobilise
            assert mobilise is not None
            return self._stage_time >= mobilise.time
        if self._end_time is not None:
            return self.status.time >= self._end_time
        return not self._pours and self._is_at_rest(events)

    def _is_at_rest(self, events: Sequence[Event]) -> bool:
        return self._quiet_looks >= _LOOKS_AT_REST or any(isinstance(event, Settled) for event in events)

    def output(self, verdict: str, end_state: EndState) -> "PackingOutput":
        """Return the packing. Raises JobFailed for a failed filling, whose last state is saved."""
        if self._losses:
            raise JobFailed(needs_all(self.label, self._losses, self._closing_remedy()))
        if verdict == "settled":
            if self._start is not None:  # fill.until: 0: the grains as they were placed, not after the first beat
                own = self.context.backend.capabilities
                end_state = StoredState(Checkpoint(own.name, own.cache_version, {}), self._start)
                self.status = Status(0, 0.0, len(self._start), self.status.kinetic)
            return PackingOutput(
                self.context.lab,
                self.key,
                self.folder,
                self.label,
                record=self._record(),
                status=self.status,
                left=end_state,
                earlier=self._last_look if self.status.grains < self._entered else None,
                remedy=self._closing_remedy(),
                pouring=self._pouring if self._pours else None,
                entered=self._entered,
            )
        if self.may_save:
            self._write(end_state.checkpoint)
        if verdict == "late":
            self.max_time = self._max_time
            if self._pours:
                raise JobFailed(
                    f"{self.label}: only {self._entered} of {self.scene.grains.count} grains have entered by "
                    f"{self.status.time:.3g} s. Raise fill.max_time (the filling goes on from here); if the bed has "
                    "risen into the region of fill.stream, move it up or use fewer grains."
                )
            raise JobFailed(
                f"{self.label}: not at rest after {self.status.time:.3g} s: {self._state_text()}. "
                f"Raise fill.max_time (the filling goes on from here). If it never rests, {self._remedy()}."
            )
        if verdict == "hovering":
            raise JobFailed(
                f"{self.label}: the bed hovers: {self._state_text()}, while its height stayed the same. "
                f"Remedy: {self._remedy()}. Its state is kept: the same command again lets the filling go on from here"
            )
        reason = self._failure.message if self._failure else verdict
        raise JobFailed(f"{self.label}: {reason} (while filling; the last good state is in {self.journal.folder})")

    def _closing_remedy(self) -> str:
        """Suggest what keeps grains in the container during the filling."""
        if not self.scene.container.closes:
            return "close its outlet while it is filled by a part with opens: start, or add a wall where they leave"
        return "use a smaller numerics.dt or stiffer grains, so that none is pressed through a wall"

    def _record(self) -> PackingRecord:
        """Make the record of the packing, without its ledger."""
        capabilities = self.context.backend.capabilities
        return PackingRecord(
            packing_key=self.key,
            closed_key=self.demand.shared.closed_key,
            backend=capabilities.name,
            cache_version=capabilities.cache_version,
            scene=self.scene,
            versions=identity.versions(self.scene),
            filling=self.demand.filling,
            numerics=self.numerics,
            grains=self.scene.grains.count,
            duration=self.status.time,
            kinetic=self.status.kinetic,
            sessions=self.sessions(),
        )

    def progress(self) -> float:
        """Return the fraction of the expected filling time; settling has no end that can be forecast."""
        return min(0.95, self.status.time / fill_time(self.demand))

    @property
    def open_ended(self) -> bool:
        """True if it takes longer to settle than expected."""
        return not self._walls_move and self._stage_time > self._expected_time

    @cached_property
    def _expected_time(self) -> float:
        """Time [s] in which a bed like this one is expected to come to rest."""
        return settling_time(self.demand)

    def doing(self) -> tuple[str, ...]:
        """Return the kinetic energy and its threshold, and the simulated time and its maximum."""
        assert self.settled_below is not None
        if (mobilise := self.demand.filling.mobilise) is not None and self._walls_move:
            return (
                f"mobilising the friction of walls: {self._stage_time:.2f} of {mobilise.time:.3g} s",
                f"{self.status.time:.2f} s",
            )
        if self._pours:
            entered = f"{self._entered} of {self.scene.grains.count} grains have entered"
            return entered, f"{self.status.time:.2f} s"
        now, below = short(self.status.kinetic), short(self.settled_below)
        return f"settling: {now} of m g d, rests below {below}", f"{self.status.time:.2f} of {self._max_time:.3g} s"

    @property
    def label(self) -> str:
        """Name of the job for messages: points, seed."""
        return f"packing{self._served_points and f' of {self._served_points}'}, seed {self.demand.seed}"


@dataclass(frozen=True)
class PackingOutput(JobOutput):
    """Output of a settled filling.

    Args:
        record: Record without its ledger.
        status: Last status of the member.
        left: Packing and checkpoint at the end.
        earlier: Time [s] and packing of an earlier look, if grains are missing.
        remedy: Suggestion for a filling that has lost grains.
        pouring: Stream whose last grains enter after the opening; None if all have entered.
        entered: Number of grains that have entered.
    """

    record: PackingRecord
    status: Status
    left: EndState
    earlier: tuple[float, Packing] | None
    remedy: str
    pouring: Pouring | None
    entered: int

    def put(self) -> None:
        """Put the packing into the lab. Raises DiskFull, or JobFailed if grains have left."""
        reached = self.status.time, self.left.packing, self.earlier
        if lost_grains := losses(self.record.scene, *reached, self.entered):
            raise JobFailed(needs_all(self.label, lost_grains, self.remedy))
        super().put()

    def fill_folder(self, folder: Path) -> None:
        """Write arrays and record."""
        write_packing(folder, self._full_record, self._packing)

    @cached_property
    def _packing(self) -> Packing:
        """All grains, also those that enter later."""
        return self.left.packing if self.pouring is None else self.pouring.with_waiting(self.left.packing)

    @cached_property
    def _full_record(self) -> PackingRecord:
        """Record with its ledger."""
        counts = ledger(self.record.scene, self.status, self._packing)
        return self.record.model_copy(update={"ledger": counts})

    def entry(self) -> LabEntry:
        """Return the index row of the packing, and the packing."""
        return LabEntry((packing_row(self.folder, self._full_record), []), (self._full_record, self._packing))

    def reread(self) -> LabEntry:
        """Return the index row of the packing from its folder."""
        return LabEntry((packing_row(self.folder), []))


def needs_all(label: str, losses_text: str, remedy: str) -> str:
    """Format the message of a filling that has lost grains."""
    return f"{label}: {losses_text}. A discharge needs all grains: {remedy}"


def losses(
    scene: Scene, time: float, packing: Packing, earlier: tuple[float, Packing] | None, entered: int | None = None
) -> str:
    """Describe grains that have left the container: number, place and time; empty if none have.

    Args:
        scene: The closed scene.
        time: Time [s] of `packing`.
        packing: Present grains.
        earlier: Time [s] and grains of an earlier look.
        entered: Number of grains that have entered; None: all.
    """
    assert packing.ids is not None
    count, plane = entered or scene.grains.count, scene.container.outlet_plane
    missing = np.setdiff1d(np.arange(scene.grains.count), packing.ids)[: max(0, count - len(packing))]
    outside = packing.ids[outside_container(scene, packing)]
    number = len(missing) + len(outside)
    if not number:
        return ""
    when, reference = (time, packing) if len(outside) else earlier or (0.0, packing)
    assert reference.ids is not None
    positions = reference.x[np.isin(reference.ids, outside if len(outside) else missing)]
    where = ""
    if len(positions):
        x, y, z = positions[0] * 1e3
        where = f"; one was last seen at x, y, z = {x:.3g}, {y:.3g}, {z:.3g} mm, {when:.3g} s after the start"
    below = plane is not None and (len(missing) > 0 or bool((positions[:, 2] < plane).any()))
    how = "through a wall, or below the lowest one"
    if plane is not None and below:
        how = f"through container.outlet_plane (z = {plane * 1e3:g} mm)"
    return f"{number} of {count} grains have left the container by {time:.3g} s, {how}{where}"


def short(energy: float) -> str:
    """Format a kinetic energy: 12, 0.3, 4e-5, 0."""
    return "0" if energy == 0 else f"{energy:.2g}" if energy >= 0.01 else f"{energy:.0e}".replace("e-0", "e-")


def _rounded_up(value: float) -> float:
    """Round up to one digit."""
    if not 0 < value < math.inf:
        return math.inf
    unit = 10.0 ** math.floor(math.log10(value))
    return math.ceil(value / unit) * unit
