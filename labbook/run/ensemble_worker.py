"""Workers: an ensemble with the thread that steps it.

On a CPU every core has a worker with one member, so that no run waits for another at the end of a beat. A GPU has a
worker for fillings and one for runs, each with all members of a Spec. They share a thread, in which their beats
alternate: runs are stepped while other beds settle, and grains of further ones are placed.
"""

import threading
import time
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Future
from contextlib import nullcontext
from dataclasses import dataclass, field
from itertools import count
from queue import PriorityQueue
from typing import TypeVar

import numpy as np

from labbook.backend import Backend, Checkpoint, Ensemble, Event, Member, Spec
from labbook.backend.probes import Probe, Table
from labbook.run.job import Job
from labbook.run.job_queue import StartedJob
from labbook.scene import Packing

T = TypeVar("T")

_compile_lock = threading.Lock()  # backends compile for a Spec in `open` or at its first beat: one thread at a time
_prepared: set[tuple[str, Spec, str]] = set()  # backend, Spec and device of which a beat was taken in this process


@dataclass
class BeatResult:
    """Result of one beat: events, and its cost [s]."""

    events: Sequence[Event]
    wall: float
    process: float
    """CPU time of the whole process [s]."""
    admitting: float = 0.0
    """Wall time for admitting new members before the beat, and for opening their ensemble [s]."""
    compiling: bool = False
    """True of the first beat of a Spec in this process, in which backends compile."""


_LAST_PRIORITY = 1 << 30
"""Priority of the last task of a thread."""


class WorkerThread:
    """A daemon thread that runs submitted tasks one after another."""

    def __init__(self, name: str = "labbook-worker") -> None:
        self._calls: PriorityQueue[tuple[int, int, Callable[[], None] | None]] = PriorityQueue()
        self._number = count()
        threading.Thread(target=self._work, name=name, daemon=True).start()

    def submit(self, call: Callable[[], T], priority: int = 0) -> "Future[T]":
        """Submit a task; tasks of lower priority numbers run first, equal ones in order. It can be cancelled before it
        starts."""
        future: Future[T] = Future()

        def carry_out() -> None:
            if not future.set_running_or_notify_cancel():
                return
            try:
                future.set_result(call())
            except BaseException as problem:  # for whoever waits for the result
                future.set_exception(problem)

        self._put(priority, carry_out)
        return future

    def end(self, last: Callable[[], None] = lambda: None) -> None:
        """Run `last` after all other tasks, and end the thread."""
        self._put(_LAST_PRIORITY, last)
        self._put(_LAST_PRIORITY, None)

    def _put(self, priority: int, call: Callable[[], None] | None) -> None:
        self._calls.put((priority, next(self._number), call))

    def _work(self) -> None:
        while call := self._calls.get()[2]:
            call()


@dataclass(eq=False)
class EnsembleWorker:
    """An ensemble, the jobs of its members, and the thread that steps them.

    Attributes:
        slots: Maximum number of members.
        kinds: Kinds of jobs that it takes.
        thread: Its thread.
        opened: Number of members for which its ensemble is laid out; 0 without one.
        jobs: Jobs, by member.
        spec: Spec of its ensemble; None without one.
        preparing: Its kernels are being compiled or loaded. Its jobs have taken no step yet: there is nothing to save.
        saving: Wall time for saving active jobs [s].
    """

    backend: Backend
    device: str
    slots: int
    kinds: Collection[str]
    thread: WorkerThread
    opened: int = 0
    jobs: dict[Member, Job] = field(default_factory=dict)
    spec: Spec | None = None
    ensemble: Ensemble | None = None
    preparing: bool = False
    saving: float = 0.0

    def start(self, new: Sequence[StartedJob], expected: int = 0) -> "Future[BeatResult]":
        """Submit a beat to the worker's thread, after admitting new jobs.

        Args:
            new: Jobs of one Spec, the present one if the worker has jobs.
            expected: Number of members for which a new ensemble is laid out. On a GPU it grows for more, which costs as
                much as opening another one.
        """
        spec = new[0].spec if new else self.spec
        assert spec is not None
        if spec != self.spec:
            self.opened = min(self.slots, expected)
        self.opened = max(self.opened, len(self.jobs) + len(new))
        configuration = spec.backend, spec, self.device
        self.preparing = configuration not in _prepared
        return self.thread.submit(lambda: self._run_beat(new, configuration))

    def _run_beat(self, new: Sequence[StartedJob], configuration: tuple[str, Spec, str]) -> BeatResult:
        start = time.perf_counter()
        # all in the worker's thread, also the opening of an ensemble: a GPU is never used by two threads
        for started in new:
            self._admit(started)
        admitting = time.perf_counter() - start
        with nullcontext() if configuration in _prepared else _compile_lock:
            compiling = configuration not in _prepared
            turn = self._beat()
        turn.admitting, turn.compiling = admitting, compiling
        _prepared.add(configuration)
        self.preparing = False
        return turn

    def _beat(self) -> BeatResult:
        assert self.ensemble is not None
        wall, process = time.perf_counter(), time.process_time()
        events = self.ensemble.advance(1)
        return BeatResult(events, time.perf_counter() - wall, time.process_time() - process)

    def _admit(self, started: StartedJob) -> None:
        # of another Spec only once the former members have ended: `start` takes jobs of one Spec
        if self.spec != started.spec or self.ensemble is None:
            assert not self.jobs
            self.close()
            with _compile_lock:
                slots = self.slots if self.device == "cpu" else self.opened
                self.ensemble = self.backend.open(started.spec, slots, self.device)
            self.spec = started.spec
        self._admit_member(started.job, started.start)

    def _admit_member(self, job: Job, start: Packing | Checkpoint) -> None:
        assert self.ensemble is not None
        member = self.ensemble.admit(
            job.stepped,
            job.numerics,
            start,
            settled_below=job.settled_below,
            settled_beats=job.settled_beats,
            probes=job.probes,
        )
        job.status = job.status_of(self.ensemble, member)
        self.jobs[member] = job

    def rows(self) -> dict[Member, dict[Probe, Table]]:
        """Return the rows since the last call, by member and probe; tables without rows are included."""
        assert self.ensemble is not None
        by_member: dict[Member, dict[Probe, Table]] = {member: {} for member in self.jobs}
        for probe, table in self.ensemble.drain().items():
            member_index = np.asarray(table["member"])
            order = np.argsort(member_index, kind="stable")  # stable: rows of a member keep their order in time
            first, end = (
                np.searchsorted(member_index[order], [m.index for m in by_member], side) for side in ("left", "right")
            )
            columns = {name: np.asarray(column)[order] for name, column in table.items() if name != "member"}
            no_rows = {name: column[:0] for name, column in columns.items()}
            for (member, tables), a, b in zip(by_member.items(), first.tolist(), end.tolist(), strict=True):
                if probe in self.jobs[member].probes:
                    rows = {name: column[a:b] for name, column in columns.items()} if a < b else no_rows
                    tables[probe] = rows
        return by_member

    def change_scene(self, member: Member) -> None:
        """Move a job to the scene of its next stage, from its exact state; step and time continue."""
        assert self.ensemble is not None
        # from the checkpoint: a run does not continue bit for bit from a packing
        job, state = self.jobs[member], self.ensemble.checkpoint(member)
        self.retire(member)
        self._admit_member(job, state)

    def retire(self, member: Member) -> None:
        """Free the slot of a member."""
        assert self.ensemble is not None
        self.ensemble.retire(member)
        del self.jobs[member]

    def free_ensemble(self) -> None:
        """Close the ensemble, which has no members, in the worker's thread: a GPU is never used by two threads."""
        ensemble, self.ensemble, self.spec, self.opened = self.ensemble, None, None, 0
        if ensemble is not None:
            self.thread.submit(ensemble.close)

    def close(self) -> None:
        """Close the ensemble; called in the worker's thread."""
        if self.ensemble is not None:
            self.ensemble.close()
        self.ensemble, self.spec = None, None
