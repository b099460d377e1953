"""Members of one Spec, stepped one after the other, and what probes see of them."""

from collections.abc import Mapping, Sequence

import numpy as np
from labbook_dem import ensemble
from labbook_dem.features import specialise
from labbook_dem.ledger import totals
from labbook_dem.reading import Grains, read

from labbook.backend import Checkpoint, Event, Member, Status
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe, Table
from labbook.scene import Scene
from labbook.scene.packing import Packing
from labbook_reference.member import Run


class Ensemble(ensemble.Ensemble[Run]):
    """See `labbook.backend.Ensemble`."""

    def _specialise(self, scene: Scene, numerics: Numerics):
        return specialise(self._can, scene, numerics, self._spec.probes)

    def _begin(self, scene: Scene, numerics: Numerics, start: Packing | Checkpoint) -> Run:
        if isinstance(start, Checkpoint):
            return Run.restored(self._can, scene, numerics, self._spec.probes, start)
        return Run.started(self._can, scene, numerics, self._spec.probes, start)

    def _read(self, run: Run, beat: int) -> Mapping[Probe, Table]:
        return read(Seen(run), beat)

    def advance(self, beats: int = 1) -> Sequence[Event]:
        """Let every member take `beats` beats; those that failed or emptied rest."""
        events: list[Event] = []
        for member, run in self._going().items():
            for _ in range(beats):
                if run.failure is not None or run.grains == 0:
                    break
                run.beat()
                rows, found = self._after_beat(member, run)
                self._keep(member, rows)
                events += found
        return events

    def status(self, member: Member) -> Status:
        """Where a member stands."""
        return self._runs[member].status()

    def checkpoint(self, member: Member) -> Checkpoint:
        """The exact state of a member."""
        return self._runs[member].checkpoint()

    def packing(self, member: Member) -> Packing:
        """The portable state of a member."""
        return self._runs[member].packing()

    def close(self) -> None:
        """Free all arrays."""
        self._runs.clear()


class Seen:
    """A member, as probes see it; see `labbook_dem.reading.Readable`."""

    def __init__(self, run: Run):
        self._run = run
        self.probes: Sequence[Probe] = run.probes

    def clock(self) -> tuple[int, float]:
        """Step, and time [s]."""
        return self._run.step, self._run.time

    def crossings(self) -> np.ndarray:
        """First passages since the last call."""
        return self._run.crossings()

    def grains(self, moving: bool) -> Grains:
        """Its grains; v and w are always those of the whole step."""
        v, w = self._run.whole_step()
        return Grains(self._run.ids.copy(), self._run.x.copy(), v, w, self._run.q)

    def contacts(self) -> np.ndarray:
        """Its touching contacts."""
        return self._run.contacts()

    def totals(self) -> Mapping[str, float]:
        """Energies, momenta, and what the last step counted."""
        run = self._run
        v, w = run.whole_step()
        since_half = 0.5 * run.numerics.dt if run.step > 0 else 0.0
        bodies = run.bodies if run.scene.grains.varied else None
        found = totals(run.scene, run.x, v, run.momenta(w), run.v, run.m, since_half, run.work, run.q, bodies)
        last = {"max_overlap": run.max_overlap, "touching": run.touching, "rebuilds": 0}
        return {"grains": run.grains, **found, **last}
