"""Jobs whose last beat was taken: threads of their own draw, write and measure them while others go on.

On a GPU, where all jobs share one ensemble, it would stand still meanwhile; and members that began together end
together, so that there several threads share what they leave. Drawing, the larger part, needs the interpreter little.
"""

import sys
from collections.abc import Iterable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from itertools import cycle

from labbook.lab.index import RunRows
from labbook.run.board import Board
from labbook.run.job import Job, JobFailed, Left
from labbook.run.lane import Hand

_HELD = 4_000_000  # grains of jobs that wait to be written: some gigabytes
_TURN = 1e-4
"""Time [s] for which a thread may keep the interpreter while others wait, instead of Python's 5 ms. The thread of a lane
gives it away at every call to the device, and would else wait for several of those that close jobs to get it back."""


class Closing:
    """Jobs that are being closed. The board hears of each from the thread that asks for it by `settle` or `close`."""

    def __init__(self, board: Board, threads: int):
        self._board, self._hands = board, [Hand("labbook-closing") for _ in range(threads)]
        self._next = cycle(self._hands)
        self._jobs: dict[Future[RunRows], tuple[Job, str]] = {}
        self._turn = sys.getswitchinterval()
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
        while self._jobs and sum(one.scene.grains.count for one in (job, *self.jobs)) > _HELD:
            wait(self._jobs, return_when=FIRST_COMPLETED)
            self.settle()
        self._jobs[next(self._next).do(lambda: self._close(job, verdict, left))] = job, verdict

    def _close(self, job: Job, verdict: str, left: Left) -> RunRows:
        job.finish(verdict, left)
        return self._board.read(job)

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
        for hand in self._hands:
            hand.end()
        sys.setswitchinterval(self._turn)
