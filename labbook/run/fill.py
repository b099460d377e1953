"""Making a packing: grains placed at random fall into the closed container until they rest."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labbook.backend import Checkpoint, Ensemble, Event, Failed, Member, Settled, Status
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe, Table
from labbook.filling import PlacingError, place
from labbook.filling.bed import at_rest
from labbook.lab.folder import Claim
from labbook.lab.identity import Keys
from labbook.lab.index import RunRows, packing_row
from labbook.lab.journal import PROGRESS, Saved
from labbook.lab.packings import ARRAYS, PackingRecord
from labbook.lab.records import Unreadable
from labbook.lab.tables import write_table
from labbook.run.demand import Demand, PackingsOf
from labbook.run.forecast import fill_time
from labbook.run.job import Bench, Job, JobFailed, Kept, Left, failure
from labbook.run.ledger import ledger
from labbook.scene import Packing
from labbook.scene.timescales import collision

_LOOK_EVERY = 20  # beats: a look copies the state of a member from its device
_LOOKS = 2  # on end that have to find it at rest
_REMEDY = "If it never rests, use a smaller numerics.dt, a larger fill.moving, or a larger fill.settled_below."


class FillJob(Job):
    """The packing that a demand, and all that share its packing key, starts from."""

    kind = "packing"

    def __init__(self, bench: Bench, demand: Demand, keys: Keys, claim: Claim, serves: str = ""):
        """serves: the points whose runs start from it, in words; empty if those are all points."""
        self._serves = serves
        self._failure: Failed | None = None
        self.made: KeptPacking | None = None
        """What it keeps, once it has settled."""
        super().__init__(bench, demand, keys, keys.packing, bench.lab.packing(keys.packing), claim)
        self.scene = demand.shared.closed
        self.settled_below = demand.filling.settled_below
        self._longest = demand.shared.longest_filling
        self._quiet = 0
        self._lowest, self._fell, self._warned = math.inf, 0.0, False

    def begin(self) -> Packing | Checkpoint:
        """As every job, but a backend never fills in another one's place. Raises JobFailed."""
        guest, own = self.demand.shared.packings_of, self.bench.backend.capabilities
        if guest is not None and guest != PackingsOf(own, self.demand.shared.numerics.precision):
            raise JobFailed(
                f"{self.label}: {guest.backend.name} has to make this packing first, in {guest.precision} precision"
            )
        return super().begin()

    @property
    def numerics(self) -> Numerics:
        """How it is computed."""
        return self.demand.shared.filled_by

    def fresh(self) -> Packing:
        """Grains in the air."""
        try:
            return place(self.scene, self.demand.filling.kind, self.demand.seed)
        except PlacingError as error:
            raise JobFailed(f"{self.label}: {error}") from error

    def recall(self, saved: Saved | None) -> Saved | None:
        """As saved. Raises Unreadable."""
        if saved is not None:
            self.check(saved, self.journal.folder)
            quiet = saved.state.get("quiet", 0)
            if type(quiet) is not int or not 0 <= quiet < _LOOKS:
                raise Unreadable(f"{self.journal.folder / PROGRESS}: state.quiet: {quiet} looks that found it at rest")
            self._quiet = quiet
        return saved

    def state(self) -> dict[str, Any]:
        """How often on end it was found at rest; why a guard stopped it, if one did."""
        return {"quiet": self._quiet} | ({"failed": self._failure.message} if self._failure else {})

    def after(
        self, status: Status, tables: Mapping[Probe, Table], wall: float, process: float, grain_steps: float
    ) -> None:
        """As every job; when the kinetic energy last fell to half of what it had been is noted."""
        super().after(status, tables, wall, process, grain_steps)
        if status.kinetic <= self._lowest / 2:
            self._lowest, self._fell = status.kinetic, status.time

    @property
    def stalled(self) -> bool:
        """Whether the kinetic energy has not halved for as long as a whole filling is expected to take."""
        usual = fill_time(self.demand)
        return self.status.time > 2 * usual and self.status.time - self._fell > usual

    def warning(self) -> str | None:
        """Said once, of a filling that does not seem to come to rest."""
        if self._warned or not self.stalled:
            return None
        self._warned = True
        return (
            f"{self.label}: does not seem to come to rest: {self._standing()}. The filling goes on until fill.max_time "
            f"({self._longest:g} s). {_REMEDY}"
        )

    def _standing(self) -> str:
        """Energy, threshold and step, in words."""
        part = self.numerics.dt / collision(self.scene.stiffened(self.numerics.stiffness_scale))
        return (
            f"at {self.status.time:.3g} s its kinetic energy is {short(self.status.kinetic)} m g d per grain, "
            f"at rest below {short(self.settled_below or 0)}, and has not halved since {self._fell:.3g} s; "
            f"the step is {self.numerics.dt:.3g} s, {part:.2g} of a collision"
        )

    def absorb(self, probe: Probe, table: Table) -> None:
        """Fillings observe nothing."""

    @property
    def may_save(self) -> bool:
        """Not while the backend counts beats at rest: that count is not in a checkpoint."""
        assert self.settled_below is not None
        return self.status.kinetic >= self.settled_below

    def look(self, ensemble: Ensemble, member: Member) -> None:
        """Where some grains may move, look now and then at each grain's speed."""
        moving = self.demand.filling.moving
        if moving == 0 or self.status.step % (_LOOK_EVERY * self.numerics.steps_per_beat):
            return
        assert self.settled_below is not None
        calm = at_rest(self.scene, ensemble.packing(member), self.settled_below, moving)
        self._quiet = self._quiet + 1 if calm else 0

    def verdict(self, events: Sequence[Event]) -> str | None:
        """Settled, stopped by a guard, or out of time."""
        self._failure = failure(events)
        if self._failure:
            return "failed"
        if self._quiet >= _LOOKS or any(isinstance(event, Settled) for event in events):
            return "settled"
        return "late" if self.status.time >= self._longest else None

    def kept(self, verdict: str, left: Left) -> "KeptPacking":
        """The packing; of a filling that came to nothing, the last state. Raises JobFailed for that."""
        if verdict == "settled":
            self.made = KeptPacking(self.bench.lab, self.key, self.place, self.label, self._record(left), left.packing)
            return self.made
        if self.may_save:
            self._write(left.checkpoint)
        if verdict == "late":
            raise JobFailed(
                f"{self.label}: not at rest after {self.status.time:.3g} s: {self._standing()}. "
                f"Raise fill.max_time (the filling goes on from here). {_REMEDY}"
            )
        why = self._failure.message if self._failure else verdict
        raise JobFailed(f"{self.label}: {why} (while filling; the last good state is in {self.journal.folder})")

    def _record(self, left: Left) -> PackingRecord:
        """How it was made."""
        capabilities = self.bench.backend.capabilities
        return PackingRecord(
            packing_key=self.key,
            closed_key=self.demand.shared.closed_key,
            backend=capabilities.name,
            cache_version=capabilities.cache_version,
            scene=self.scene,
            filling=self.demand.filling,
            numerics=self.numerics,
            grains=self.scene.grains.count,
            duration=self.status.time,
            kinetic=self.status.kinetic,
            ledger=ledger(self.scene, self.status, left.packing),
            sessions=self.sessions(),
        )

    def progress(self) -> float:
        """By the time that a filling is expected to take; settling has no end that can be seen coming."""
        return min(0.95, self.status.time / fill_time(self.demand))

    @property
    def open_ended(self) -> bool:
        """Whether it takes longer to settle than expected."""
        return self.status.time > fill_time(self.demand)

    def doing(self) -> tuple[str, ...]:
        """The kinetic energy against that at rest, and the simulated time against the longest."""
        assert self.settled_below is not None
        now, below = short(self.status.kinetic), short(self.settled_below)
        return f"settling: {now} of m g d, rests below {below}", f"{self.status.time:.2f} of {self._longest:g} s"

    @property
    def label(self) -> str:
        """For people: the packing of which points, which seed."""
        return f"packing{self._serves and f' of {self._serves}'}, seed {self.demand.seed}"


@dataclass(frozen=True)
class KeptPacking(Kept):
    """A packing, and how it was made."""

    record: PackingRecord
    packing: Packing

    def fill_folder(self, folder: Path) -> None:
        """Arrays and record."""
        write_table(folder / ARRAYS, self.packing.arrays())
        self.record.write(folder)

    def rows(self) -> RunRows:
        """The row of the packing."""
        return packing_row(self.place), []


def short(energy: float) -> str:
    """A kinetic energy for people: 12, 0.3, 4e-5."""
    return f"{energy:.2g}" if energy >= 0.01 else f"{energy:.0e}".replace("e-0", "e-")
