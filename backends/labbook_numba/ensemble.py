"""Members of one Spec, stepped in parallel on the cores of a CPU."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from types import ModuleType

from labbook_dem import ensemble

from labbook.backend import Capabilities, Checkpoint, Event, Member, Spec
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe, Table
from labbook.scene import Scene
from labbook.scene.packing import Packing
from labbook_numba import domains
from labbook_numba.member import Run


class Ensemble(ensemble.Ensemble[Run]):
    """Members on threads without the interpreter's lock; see `labbook.backend.Ensemble`.

    Args:
        capabilities: capabilities of the backend.
        spec: features.
        kernels: kernel module.
        members: members that take a beat at the same time.
        threads: threads for one large member.
    """

    def __init__(self, capabilities: Capabilities, spec: Spec, kernels: ModuleType, members: int, threads: int):
        super().__init__(capabilities, spec)
        self._kernels = kernels
        self._pool = ThreadPoolExecutor(members, thread_name_prefix="labbook-numba")
        # contact work is one sum in the order of grains: threads would split it
        self._threads = 1 if spec.feature("LEDGER") else threads
        self._large = domains.LARGE_RODS if spec.feature("ORIENTED") else domains.LARGE

    def _begin(self, scene: Scene, numerics: Numerics, start: Packing | Checkpoint) -> Run:
        run = Run(self._can, self._kernels, scene, numerics, self._spec.probes)
        if isinstance(start, Checkpoint):
            run.restore(start)
        else:
            run.start(start)
        return run

    def advance(self, beats: int = 1) -> Sequence[Event]:
        """Take `beats` beats with every member; failed and empty ones rest."""
        events: list[Event] = []
        jobs = [self._pool.submit(self._take, member, run, beats) for member, run in self._going().items()]
        for job in jobs:
            for rows, new_events in job.result():
                self._keep(rows)
                events += new_events
        return events

    def _take(self, member: Member, run: Run, beats: int) -> list[tuple[Mapping[Probe, Table], list[Event]]]:
        observed_beats = []
        while len(observed_beats) < beats and run.failure is None and run.grains > 0:
            with domains.threads_for(run.grains, self._threads, self._large) as threads:
                run.beat(threads)
            observed_beats.append((self._observed({member: run}), self._events(member, run)))
        return observed_beats

    def close(self) -> None:
        """Free threads and arrays."""
        self._pool.shutdown()
        super().close()
