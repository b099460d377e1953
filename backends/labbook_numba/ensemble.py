"""Members of one Spec, stepped side by side on the cores of a CPU."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from types import ModuleType

import numpy as np

from labbook.backend import (
    Capabilities,
    Checkpoint,
    Emptied,
    Event,
    Failed,
    Member,
    Probe,
    Settled,
    Spec,
    Status,
    Table,
    empty_table,
)
from labbook.numerics import Numerics
from labbook.protocol.packing import Packing
from labbook.scene import Scene
from labbook_numba.member import Run
from labbook_numba.parts import threads_for
from labbook_numba.reading import read
from labbook_numba.specialise import specialise


class Ensemble:
    """See `labbook.backend.Ensemble`. Each member runs on a thread of its own, without the interpreter's lock.

    `members` take a beat at the same time; a large one may be split among `threads` more or less idle cores.
    """

    def __init__(self, capabilities: Capabilities, spec: Spec, kernels: ModuleType, members: int, threads: int):
        self._can, self._spec, self._kernels = capabilities, spec, kernels
        self._pool = ThreadPoolExecutor(members, thread_name_prefix="labbook-numba")
        # the ledger's work is a sum over grains in their order
        self._threads = 1 if spec.feature("LEDGER") else threads
        self._runs: dict[Member, Run] = {}
        self._settling: dict[Member, tuple[float, int, int]] = {}
        self._rows: dict[Probe, list[Table]] = defaultdict(list)
        self._next = 0

    def admit(
        self,
        scene: Scene,
        numerics: Numerics,
        start: Packing | Checkpoint,
        *,
        settled_below: float | None = None,
        settled_beats: int = 3,
    ) -> Member:
        """Add a member. Raises ValueError if it needs another Spec than this ensemble's."""
        if specialise(self._can, scene, numerics, self._spec.probes) != self._spec:
            raise ValueError("this member needs another specialisation than the ensemble's")
        run = Run(self._can.name, self._can.cache_version, self._kernels, scene, numerics, self._spec.probes)
        if isinstance(start, Checkpoint):
            run.restore(start)
        else:
            run.start(start)
        member = Member(self._next)
        self._next += 1
        self._runs[member] = run
        if settled_below is not None:
            self._settling[member] = (settled_below, settled_beats, 0)
        return member

    def advance(self, beats: int = 1) -> Sequence[Event]:
        """Let every member take `beats` beats; those that failed or emptied rest."""
        resting = [member for member, run in self._runs.items() if run.failure or run.empty]
        going = {member: run for member, run in self._runs.items() if member not in resting}
        events: list[Event] = []
        jobs = {member: self._pool.submit(self._take, member, run, beats) for member, run in going.items()}
        for member, job in jobs.items():
            rows, found = job.result()
            for probe, table in rows:
                size = len(table["step"])
                if size:
                    self._rows[probe].append({"member": np.full(size, member.index), **table})
            events += found
        return events

    def _take(self, member: Member, run: Run, beats: int) -> tuple[list[tuple[Probe, Table]], list[Event]]:
        rows: list[tuple[Probe, Table]] = []
        events: list[Event] = []
        for _ in range(beats):
            with threads_for(run.grains, self._threads) as threads:
                run.beat(threads)
            if run.failure:
                guard, step, grain, message = run.failure
                return rows, [*events, Failed(member, guard, step, grain, message)]
            rows += read(run, run.step // self._spec.steps_per_beat).items()
            if run.empty:
                return rows, [*events, Emptied(member, run.step * run.params.dt)]
            if member in self._settling and self._is_settled(member, run):
                events.append(Settled(member, run.step * run.params.dt))
        return rows, events

    def _is_settled(self, member: Member, run: Run) -> bool:
        below, needed, seen = self._settling[member]
        seen = seen + 1 if run.status().kinetic < below else 0
        self._settling[member] = (below, needed, seen)
        return seen == needed

    def drain(self) -> Mapping[Probe, Table]:
        """Rows since the last drain, of every declared probe."""
        rows, self._rows = self._rows, defaultdict(list)
        return {probe: _joined(rows[probe] or [empty_table(probe)]) for probe in self._spec.probes}

    def status(self, member: Member) -> Status:
        """Where a member stands."""
        return self._runs[member].status()

    def checkpoint(self, member: Member) -> Checkpoint:
        """The exact state of a member."""
        return self._runs[member].checkpoint()

    def packing(self, member: Member) -> Packing:
        """The portable state of a member."""
        return self._runs[member].packing()

    def retire(self, member: Member) -> None:
        """Drop a member."""
        del self._runs[member]
        self._settling.pop(member, None)

    def close(self) -> None:
        """Free threads and arrays."""
        self._pool.shutdown()
        self._runs.clear()


def _joined(tables: list[Table]) -> Table:
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
