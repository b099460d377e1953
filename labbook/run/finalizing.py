"""Finalization of jobs after their last beat: they are drawn, written and measured; and placing of grains.

On a GPU all jobs share one ensemble, which would stand still meanwhile, and members that began together end together.
So several threads share this work there. Each has a helper process of its own, after its first job.
"""

import logging
import sys
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future, wait
from itertools import cycle
from queue import SimpleQueue

from labbook.backend import EndState
from labbook.filling import place
from labbook.run.ensemble_worker import WorkerThread
from labbook.run.fill import FillJob
from labbook.run.helper import HelperLost, HelperProcess, idle_helpers, load_packages
from labbook.run.job import Job, JobFailed, JobOutput, LabEntry
from labbook.run.job_queue import EndedJob, JobQueue, PlacingPool
from labbook.scene import Packing, Scene

_LOG = logging.getLogger("labbook")
MAX_HELD_GRAINS = 4_000_000  # grains of jobs that wait to be written: some gigabytes
_RECORD_INTERVAL = 0.2
"""Time [s] within which finalized jobs enter the index together."""
_PACKING, _RUN, _PLACING = range(3)
"""Priorities of a thread's tasks."""
_PLACED_AHEAD = 8
"""Maximum number of fillings, for each thread, whose grains are being placed, or wait for their ensemble."""
_SWITCH_INTERVAL = 1e-4
"""Time [s] for which a thread may keep the interpreter while others wait, instead of Python's 5 ms.

The thread that steps an ensemble releases it at every call to the device. It would wait 5 ms for each of several busy
finalizers to get it back.
"""


class Finalizer:
    """A thread that finalizes one job after another: itself, or from the second job on through a helper process.

    Args:
        alone: Never start a helper process.
    """

    def __init__(self, *, alone: bool):
        self._thread, self._alone = WorkerThread("labbook-closing"), alone
        self._closed = 0
        self._helper: HelperProcess | None = None

    def begin(self) -> None:
        """Start the helper process now, before there is work for it."""
        self._thread.submit(self._start)

    def _start(self) -> None:
        try:
            self._helper = self._helper or idle_helpers.take()
            self._helper.call(load_packages)
        except HelperLost:
            self._helper = None  # whoever needs one takes another

    def close(self, job: Job, verdict: str, end_state: EndState) -> "Future[LabEntry]":
        """Submit a job whose last state is `end_state`: write and measure it. Packings come first, since runs wait for
        them."""
        priority = _PACKING if isinstance(job, FillJob) else _RUN
        return self._thread.submit(lambda: self.finalize(job.output(verdict, end_state)), priority)

    def place(self, closed: Scene, kind: str, seed: int) -> "Future[Packing]":
        """Submit the placing of a filling's grains, as `labbook.filling.place` does, after all jobs to finalize."""
        return self._thread.submit(lambda: self._place(closed, kind, seed), _PLACING)

    def _place(self, closed: Scene, kind: str, seed: int) -> Packing:
        if not self._alone:
            try:
                self._helper = self._helper or idle_helpers.take()
                return self._helper.call(place, closed, kind, seed)
            except HelperLost as problem:
                self._continue_alone(f"seed {seed}: placed", problem)
        return place(closed, kind, seed)

    def _continue_alone(self, action: str, problem: HelperLost) -> None:
        self._helper, self._alone = None, True
        _LOG.warning("%s by this process, as no process beside it could be used: %s", action, problem)

    def finalize(self, output: JobOutput) -> LabEntry:
        """Write an output to the lab and measure it; if the helper is lost, this process goes on where it ended."""
        self._closed += 1
        is_written = False
        if (self._closed > 1 or self._helper is not None) and not self._alone:
            try:
                self._helper = self._helper or idle_helpers.take()
                self._helper.put(output)
                is_written = True
                return self._helper.entry()
            except HelperLost as problem:
                self._continue_alone(f"{output.label}: {'measured' if is_written else 'written'}", problem)
        if is_written:
            return output.reread()
        output.put()
        return output.entry()

    def end(self) -> None:
        """End the thread after its present tasks; its helper is kept for later runs."""
        self._thread.end(lambda: None if self._helper is None else idle_helpers.put_back(self._helper))


class FinalizerPool:
    """Finalizers, and the jobs that they work on.

    Finalized jobs are recorded in the queue only by the thread that calls `record` or `close`.

    Args:
        queue: Job queue that records them.
        finalizers: Threads that share the work.
    """

    def __init__(self, queue: JobQueue, finalizers: Sequence[Finalizer]):
        self._queue, self._finalizers = queue, finalizers
        self._next = cycle(self._finalizers)
        self._jobs: dict[Future[LabEntry], tuple[Job, str]] = {}
        self._done_futures: SimpleQueue[Future[LabEntry]] = SimpleQueue()
        self._next_time = 0.0
        """Time [s] from which finalized jobs are recorded again."""
        self._grains = 0
        """Number of grains in jobs that are being finalized."""
        self.wake = threading.Event()
        """Set when finalized jobs are to be recorded at once."""
        self._former_interval = sys.getswitchinterval()
        if len(finalizers) > 1:
            sys.setswitchinterval(_SWITCH_INTERVAL)

    @property
    def jobs(self) -> list[Job]:
        """Jobs that have not been recorded yet."""
        return [job for job, _ in self._jobs.values()]

    @property
    def placing(self) -> PlacingPool | None:
        """Helpers that place grains; None if there is a single finalizer."""
        if len(self._finalizers) == 1:
            return None
        return PlacingPool(self._submit_placing, _PLACED_AHEAD * len(self._finalizers))

    def _submit_placing(self, closed: Scene, kind: str, seed: int) -> "Future[Packing]":
        """Submit a placement to the next finalizer."""
        return next(self._next).place(closed, kind, seed)

    def close(self, job: Job, verdict: str, end_state: EndState) -> None:
        """Submit an ended job. Waits while jobs with too many grains are held in memory. Raises what `record` does."""
        self._grains += job.demand.point.scene.grains.count
        while self._jobs and self._grains > MAX_HELD_GRAINS:
            self.record(wait_for_one=True)
        future = next(self._next).close(job, verdict, end_state)
        self._jobs[future] = job, verdict
        future.add_done_callback(self._note_end)

    def _note_end(self, future: "Future[LabEntry]") -> None:
        self._done_futures.put(future)
        if len(self._finalizers) == 1 or self._done_futures.qsize() >= len(self._jobs):  # others are settled together
            self.wake.set()

    def record(self, *, wait_for_one: bool = False) -> bool:
        """Record all finalized jobs in the queue, in one transaction.

        While others are being finalized this is done only every 0.2 s: a transaction of the index takes some
        milliseconds.

        Args:
            wait_for_one: Wait until at least one job has been finalized.

        Returns:
            True if any job was recorded.

        Raises:
            DiskFull: No output can be written.
        """
        now, ended = time.perf_counter(), list[EndedJob]()
        waiting = self._done_futures.qsize()
        if not wait_for_one and (not waiting or (now < self._next_time and waiting < len(self._jobs))):
            return False
        self._next_time = now + (_RECORD_INTERVAL if len(self._finalizers) > 1 else 0.0)
        try:
            while wait_for_one or not self._done_futures.empty():
                future, wait_for_one = self._done_futures.get(), False
                job, verdict = self._jobs.pop(future)
                self._grains -= job.demand.point.scene.grains.count
                try:
                    ended.append((job, verdict, future.result()))
                except JobFailed as problem:
                    self._queue.record_failure(job, str(problem))
        finally:  # a full disk ends the process, but not what was put into the lab before
            if ended:
                self._queue.record_ended(ended)
        return True

    def record_all(self) -> None:
        """Wait for all jobs and record them. Raises DiskFull."""
        while self._jobs:
            self.record(wait_for_one=True)

    def end(self) -> None:
        """Wait for all jobs, without recording them."""
        wait(self._jobs)
        sys.setswitchinterval(self._former_interval)
