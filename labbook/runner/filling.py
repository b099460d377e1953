"""Making a packing: grains placed at random fall into the closed container until they rest."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from labbook.backend import Checkpoint, Ensemble, Event, Failed, Member, Settled
from labbook.catalogue.lab import Claim
from labbook.catalogue.packings import ARRAYS, PackingRecord
from labbook.keys import Keys, Maker
from labbook.plan.demand import Demand
from labbook.plan.forecast import fill_time
from labbook.probes import Probe, Table
from labbook.protocol import Packing, PlacingError, place
from labbook.runner.job import Bench, Job, JobFailed, failure
from labbook.runner.journal import Saved


class FillJob(Job):
    """The packing that a demand, and all that share its packing key, starts from."""

    kind = "packing"

    def __init__(self, bench: Bench, demand: Demand, keys: Keys, claim: Claim, serves: str = ""):
        """serves: the points whose runs start from it, in words; empty if those are all points."""
        self._serves = serves
        self._failure: Failed | None = None
        super().__init__(bench, demand, keys, keys.packing, bench.lab.packing(keys.packing), claim)
        self.scene = demand.shared.closed
        self.settled_below = demand.filling.settled_below
        self._longest = demand.point.fill.max_time

    def begin(self) -> Packing | Checkpoint:
        """As every job, but an engine never fills in another one's place. Raises JobFailed."""
        maker = self.demand.shared.maker
        if maker is not None and maker != Maker(self.bench.backend.capabilities, self.numerics):
            raise JobFailed(
                f"{self.label}: {maker.engine.name} has to make this packing first, in {maker.numerics.precision} "
                "precision"
            )
        return super().begin()

    def fresh(self) -> Packing:
        """Grains in the air."""
        try:
            return place(self.scene, self.demand.filling.kind, self.demand.seed)
        except PlacingError as error:
            raise JobFailed(f"{self.label}: {error}") from error

    def recall(self, saved: Saved | None) -> Saved | None:
        """As saved."""
        return saved

    def state(self) -> dict[str, Any]:
        """Nothing beside the step."""
        return {}

    def absorb(self, probe: Probe, table: Table) -> None:
        """Fillings observe nothing."""

    @property
    def may_save(self) -> bool:
        """Not while the engine counts beats at rest: that count is not in a checkpoint."""
        assert self.settled_below is not None
        return self.status.kinetic >= self.settled_below

    def verdict(self, events: Sequence[Event]) -> str | None:
        """Settled, stopped by a guard, or out of time."""
        self._failure = failure(events)
        if self._failure:
            return "failed"
        if any(isinstance(event, Settled) for event in events):
            return "settled"
        return "late" if self.status.time >= self._longest else None

    def finish(self, verdict: str, ensemble: Ensemble, member: Member) -> None:
        """Keep the packing; of a filling that came to nothing, the last state. Raises JobFailed for that."""
        if verdict == "settled":
            return super().finish(verdict, ensemble, member)
        self.save(ensemble, member)
        if verdict == "late":
            raise JobFailed(
                f"{self.label}: not at rest after {self.status.time:.3g} s: the kinetic energy per grain is "
                f"{self.status.kinetic:.2g} m g d, not below {self.settled_below:.2g}; "
                "raise fill.max_time (it goes on from here) or fill.settled_below"
            )
        why = self._failure.message if self._failure else verdict
        raise JobFailed(f"{self.label}: {why} (while filling; the last good state is in {self.journal.folder})")

    def fill_folder(self, folder: Path, verdict: str, ensemble: Ensemble, member: Member) -> None:
        """The packing and how it was made."""
        capabilities = self.bench.backend.capabilities
        record = PackingRecord(
            packing_key=self.key,
            closed_key=self.demand.shared.closed_key,
            engine=capabilities.name,
            cache_version=capabilities.cache_version,
            scene=self.scene,
            filling=vars(self.demand.filling),
            numerics=self.numerics,
            grains=self.scene.grains.count,
            duration=self.status.time,
            kinetic=self.status.kinetic,
            sessions=self.sessions(),
        )
        ensemble.packing(member).save(folder / ARRAYS)
        record.write(folder)

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


def short(energy: float) -> str:
    """A kinetic energy for people: 12, 0.3, 4e-5."""
    return f"{energy:.2g}" if energy >= 0.01 else f"{energy:.0e}".replace("e-0", "e-")
