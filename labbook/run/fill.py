"""Making a packing: grains placed at random fall into the closed container until they rest."""

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
from labbook.filling.bed import astray, at_rest
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
from labbook.run.job import Bench, Job, JobFailed, Kept, LabEntry, failure
from labbook.run.ledger import ledger
from labbook.scene import Packing, Scene, Spheres
from labbook.scene.timescales import collision

_LOOK_EVERY = 20  # beats: a look copies the state of a member from its device
_LOOKS = 2  # on end that have to find it at rest
HOVERING = 1e-4
"""Kinetic energy per grain [m g d] below which a bed whose energy no longer falls counts as hovering: its grains jitter
by much less than their overlap at rest."""
_HOVERS = 5.0  # expected times of a filling in which the energy of a hovering bed has not halved,
_LEAST = 100.0  # and so many times sqrt(d/g) at least
_CREEP = 0.01  # d: by which the mean height of the grains of a hovering bed may change meanwhile
_SLOW = 1e-3  # m g d: a bed that moves faster is not to be accepted as it is
_MANY = 100  # grains: of fewer, fill.moving is no remedy, since a single grain may move in any case


class FillJob(Job):
    """The packing that a demand, and all that share its packing key, starts from."""

    kind = "packing"

    def __init__(
        self, bench: Bench, demand: Demand, keys: Keys, claim: Claim, serves: str = "",
        placed: "Future[Packing] | None" = None,
    ):  # fmt: skip
        """serves: the points whose runs start from it, in words; empty if those are all points. placed: where its
        grains begin, if another process places them."""
        self._serves, self._placed = serves, placed
        self._failure: Failed | None = None
        self.max_time: float | None = None
        """Longest time [s] after which it was given up, if it was for that."""
        super().__init__(bench, demand, keys, keys.packing, bench.lab.packing(keys.packing), claim)
        self.scene, self._lifted = demand.shared.closed, demand.shared.lifted
        self._stage, self._since = 0, 0.0
        """Number of the stage, and the time [s] at which it began."""
        self.settled_below = demand.filling.settled_below
        if self.scene.gravity > 0:
            self.settled_beats = STARTS[demand.filling.kind].quiet_beats(self.scene, self.numerics.beat)
        self._longest = demand.shared.longest_filling
        self._quiet = 0
        self._lowest, self._fell, self._most, self._warned = math.inf, 0.0, 0.0, False
        self._levels: tuple[tuple[float, float], ...] = ()
        self._seen: tuple[float, Packing] | None = None
        self._lost = ""
        self._until = demand.filling.until
        self._start: Packing | None = None
        """The grains as they were placed, if this is all of the filling."""
        self._poured = 0 if demand.filling.stream else self.scene.grains.count
        """Grains that have entered; `_stepped` of them before the last beat."""
        self._stepped = self._poured
        self._advanced = False

    @cached_property
    def _pouring(self) -> Pouring | None:
        """The stream that brings the grains; None where all are placed at once. Raises JobFailed."""
        if (stream := self.demand.filling.stream) is None:
            return None
        try:
            return Pouring(self.scene, stream, self.demand.filling.seed, self.numerics.beat)
        except PlacingError as error:
            raise JobFailed(f"{self.label}: {error}") from error

    def begin(self) -> Packing | Checkpoint:
        """As every job, but a backend never fills in another one's place. Raises JobFailed."""
        guest, own = self.demand.shared.packings_of, self.bench.backend.capabilities
        if guest is not None and guest != PackingsOf(own, self.demand.shared.numerics.precision):
            raise JobFailed(
                f"{self.label}: {guest.backend.name} has to make this packing first, in {guest.precision} precision"
            )
        return super().begin()

    @property
    def stage(self) -> int:
        """Number of the stage: 0 until the first rest; with friction that is mobilised 1 while walls move, then 2."""
        return self._stage

    @property
    def stepped(self) -> Scene:
        """The closed scene, of which the upright walls move in stage 1."""
        return self._lifted if self._lifted is not None and self._walls_move else self.scene

    @property
    def widest(self) -> Scene:
        """The scene with walls that move, where they ever do."""
        return self._lifted or self.scene

    @property
    def _walls_move(self) -> bool:
        return self._stage == 1

    @property
    def _for(self) -> float:
        """Time [s] in the present stage."""
        return self.status.time - self._since

    @property
    def numerics(self) -> Numerics:
        """How it is computed."""
        return self.demand.shared.filled_by

    @property
    def is_placed(self) -> bool:
        """True if it can begin: no other process places its grains."""
        return self._placed is None or self._placed.done()

    def release(self) -> None:
        """Let others claim the key; its grains need not be placed any more."""
        if self._placed is not None:
            self._placed.cancel()
        super().release()

    def fresh(self) -> Packing:
        """Grains in the air."""
        placed, self._placed = self._placed, None
        try:
            filling = self.demand.filling
            if self._pouring is not None:
                first = self._pouring.first()
                self._poured = len(first)
                return first
            start = placed.result() if placed else place(self.scene, filling.kind, filling.seed, filling.file)
            self._start = start if self._until == 0 else None
            return start
        except PlacingError as error:
            raise JobFailed(f"{self.label}: {error}") from error

    def recall(self, saved: Saved | None) -> Saved | None:
        """As saved. Raises Unreadable."""
        if saved is not None:
            self.check(saved, self.journal.folder)
            quiet = saved.state.get("quiet", 0)
            if type(quiet) is not int or not 0 <= quiet < _LOOKS:
                raise Unreadable(f"{self.journal.folder / PROGRESS}: state.quiet: {quiet} looks that found it at rest")
            stage, since = saved.state.get("stage", 0), saved.state.get("since", 0.0)
            if stage not in ((0,) if self._lifted is None else (0, 1, 2)) or not 0 <= since < math.inf:
                raise Unreadable(f"{self.journal.folder / PROGRESS}: state.stage: stage {stage} since {since} s")
            self._quiet, self._stage, self._since, self._fell = quiet, stage, since, since
            poured, count = saved.state.get("poured", self.scene.grains.count), self.scene.grains.count
            if type(poured) is not int or not 0 < poured <= count or (self._pouring is None and poured != count):
                raise Unreadable(f"{self.journal.folder / PROGRESS}: state.poured: {poured} of {count} grains")
            self._poured = poured
        return saved

    def state(self) -> dict[str, Any]:
        """How often on end it was found at rest; its stage, after the first; why a guard stopped it, if one did."""
        stage = {"stage": self._stage, "since": self._since} if self._stage else {}
        poured = {} if self._pouring is None else {"poured": self._poured}
        return {"quiet": self._quiet, **stage, **poured} | ({"failed": self._failure.message} if self._failure else {})

    def after(
        self, status: Status, tables: Mapping[Probe, Table], wall: float, process: float, grain_steps: float
    ) -> None:
        """As every job; when the kinetic energy last fell to half of what it had been is noted."""
        self._advanced, self._stepped = status.step > self.status.step, self._poured
        super().after(status, tables, wall, process, grain_steps)
        if self._enters:
            self._watch_from(math.inf)
        elif status.kinetic <= self._lowest / 2:
            self._watch_from(status.kinetic)
        self._most = max(self._most, status.kinetic)

    @property
    def _enters(self) -> bool:
        """True while grains of a stream are still to enter."""
        return self._poured < self.scene.grains.count

    @property
    def lacks_grains(self) -> bool:
        """True while grains of a stream are still to enter, after a beat that went well."""
        return self._enters and self._advanced and self.status.grains == self._stepped

    def refill(self, bed: Packing) -> Refill:
        """Return this bed, which grains of the stream enter after this beat."""
        assert self._pouring is not None
        return Refill(self._pouring, bed, self.status.step // self.numerics.steps_per_beat)

    def refilled(self, grains: Packing) -> None:
        """Count the grains that have entered."""
        self._poured += len(grains)

    @property
    def stalled(self) -> bool:
        """Whether the kinetic energy has not halved for as long as a whole filling is expected to take."""
        usual = self._usual
        return not self._walls_move and self._for > 2 * usual and self.status.time - self._fell > usual

    @property
    def hovers(self) -> bool:
        """Whether the bed stands still, but for a jitter slightly above the energy at rest that does not decay."""
        grains = self.scene.grains
        least = max(_HOVERS * self._usual, _LEAST * math.sqrt(grains.diameter / self.scene.gravity))
        if self._walls_move or self._most >= HOVERING or self.status.time - self._fell < least or not self._levels:
            return False
        (_, before), (_, now) = self._levels
        return abs(now - before) < _CREEP * grains.diameter

    def warning(self) -> str | None:
        """Said once, of a filling that does not seem to come to rest."""
        if self._warned or not self.stalled:
            return None
        self._warned = True
        return (
            f"{self.label}: does not seem to come to rest: {self._standing()}. The filling goes on until fill.max_time "
            f"({self._longest:.3g} s). If it never rests, {self._remedy()}."
        )

    def _remedy(self) -> str:
        """What lets this bed count as at rest, or come to rest, the most likely remedy first."""
        scene, several = self.scene, self.scene.grains.count >= _MANY
        enough = _rounded_up(1.2 * self._most)
        accept = [f"use fill.settled_below: {short(enough)}, which accepts it as it is"] if enough <= _SLOW else []
        slows = []
        if isinstance(scene.grains, Spheres) and scene.contact.rolling_friction == 0:
            slows.append("use contact.rolling_friction: 0.01, without which spheres roll for ever")
        if scene.contact.friction == 0:
            slows.append("use fill.friction: 0.1, without which grains slide for ever")
        moving = [f"let more grains move (fill.moving, now {self.demand.filling.moving:g})"] if several else []
        step = ["use a smaller numerics.dt"]
        known = self._most < HOVERING  # a jitter; what moves faster should rather be stopped than accepted
        return ", or ".join([*accept, *slows, *step] if known else [*slows, *moving, *accept, *step])

    def _standing(self) -> str:
        """Energy, threshold and step, in words."""
        part = self.numerics.dt / collision(self.scene.stiffened(self.numerics.stiffness_scale))
        return (
            f"at {self.status.time:.3g} s its kinetic energy is {short(self.status.kinetic)} m g d per grain, "
            f"at rest below {short(self.settled_below or 0)}, and has not halved since {self._fell:.3g} s; "
            f"the step is {self.numerics.dt:.3g} s, {part:.2g} of a collision"
        )

    def _watch_from(self, kinetic: float) -> None:
        """Watch from now on for the kinetic energy per grain to fall to half of this."""
        self._lowest, self._fell, self._most = kinetic, self.status.time, 0.0

    def absorb(self, probe: Probe, table: Table) -> None:
        """Fillings observe nothing."""

    @property
    def may_save(self) -> bool:
        """Not while the backend counts beats at rest: that count is not in a checkpoint."""
        assert self.settled_below is not None
        return self._until != 0 and (self._walls_move or self._enters or self.status.kinetic >= self.settled_below)

    @property
    def looks(self) -> bool:
        """True if grains have left, or it is time to look: at every _LOOK_EVERY beats where some grains may move, which
        decides when the bed is at rest; else only once the filling takes much longer than expected."""
        if self.status.grains < self._stepped:
            return True
        if self._enters or self._until == 0:
            return False
        if self.status.step % (_LOOK_EVERY * self.numerics.steps_per_beat):
            return False
        return self.demand.filling.moving > 0 or self._for > 2 * self._usual

    def look(self, ensemble: Ensemble, member: Member) -> None:
        """Look at each grain: whether it is still in the container, how high the bed stands, and where some grains may
        move, at their speeds."""
        packing = ensemble.packing(member)
        self._lost = self._lost or losses(self.scene, self.status.time, packing, self._seen, self._poured)
        self._seen = self.status.time, packing
        if len(packing):
            level = self.status.time, float(packing.x[:, 2].mean())
            since = self._levels[0] if self._levels and self._levels[0][0] >= self._fell else level
            self._levels = since, level
        moving = self.demand.filling.moving
        if moving == 0:
            return
        assert self.settled_below is not None
        calm = not (self._walls_move or self._enters) and at_rest(self.scene, packing, self.settled_below, moving)
        self._quiet = self._quiet + 1 if calm else 0

    def verdict(self, events: Sequence[Event]) -> str | None:
        """Settled, stopped by a guard, with grains lost, hovering, or out of time; None where another stage follows."""
        self._failure = failure(events)
        if self._failure:
            return "failed"
        if self._lost:
            return "lost"
        if self._is_over(events):
            if self._stage == (0 if self._lifted is None else 2):
                return "settled"
            self._stage, self._since, self._quiet = self._stage + 1, self.status.time, 0
            self._watch_from(math.inf)
        elif self._for >= self._longest and not self._walls_move:
            return "late"
        return "hovering" if self.hovers else None

    def _is_over(self, events: Sequence[Event]) -> bool:
        """True once the bed is at rest; in stage 1 once walls have moved as far as they are to."""
        if self._walls_move:
            mobilise = self.demand.filling.mobilise
            assert mobilise is not None
            return self._for >= mobilise.time
        if self._until is not None:
            return self.status.time >= self._until
        return not self._enters and self._rests(events)

    def _rests(self, events: Sequence[Event]) -> bool:
        return self._quiet >= _LOOKS or any(isinstance(event, Settled) for event in events)

    def kept(self, verdict: str, left: EndState) -> "KeptPacking":
        """The packing; of a filling that came to nothing, the last state. Raises JobFailed for that."""
        if self._lost:
            raise JobFailed(needs_all(self.label, self._lost, self._closing()))
        if verdict == "settled":
            if self._enters:
                raise JobFailed(
                    f"{self.label}: {self._poured} of {self.scene.grains.count} grains have entered by fill.until "
                    f"({self._until:g} s); use a later time, or a larger fill.stream.rate"
                )
            if self._start is not None:
                own = self.bench.backend.capabilities
                left = StoredState(Checkpoint(own.name, own.cache_version, {}), self._start)
                self.status = Status(0, 0.0, len(self._start), self.status.kinetic)
            return KeptPacking(
                self.bench.lab,
                self.key,
                self.place,
                self.label,
                record=self._record(),
                status=self.status,
                left=left,
                earlier=self._seen if self.status.grains < self.scene.grains.count else None,
                remedy=self._closing(),
            )
        if self.may_save:
            self._write(left.checkpoint)
        if verdict == "late":
            self.max_time = self._longest
            if self._enters:
                raise JobFailed(
                    f"{self.label}: only {self._poured} of {self.scene.grains.count} grains have entered by "
                    f"{self.status.time:.3g} s. Raise fill.max_time (the filling goes on from here); if the bed has "
                    "risen into the region of fill.stream, move it up or use fewer grains."
                )
            raise JobFailed(
                f"{self.label}: not at rest after {self.status.time:.3g} s: {self._standing()}. "
                f"Raise fill.max_time (the filling goes on from here). If it never rests, {self._remedy()}."
            )
        if verdict == "hovering":
            raise JobFailed(
                f"{self.label}: the bed hovers: {self._standing()}, while its height stayed the same. "
                f"Remedy: {self._remedy()}. Its state is kept: the same command again lets the filling go on from here"
            )
        why = self._failure.message if self._failure else verdict
        raise JobFailed(f"{self.label}: {why} (while filling; the last good state is in {self.journal.folder})")

    def _closing(self) -> str:
        """What keeps grains in the container while it is filled."""
        if not self.scene.container.closes:
            return "close its outlet while it is filled by a part with opens: start, or add a wall where they leave"
        return "use a smaller numerics.dt or stiffer grains, so that none is pressed through a wall"

    def _record(self) -> PackingRecord:
        """Return the record without its ledger."""
        capabilities = self.bench.backend.capabilities
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
        """By the time that a filling is expected to take; settling has no end that can be seen coming."""
        return min(0.95, self.status.time / fill_time(self.demand))

    @property
    def open_ended(self) -> bool:
        """Whether it takes longer to settle than expected."""
        return not self._walls_move and self._for > self._usual

    @cached_property
    def _usual(self) -> float:
        """Time [s] in which a bed like this one is expected to come to rest."""
        return settling_time(self.demand)

    def doing(self) -> tuple[str, ...]:
        """The kinetic energy against that at rest, and the simulated time against the longest."""
        assert self.settled_below is not None
        if (mobilise := self.demand.filling.mobilise) is not None and self._walls_move:
            return (
                f"mobilising the friction of walls: {self._for:.2f} of {mobilise.time:.3g} s",
                f"{self.status.time:.2f} s",
            )
        if self._enters:
            entered = f"{self._poured} of {self.scene.grains.count} grains have entered"
            return entered, f"{self.status.time:.2f} s"
        now, below = short(self.status.kinetic), short(self.settled_below)
        return f"settling: {now} of m g d, rests below {below}", f"{self.status.time:.2f} of {self._longest:.3g} s"

    @property
    def label(self) -> str:
        """For people: the packing of which points, which seed."""
        return f"packing{self._serves and f' of {self._serves}'}, seed {self.demand.seed}"


@dataclass(frozen=True)
class KeptPacking(Kept):
    """A bed that has settled. record: without its ledger. earlier: time [s] and state of an earlier look,
    if grains are missing.
    remedy: what would keep its grains in the container."""

    record: PackingRecord
    status: Status
    left: EndState
    earlier: tuple[float, Packing] | None
    remedy: str

    def put(self) -> None:
        """Put it into the lab. Raises DiskFull, or JobFailed if grains have left."""
        if lost := losses(self.record.scene, self.status.time, self.left.packing, self.earlier):
            raise JobFailed(needs_all(self.label, lost, self.remedy))
        super().put()

    def fill_folder(self, folder: Path) -> None:
        """Arrays and record."""
        write_packing(folder, self._complete, self.left.packing)

    @cached_property
    def _complete(self) -> PackingRecord:
        """The record with its ledger."""
        counts = ledger(self.record.scene, self.status, self.left.packing)
        return self.record.model_copy(update={"ledger": counts})

    def entry(self) -> LabEntry:
        """Return the row of the packing, and the packing."""
        return LabEntry((packing_row(self.place, self._complete), []), (self._complete, self.left.packing))

    def reread(self) -> LabEntry:
        """Return the row of the packing, by its folder."""
        return LabEntry((packing_row(self.place), []))


def needs_all(label: str, lost: str, remedy: str) -> str:
    """Message that a filling has lost grains."""
    return f"{label}: {lost}. A discharge needs all grains: {remedy}"


def losses(
    scene: Scene, time: float, packing: Packing, before: tuple[float, Packing] | None, entered: int | None = None
) -> str:
    """Say how many grains have left the container, which, where and since when; empty if all are there.

    Args:
        scene: The closed scene.
        time: When [s] its grains were as in `packing`.
        packing: Its grains now.
        before: An earlier time [s], and its grains then.
        entered: How many grains have entered; None: all of them.
    """
    assert packing.ids is not None
    count, plane = entered or scene.grains.count, scene.container.outlet_plane
    missing = np.setdiff1d(np.arange(scene.grains.count), packing.ids)[: max(0, count - len(packing))]
    out = packing.ids[astray(scene, packing)]
    number = len(missing) + len(out)
    if not number:
        return ""
    when, known = (time, packing) if len(out) else before or (0.0, packing)
    assert known.ids is not None
    positions = known.x[np.isin(known.ids, out if len(out) else missing)]
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
    """A kinetic energy for people: 12, 0.3, 4e-5, 0."""
    return "0" if energy == 0 else f"{energy:.2g}" if energy >= 0.01 else f"{energy:.0e}".replace("e-0", "e-")


def _rounded_up(value: float) -> float:
    """To one digit."""
    if not 0 < value < math.inf:
        return math.inf
    unit = 10.0 ** math.floor(math.log10(value))
    return math.ceil(value / unit) * unit
