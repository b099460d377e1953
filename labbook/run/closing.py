"""Jobs whose last beat was taken: they are drawn, written and measured while others go on.

On a GPU, where all jobs share one ensemble, it would stand still meanwhile; and members that began together end
together. So there several threads share what they leave, and each hands it to a process of its own after its first.
"""

import logging
import sys
from collections.abc import Iterable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from itertools import cycle

from labbook.lab.index import RunRows
from labbook.run.aside import Aside, Gone
from labbook.run.board import Board
from labbook.run.job import Job, JobFailed, Kept, Left
from labbook.run.lane import Hand

_LOG = logging.getLogger("labbook")
MOST_GRAINS = 4_000_000  # grains of jobs that wait to be written: some gigabytes
_TURN = 1e-4
"""Time [s] for which a thread may keep the interpreter while others wait, instead of Python's 5 ms. The thread of a
lane gives it away at every call to the device, and would else wait for several that close jobs to get it back."""


class Closer:
    """A thread that closes one job after another: itself, or by the process that it begins at its second."""

    def __init__(self, *, alone: bool):
        self._hand, self._alone = Hand("labbook-closing"), alone
        self._closed = 0
        self._aside: Aside | None = None

    def close(self, job: Job, verdict: str, left: Left) -> "Future[RunRows]":
        """Put what a job `left` into the lab, and measure it."""
        return self._hand.do(lambda: self.put_in_place(job.kept(verdict, left)))

    def put_in_place(self, kept: Kept) -> RunRows:
        self._closed += 1
        put = False
        if self._closed > 1 and not self._alone:
            try:
                self._aside = self._aside or Aside()
                self._aside.put(kept)
                put = True
                return self._aside.rows()
            except Gone as problem:
                self._aside, self._alone = None, True
                done = "measured" if put else "written"
                _LOG.warning("%s: %s by this process, as the writing process ended: %s", kept.label, done, problem)
        if not put:
            kept.put()
        return kept.rows()

    def end(self) -> None:
        """End thread and process, once they have done what they were given."""
        self._hand.end(lambda: None if self._aside is None else self._aside.end())


class Closing:
    """Jobs that are being closed. The board hears of each from the thread that asks for it by `settle` or `close`."""

    def __init__(self, board: Board, threads: int):
        self._board = board
        self._closers = [Closer(alone=threads == 1) for _ in range(threads)]
        self._next = cycle(self._closers)
        self._jobs: dict[Future[RunRows], tuple[Job, str]] = {}
        self._turn = sys.getswitchinterval()
        if threads > 1:
            sys.setswitchinterval(_TURN)

    @property
    def jobs(self) -> list[Job]:
        """The jobs that the board has not heard of yet."""
        return [job for job, _ in self._jobs.values()]

    @property
    def futures(self) -> Iterable[Future[RunRows]]:
        """To wait for."""
        return self._jobs.keys()

    def close(self, job: Job, verdict: str, left: Left) -> None:
        """Put what a job `left` into the lab, and measure it. Waits for others while too many grains are held. Raises
        what `settle` does."""
        while self._jobs and sum(one.scene.grains.count for one in (job, *self.jobs)) > MOST_GRAINS:
            wait(self._jobs, return_when=FIRST_COMPLETED)
            self.settle()
        self._jobs[next(self._next).close(job, verdict, left)] = job, verdict

    def settle(self) -> None:
        """Tell the board of all that are closed. Raises DiskFull."""
        for future in [future for future in self._jobs if future.done()]:
            job, verdict = self._jobs.pop(future)
            try:
                found = future.result()
            except JobFailed as problem:
                self._board.failed(job, str(problem))
            else:
                self._board.finished(job, verdict, found)

    def settle_all(self) -> None:
        """Wait for all, and tell the board. Raises DiskFull."""
        wait(self._jobs)
        self.settle()

    def end(self) -> None:
        """Wait for all, tell nobody, and end the threads."""
        wait(self._jobs)
        for closer in self._closers:
            closer.end()
        sys.setswitchinterval(self._turn)
