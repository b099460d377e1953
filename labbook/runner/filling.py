"""Making a packing: grains placed at random fall into the closed container until they rest."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from labbook.backend import Checkpoint, Ensemble, Event, Member, Settled
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

    kind = "filling"

    def __init__(self, bench: Bench, demand: Demand, keys: Keys, claim: Claim):
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
        """As saved. Raises Unreadable."""
        if saved is not None:
            self.check(saved, self.journal.folder)
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
        if failure(events):
            return str(failure(events))
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
        raise JobFailed(f"{self.label}: {verdict}; its last good state is in {self.journal.folder}")

    def fill_folder(self, folder: Path, verdict: str, ensemble: Ensemble, member: Member) -> None:
        """The packing and how it was made."""
        capabilities = self.bench.backend.capabilities
        record = PackingRecord(
            packing_key=self.key,
            closed_key=self.demand.shared.closed_key,
            engine=capabilities.name,
            cache_version=capabilities.cache_version,
            scene=self.scene,
            filling=self.demand.filling,
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
