"""A lane: one ensemble, and the thread that steps it.

On a CPU every core has a lane with one member and a thread of its own, so that no run waits for another at the end of
a beat. A GPU has a lane for fillings and a lane for runs, each with all members of a Spec. Their thread lets them take
turns: runs go on while other beds settle, and grains of further ones are placed.
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
from labbook.run.board import Started
from labbook.run.job import Job
from labbook.scene import Packing

T = TypeVar("T")

_preparing = threading.Lock()  # backends compile for a Spec in `open` or at its first beat: one thread at a time
_used: set[tuple[str, Spec, str]] = set()  # backend, Spec and device of which a beat was taken in this process


@dataclass
class Turn:
    """What one turn gave: events, and its cost [s]."""

    events: Sequence[Event]
    wall: float
    process: float
    """Processor time of the whole process meanwhile."""
    admitting: float = 0.0
    """Wall time before: of the members that came, and of their ensemble."""


_LAST = 1 << 30
"""Rank of what a thread does before it ends."""


class Hand:
    """A thread that does one thing after another. It does not keep the process from ending."""

    def __init__(self, name: str = "labbook-lane") -> None:
        self._calls: PriorityQueue[tuple[int, int, Callable[[], None] | None]] = PriorityQueue()
        self._number = count()
        threading.Thread(target=self._work, name=name, daemon=True).start()

    def do(self, call: Callable[[], T], rank: int = 0) -> "Future[T]":
        """Do this after all of the same and of lower ranks; never, if the future is cancelled before."""
        future: Future[T] = Future()

        def carry_out() -> None:
            if not future.set_running_or_notify_cancel():
                return
            try:
                future.set_result(call())
            except BaseException as problem:  # for whoever waits for the result
                future.set_exception(problem)

        self._put(rank, carry_out)
        return future

    def end(self, last: Callable[[], None] = lambda: None) -> None:
        """Do this `last`, once everything else is done, and end."""
        self._put(_LAST, last)
        self._put(_LAST, None)

    def _put(self, rank: int, call: Callable[[], None] | None) -> None:
        self._calls.put((rank, next(self._number), call))

    def _work(self) -> None:
        while call := self._calls.get()[2]:
            call()


@dataclass(eq=False)
class Lane:
    """An ensemble and the jobs of its members.

    Attributes:
        slots: Members at once, at most.
        kinds: Kinds of jobs that it takes.
        hand: Its thread.
        opened: Members for which its ensemble is laid out; 0 without one.
    """

    backend: Backend
    device: str
    slots: int
    kinds: Collection[str]
    hand: Hand
    opened: int = 0
    jobs: dict[Member, Job] = field(default_factory=dict)
    spec: Spec | None = None
    ensemble: Ensemble | None = None
    preparing: bool = False
    """Whether its kernels are being compiled or loaded. Its jobs have taken no step then: there is nothing to save."""
    saving: float = 0.0
    """Wall time that went into saving its jobs while they were going on [s]."""

    def start(self, new: Sequence[Started], expected: int = 0) -> "Future[Turn]":
        """Admit `new` and take one beat, in the lane's thread.

        Args:
            new: Jobs of one Spec, the lane's own if it has jobs.
            expected: Members for which an ensemble is laid out, if one has to be opened. On a GPU it grows for more,
                which costs as much as to open another one.
        """
        spec = new[0].spec if new else self.spec
        assert spec is not None
        if spec != self.spec:
            self.opened = min(self.slots, expected)
        self.opened = max(self.opened, len(self.jobs) + len(new))
        use = spec.backend, spec, self.device
        self.preparing = use not in _used
        return self.hand.do(lambda: self._turn(new, use))

    def _turn(self, new: Sequence[Started], use: tuple[str, Spec, str]) -> Turn:
        begun = time.perf_counter()
        for started in new:
            self._admit(started)
        admitting = time.perf_counter() - begun
        with nullcontext() if use in _used else _preparing:
            turn = self._beat()
        turn.admitting = admitting
        _used.add(use)
        self.preparing = False
        return turn

    def _beat(self) -> Turn:
        assert self.ensemble is not None
        wall, process = time.perf_counter(), time.process_time()
        events = self.ensemble.advance(1)
        return Turn(events, time.perf_counter() - wall, time.process_time() - process)

    def _admit(self, started: Started) -> None:
        if self.spec != started.spec or self.ensemble is None:
            assert not self.jobs
            self.close()
            with _preparing:
                slots = self.slots if self.device == "cpu" else self.opened
                self.ensemble = self.backend.open(started.spec, slots, self.device)
            self.spec = started.spec
        self._enter(started.job, started.start)

    def _enter(self, job: Job, start: Packing | Checkpoint) -> None:
        assert self.ensemble is not None
        member = self.ensemble.admit(
            job.stepped,
            job.numerics,
            start,
            settled_below=job.settled_below,
            settled_beats=job.settled_beats,
            probes=job.probes,
        )
        job.status = self.ensemble.status(member)
        self.jobs[member] = job

    def rows(self) -> dict[Member, dict[Probe, Table]]:
        """Rows since the last call, by member; of every probe that it is read by, also where there are none."""
        assert self.ensemble is not None
        found: dict[Member, dict[Probe, Table]] = {member: {} for member in self.jobs}
        for probe, table in self.ensemble.drain().items():
            of = np.asarray(table["member"])
            order = np.argsort(of, kind="stable")
            first, end = (np.searchsorted(of[order], [m.index for m in found], side) for side in ("left", "right"))
            columns = {name: np.asarray(column)[order] for name, column in table.items() if name != "member"}
            for (member, tables), a, b in zip(found.items(), first, end, strict=True):
                if probe in self.jobs[member].probes:
                    tables[probe] = {name: column[a:b] for name, column in columns.items()}
        return found

    def change_scene(self, member: Member) -> None:
        """Let a job go on in the scene of its next stage, from its exact state: step and time go on too."""
        assert self.ensemble is not None
        job, state = self.jobs[member], self.ensemble.checkpoint(member)
        self.retire(member)
        self._enter(job, state)

    def retire(self, member: Member) -> None:
        """Free a member's slot."""
        assert self.ensemble is not None
        self.ensemble.retire(member)
        del self.jobs[member]

    def rest(self) -> None:
        """Free the ensemble, whose members have all ended, in the lane's thread: a GPU is never used by two threads."""
        ensemble, self.ensemble, self.spec, self.opened = self.ensemble, None, None, 0
        if ensemble is not None:
            self.hand.do(ensemble.close)

    def close(self) -> None:
        """Free the ensemble, in the lane's thread."""
        if self.ensemble is not None:
            self.ensemble.close()
        self.ensemble, self.spec = None, None
