"""Members of one Spec, stepped one after the other."""

from collections.abc import Sequence

from labbook_dem import ensemble

from labbook.backend import Checkpoint, Event
from labbook.backend.numerics import Numerics
from labbook.scene import Scene
from labbook.scene.packing import Packing
from labbook_reference.member import Run


class Ensemble(ensemble.Ensemble[Run]):
    """See `labbook.backend.Ensemble`."""

    def _begin(self, scene: Scene, numerics: Numerics, start: Packing | Checkpoint) -> Run:
        if isinstance(start, Checkpoint):
            return Run.restored(self._can, scene, numerics, self._spec.probes, start)
        return Run.started(self._can, scene, numerics, self._spec.probes, start)

    def advance(self, beats: int = 1) -> Sequence[Event]:
        """Take `beats` beats with every member; failed and empty ones rest."""
        events: list[Event] = []
        for member, run in self._going().items():
            for _ in range(beats):
                if run.failure is not None or run.grains == 0:
                    break
                run.beat()
                self._keep(self._observed({member: run}))
                events += self._events(member, run)
        return events
