"""A lane: one ensemble, stepped in a thread of its own.

On a CPU every core gets a lane with one member, so that no run waits for another at the end of a beat; on a
GPU one lane holds all members of a Spec.
"""

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import nullcontext
from dataclasses import dataclass, field
from queue import SimpleQueue
from typing import TypeVar

import numpy as np

from labbook.backend import Backend, Ensemble, Event, Member, Spec
from labbook.backend.probes import Probe, Table
from labbook.run.board import Started
from labbook.run.job import Job

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


class Hand:
    """A thread that does one thing after another. It does not keep the process from ending."""

    def __init__(self, name: str = "labbook-lane") -> None:
        self._calls: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        threading.Thread(target=self._work, name=name, daemon=True).start()

    def do(self, call: Callable[[], T]) -> "Future[T]":
        """Do this next."""
        future: Future[T] = Future()

        def carry_out() -> None:
            try:
                future.set_result(call())
            except BaseException as problem:  # for whoever waits for the result
                future.set_exception(problem)

        self._calls.put(carry_out)
        return future

    def end(self, last: Callable[[], None] = lambda: None) -> None:
        """Do this `last`, once everything else is done, and end."""
        self._calls.put(last)
        self._calls.put(None)

    def _work(self) -> None:
        while call := self._calls.get():
            call()


@dataclass(eq=False)
class Lane:
    """An ensemble and the jobs of its members. `slots`: how many members it takes."""

    backend: Backend
    device: str
    slots: int
    jobs: dict[Member, Job] = field(default_factory=dict)
    spec: Spec | None = None
    ensemble: Ensemble | None = None
    preparing: bool = False
    """Whether its kernels are being compiled or loaded. Its jobs have taken no step then: there is nothing to save."""
    saving: float = 0.0
    """Wall time that went into saving its jobs while they were going on [s]."""
    _hand: Hand = field(default_factory=Hand)

    def start(self, new: Sequence[Started]) -> "Future[Turn]":
        """Admit `new` and take one beat, in the lane's thread."""
        spec = new[0].spec if new else self.spec
        assert spec is not None
        use = spec.backend, spec, self.device
        self.preparing = use not in _used
        return self._hand.do(lambda: self._turn(new, use))

    def _turn(self, new: Sequence[Started], use: tuple[str, Spec, str]) -> Turn:
        for started in new:
            self._admit(started)
        with nullcontext() if use in _used else _preparing:
            turn = self._beat()
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
                slots = self.slots if self.device == "cpu" else None
                self.ensemble = self.backend.open(started.spec, slots, self.device)
            self.spec = started.spec
        job = started.job
        member = self.ensemble.admit(
            job.scene,
            job.numerics,
            started.start,
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

    def retire(self, member: Member) -> None:
        """Free a member's slot."""
        assert self.ensemble is not None
        self.ensemble.retire(member)
        del self.jobs[member]

    def end(self) -> None:
        """Free the ensemble and the thread, once the turn that is going on has ended; does not wait for that."""
        self._hand.end(self.close)

    def close(self) -> None:
        """Free the ensemble."""
        if self.ensemble is not None:
            self.ensemble.close()
        self.ensemble, self.spec = None, None
