"""A lane: one ensemble, stepped in a thread of its own.

On a CPU every core gets a lane with one member, so that no run waits for another at the end of a beat; on a
GPU one lane holds all members of a Spec.
"""

import threading
import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field

import numpy as np

from labbook.backend import Backend, Ensemble, Event, Member, Spec
from labbook.probes import Probe, Table
from labbook.runner.board import Started
from labbook.runner.job import Job

_preparing = threading.Lock()  # engines compile for a Spec in `open` or at its first beat: one thread at a time
_used: set[tuple[str, Spec, str]] = set()  # engine, Spec and device of which a beat was taken in this process


@dataclass
class Turn:
    """What one turn gave: events, and its cost [s]."""

    events: Sequence[Event]
    wall: float
    process: float
    """Processor time of the whole process meanwhile."""


@dataclass(eq=False)
class Lane:
    """An ensemble and the jobs of its members. `slots`: how many members it takes."""

    backend: Backend
    device: str
    slots: int
    jobs: dict[Member, Job] = field(default_factory=dict)
    spec: Spec | None = None
    ensemble: Ensemble | None = None

    def turn(self, new: Sequence[Started]) -> Turn:
        """Admit `new` and take one beat."""
        for started in new:
            self._admit(started)
        assert self.spec is not None
        use = self.spec.engine, self.spec, self.device
        with nullcontext() if use in _used else _preparing:
            turn = self._beat()
        _used.add(use)
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
        member = self.ensemble.admit(job.scene, job.numerics, started.start, settled_below=job.settled_below)
        job.status = self.ensemble.status(member)
        self.jobs[member] = job

    def rows(self) -> dict[Member, dict[Probe, Table]]:
        """Rows since the last call, by member; of every probe, also where there are none."""
        assert self.ensemble is not None
        found: dict[Member, dict[Probe, Table]] = {member: {} for member in self.jobs}
        for probe, table in self.ensemble.drain().items():
            of = np.asarray(table["member"])
            columns = {name: np.asarray(column) for name, column in table.items() if name != "member"}
            for member, tables in found.items():
                mine = of == member.index
                if mine.all():
                    tables[probe] = columns
                else:
                    tables[probe] = {name: column[mine] for name, column in columns.items()}
        return found

    def retire(self, member: Member) -> None:
        """Free a member's slot."""
        assert self.ensemble is not None
        self.ensemble.retire(member)
        del self.jobs[member]

    def close(self) -> None:
        """Free the ensemble."""
        if self.ensemble is not None:
            self.ensemble.close()
        self.ensemble, self.spec = None, None
