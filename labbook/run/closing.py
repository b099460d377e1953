"""Work beside the ensembles: jobs whose last beat was taken are drawn, written and measured, and grains are placed.

On a GPU, where all jobs share one ensemble, it would stand still meanwhile; and members that began together end
together. So there several threads share what they leave, and each hands it to a process of its own after its first.
"""

import logging
import sys
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future, wait
from contextlib import suppress
from itertools import cycle
from queue import SimpleQueue

from labbook.backend import EndState
from labbook.filling import place
from labbook.run.aside import Aside, Gone
from labbook.run.board import Board, Ended, Placing
from labbook.run.fill import FillJob
from labbook.run.job import Job, JobFailed, Kept, LabEntry
from labbook.run.lane import Hand
from labbook.scene import Packing, Scene

_LOG = logging.getLogger("labbook")
MOST_GRAINS = 4_000_000  # grains of jobs that wait to be written: some gigabytes
_SETTLED_EVERY = 0.2
"""Time [s] within which jobs that were closed enter the index together."""
_PACKING, _RUN, _PLACING = range(3)
"""Ranks of the work of a thread."""
_AHEAD = 8
"""Fillings for each thread, at most, whose grains are being placed, or wait for their ensemble."""
_TURN = 1e-4
"""Time [s] for which a thread may keep the interpreter while others wait, instead of Python's 5 ms. The thread of a
lane gives it away at every call to the device, and would else wait for several that close jobs to get it back."""


class Closer:
    """A thread that closes one job after another: itself, or by the process that it begins at its second, or as soon as
    grains are to be placed."""

    def __init__(self, *, alone: bool):
        self._hand, self._alone = Hand("labbook-closing"), alone
        self._closed = 0
        self._aside: Aside | None = None

    def begin(self) -> None:
        """Start the process now, before there is anything to do."""
        self._hand.do(self._start)

    def _start(self) -> None:
        with suppress(Gone):  # whoever needs it tries again
            self._aside = self._aside or Aside()

    def close(self, job: Job, verdict: str, left: EndState) -> "Future[LabEntry]":
        """Put what a job `left` into the lab, and measure it; packings first, since runs wait for them."""
        rank = _PACKING if isinstance(job, FillJob) else _RUN
        return self._hand.do(lambda: self.put_in_place(job.kept(verdict, left)), rank)

    def place(self, closed: Scene, kind: str, seed: int) -> "Future[Packing]":
        """Place the grains of a filling, as `labbook.filling.place` does, once there is nothing to close."""
        return self._hand.do(lambda: self._placed(closed, kind, seed), _PLACING)

    def _placed(self, closed: Scene, kind: str, seed: int) -> Packing:
        if not self._alone:
            try:
                self._aside = self._aside or Aside()
                return self._aside.call(place, closed, kind, seed)
            except Gone as problem:
                self._lose(f"seed {seed}: placed", problem)
        return place(closed, kind, seed)

    def _lose(self, done: str, problem: Gone) -> None:
        self._aside, self._alone = None, True
        _LOG.warning("%s by this process, as the process beside it ended: %s", done, problem)

    def put_in_place(self, kept: Kept) -> LabEntry:
        self._closed += 1
        put = False
        if (self._closed > 1 or self._aside is not None) and not self._alone:
            try:
                self._aside = self._aside or Aside()
                self._aside.put(kept)
                put = True
                return self._aside.entry()
            except Gone as problem:
                self._lose(f"{kept.label}: {'measured' if put else 'written'}", problem)
        if put:
            return kept.reread()
        kept.put()
        return kept.entry()

    def end(self) -> None:
        """End thread and process, once they have done what they were given."""
        self._hand.end(lambda: None if self._aside is None else self._aside.end())


class Closing:
    """Jobs that are being closed. The board hears of each from the thread that asks for it by `settle` or `close`."""

    def __init__(self, board: Board, closers: Sequence[Closer]):
        self._board, self._closers = board, closers
        self._next = cycle(self._closers)
        self._jobs: dict[Future[LabEntry], tuple[Job, str]] = {}
        self._ended: SimpleQueue[Future[LabEntry]] = SimpleQueue()
        self._next_time = 0.0
        """Time [s] from which on the board hears of the next."""
        self._grains = 0
        """Of the jobs that are being closed."""
        self.wake = threading.Event()
        """Set when jobs that were closed are to be settled at once."""
        self._turn = sys.getswitchinterval()
        if len(closers) > 1:
            sys.setswitchinterval(_TURN)

    @property
    def jobs(self) -> list[Job]:
        """The jobs that the board has not heard of yet."""
        return [job for job, _ in self._jobs.values()]

    @property
    def placing(self) -> Placing | None:
        """Places grains beside the ensembles; None where one thread does all."""
        if len(self._closers) == 1:
            return None
        return Placing(self._place, _AHEAD * len(self._closers))

    def _place(self, closed: Scene, kind: str, seed: int) -> "Future[Packing]":
        """Let the next closer place the grains of a filling."""
        return next(self._next).place(closed, kind, seed)

    def close(self, job: Job, verdict: str, left: EndState) -> None:
        """Put what a job `left` into the lab, and measure it. Waits for others while too many grains are held. Raises
        what `settle` does."""
        self._grains += job.demand.point.scene.grains.count
        while self._jobs and self._grains > MOST_GRAINS:
            self.settle(wait_for_one=True)
        future = next(self._next).close(job, verdict, left)
        self._jobs[future] = job, verdict
        future.add_done_callback(self._has_ended)

    def _has_ended(self, future: "Future[LabEntry]") -> None:
        self._ended.put(future)
        if len(self._closers) == 1 or self._ended.qsize() >= len(self._jobs):  # others are settled together
            self.wake.set()

    def settle(self, *, wait_for_one: bool = False) -> bool:
        """Tell the board of all that are closed, at once; of one at least, if that is waited for. Returns True if there
        was any. Raises DiskFull.

        Where more are being closed, this is done now and then only: a transaction of the index takes some milliseconds.
        """
        now, ended = time.perf_counter(), list[Ended]()
        waiting = self._ended.qsize()
        if not wait_for_one and (not waiting or (now < self._next_time and waiting < len(self._jobs))):
            return False
        self._next_time = now + (_SETTLED_EVERY if len(self._closers) > 1 else 0.0)
        try:
            while wait_for_one or not self._ended.empty():
                future, wait_for_one = self._ended.get(), False
                job, verdict = self._jobs.pop(future)
                self._grains -= job.demand.point.scene.grains.count
                try:
                    ended.append((job, verdict, future.result()))
                except JobFailed as problem:
                    self._board.failed(job, str(problem))
        finally:  # a full disk ends the process, but not what was put into the lab before
            if ended:
                self._board.finished(ended)
        return True

    def settle_all(self) -> None:
        """Wait for all, and tell the board. Raises DiskFull."""
        while self._jobs:
            self.settle(wait_for_one=True)

    def end(self) -> None:
        """Wait for all, and tell nobody."""
        wait(self._jobs)
        sys.setswitchinterval(self._turn)
