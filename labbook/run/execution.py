"""Main loop of a run: workers take jobs from the queue, step them by beats, save them, and end them by their
verdicts."""

import logging
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ALL_COMPLETED, FIRST_COMPLETED, Future, wait

from labbook.backend import Backend, EndState, Ensemble, Event, Member, Overflow, Status
from labbook.filling import refill
from labbook.run.discharge import DischargeJob
from labbook.run.ensemble_worker import BeatResult, EnsembleWorker, WorkerThread
from labbook.run.fill import FillJob
from labbook.run.finalizing import FinalizerPool
from labbook.run.job import BeatCost, Job
from labbook.run.job_queue import KINDS, JobQueue, StartedJob
from labbook.run.live import Publisher
from labbook.run.stopping import StopRequest
from labbook.run.watch import ActiveJob, Meter, View

CHECKPOINT_EVERY = 20.0
"""Wall time between saves of a job [s], the most that a kill loses. It is longer where saving would take too much
time."""
_STOP_INTERVAL = 0.2  # s: how often a wait looks whether it was asked to stop
_WAKE_INTERVAL = 0.05  # s: how often a wait looks whether jobs were closed, or grains placed
_REPORT_SHARE = 0.02  # of the main thread's time may go into telling how it goes
_SAVING_SHARE = 0.05  # part of the time since the start, at most, that goes into saving the members of an ensemble
_SAVING_ALLOWANCE = 1.0  # s of saving that are allowed from the start
_MOST_UNSAVED = 2**28  # bytes of rows of a job that wait in memory for its next save
_CLAIM_INTERVAL = 0.5  # s: how often claims that others hold are tried again
_ANNOUNCED_GRAINS = 10_000  # grains that take a while to place
_TRACE = logging.getLogger("labbook.turns")
_BEFORE_STEPS = ("placing", "compiling", "preparing")

PendingBeats = dict[Future[BeatResult], tuple[EnsembleWorker, list[StartedJob]]]


class Execution:
    """Steps the jobs of a queue on one device.

    Attributes:
        meter: Grain-steps taken, and time without any.
        left_behind: Threads still compile for jobs that were dropped.
    """

    def __init__(
        self,
        queue: JobQueue,
        finalizers: FinalizerPool,
        backend: Backend,
        device: str,
        workers: int,
        slots: int,
        limit: int,
        publisher: Publisher,
        request: StopRequest,
        print_line: Callable[[str], None],
        checkpoint_every: float,
    ):
        """Prepare workers; nothing runs before `carry_out`.

        Args:
            queue: Queue of the jobs.
            finalizers: Write and measure ended jobs.
            backend: Steps the members.
            device: Device of the members.
            workers: Number of ensembles stepped at once on a CPU. A GPU has two, whose beats alternate.
            slots: Number of members that the device can hold: on a GPU in both ensembles together, on a CPU in each.
            limit: Maximum number of members of an ensemble.
            publisher: Receives the state of all jobs.
            request: Stop request.
            print_line: Shows a line to the user.
            checkpoint_every: Wall time between saves of a job [s].
        """
        self.meter, self.left_behind = Meter(), False
        self._queue, self._finalizers, self._backend, self._device = queue, finalizers, backend, device
        self._publisher, self._request, self._print_line = publisher, request, print_line
        self._checkpoint_every = checkpoint_every
        self._slots, self._is_shared = slots, device != "cpu"
        """Number of members that the device can hold; `_is_shared`: workers share the device."""
        threads = [WorkerThread()] * 2 if self._is_shared else [WorkerThread() for _ in range(workers)]
        kinds = [{FillJob.kind}, {DischargeJob.kind}] if self._is_shared else [KINDS] * workers
        self._workers = [
            EnsembleWorker(backend, device, min(slots, limit), *options) for options in zip(kinds, threads, strict=True)
        ]
        self._last_saved: dict[Job, float] = {}
        """Time of the last save of each job, or of its beginning."""
        self._start_time = time.perf_counter()
        self._next_report = float("-inf")

    def carry_out(self) -> None:
        """Run jobs until none are left or a stop is requested; then save the active ones.

        Raises:
            DiskFull: The disk is full.
            KeyboardInterrupt: A second stop signal.
        """
        workers, pending = self._workers, PendingBeats()
        try:
            while not self._request.requested:
                if not self._queue.pending and (self._device == "cpu" or not self._queue.active):
                    self._queue.add_later()
                busy = [worker for worker, _ in pending.values()]
                for worker in workers if not (self._is_shared and busy) else ():
                    if worker not in busy:
                        pending |= self._start_beat(worker, pending)
                recorded = self._finalizers.record()  # now, while workers step
                self._queue.place_ahead()
                if self._request.requested:
                    break
                if recorded and len(pending) < len(workers):  # there may be runs whose packings are made
                    continue
                if not (pending or self._finalizers.jobs or self._queue.being_placed):
                    if not self._queue.pending:
                        return
                    self.report()
                    time.sleep(_CLAIM_INTERVAL)  # others hold what is left
                    continue
                self._finalizers.wake.wait(
                    _WAKE_INTERVAL if self._finalizers.jobs or self._queue.being_placed else _STOP_INTERVAL
                )
                self._finalizers.wake.clear()
                for beat in self._completed(pending):
                    self._process_beat(*pending.pop(beat), beat)
                self.report()
            self._shut_down(pending, workers)
            self._finalizers.record_all()
        except Exception:  # such as a full disk: the process ends now, and kernels must not be at work by then
            wait([beat for beat, (worker, _) in pending.items() if not worker.preparing])
            raise
        finally:
            busy = [worker.thread for worker, _ in pending.values()]
            closed = {worker.thread.submit(worker.close): worker.thread for worker in workers}
            wait([future for future, thread in closed.items() if thread not in busy])
            for thread in {*closed.values()}:
                thread.end()
            self._finalizers.end()
            for job in list(self._queue.active.values()):
                self._queue.drop(job)

    def _completed(self, pending: "PendingBeats") -> "list[Future[BeatResult]]":
        """Return the finished beats that can be processed.

        On a GPU both workers have to be finished: reading a member must not overlap another worker's step.
        """
        completed = [future for future in pending if future.done()]
        return [] if self._is_shared and len(completed) < len(pending) else completed

    def _start_beat(self, worker: EnsembleWorker, pending: "PendingBeats") -> "PendingBeats":
        new: list[StartedJob] = []
        free = self._free_slots(worker, pending)
        jobs = self._queue.jobs(worker.spec if worker.jobs else None, worker.kinds)
        while len(worker.jobs) + len(new) < free and not self._request.requested:
            started = next(jobs, None)
            if started is None:
                break
            new.append(started)
            self._last_saved[started.job] = time.perf_counter()
        if self._request.requested or not (worker.jobs or new):
            return {}
        needs_ensemble = new and worker.spec != new[0].spec
        future = worker.start(new, min(free, self._queue.members(new[0].spec)) if needs_ensemble else 0)
        future.add_done_callback(lambda _: self._finalizers.wake.set())
        return {future: (worker, new)}

    def _free_slots(self, worker: EnsembleWorker, pending: "PendingBeats") -> int:
        """Number of members that a worker can have now. If a GPU has no room for both ensembles, an empty one is
        closed."""
        if not self._is_shared:
            return worker.slots
        busy = [other for other, _ in pending.values()]
        for neighbour in self._neighbours(worker):
            if self._slots - neighbour.opened < worker.slots and not neighbour.jobs and neighbour not in busy:
                neighbour.free_ensemble()
        return min(worker.slots, self._slots - sum(neighbour.opened for neighbour in self._neighbours(worker)))

    def _process_beat(self, worker: EnsembleWorker, new: list[StartedJob], future: "Future[BeatResult]") -> None:
        """Account for a beat; end, save or continue each job."""
        try:
            result = future.result()
            rows = worker.rows()
        except (Overflow, ValueError, MemoryError) as problem:  # one bad start must not end the others
            jobs = dict.fromkeys((*worker.jobs.values(), *(started.job for started in new)))
            worker.jobs.clear()  # after an error the ensemble cannot be used any more
            worker.free_ensemble()
            if isinstance(problem, MemoryError) and (len(jobs) > 1 or self._neighbours(worker)):
                self._halve_slots(worker, list(jobs), problem)
                return
            for job in jobs:
                self._queue.record_failure(job, f"{job.label}: {problem}")
            return
        ensemble = worker.ensemble
        assert ensemble is not None
        self._trace(worker, len(new), result)
        self.meter.stepping += result.wall
        active_jobs = max(1, len(self._queue.active))
        # of all before anything is done with one: a backend reads them together
        statuses = {member: job.status_of(ensemble, member) for member, job in worker.jobs.items()}
        events: dict[Member, list[Event]] = defaultdict(list)
        for event in result.events:
            events[event.member].append(event)
        work = {member: _grain_steps(job.status, statuses[member]) for member, job in worker.jobs.items()}
        together = sum(work.values())
        for member, job in worker.jobs.items():
            self.meter.add(work[member])
            device = 0.0 if result.compiling or not together else result.wall * work[member] / together
            cost = BeatCost(result.wall, result.process / active_jobs, device, work[member])
            job.after(statuses[member], rows[member], cost)
        self._intervene(ensemble, worker.jobs)
        observed = {member: job for member, job in worker.jobs.items() if job.looks}
        with ensemble.reading(observed):
            for member, job in observed.items():
                job.look(ensemble, member)
        ended: dict[Member, tuple[Job, str]] = {}
        stages = {member: job.stage for member, job in worker.jobs.items()}
        for member, job in worker.jobs.items():
            if warning := job.warning():
                self._print_line(warning)
            if verdict := job.verdict(events[member]):
                ended[member] = job, verdict
        self._end_members(worker, ended)
        for member in [member for member, job in worker.jobs.items() if job.stage != stages[member]]:
            worker.change_scene(member)
        self._save(worker)

    def _intervene(self, ensemble: Ensemble, jobs: Mapping[Member, Job]) -> None:
        """Feed grains, then break arches.

        Only the beds that are needed are read, all in one go: reading one alone takes longer than many of its steps.
        """
        tops = ensemble.tops({member: job.floor for member, job in jobs.items() if job.needs_refill})
        refills = zip(tops, refill([jobs[member].refill(top) for member, top in tops.items()]), strict=True)
        entering = {member: grains for member, grains in refills if grains is not None}
        ensemble.put_back_all(entering)
        for member, grains in entering.items():
            jobs[member].refilled(grains)
        pausing = [member for member, job in jobs.items() if job.pauses]
        with ensemble.reading(pausing):
            beds = [ensemble.bed(member) for member in pausing]
        for member, bed in zip(pausing, beds, strict=True):
            jobs[member].break_arch(ensemble, member, bed)

    def _trace(self, worker: EnsembleWorker, new: int, result: BeatResult) -> None:
        """Log a beat, to show what waits for what."""
        if _TRACE.isEnabledFor(logging.DEBUG):
            kind = FillJob.kind if isinstance(next(iter(worker.jobs.values())), FillJob) else DischargeJob.kind
            placed = sum(job.is_placed for job in self._queue.being_placed.values())
            _TRACE.debug(
                "%8.3f s: %-7s %4d of %4d, %4d new, admitted in %.3f s, beat %.3f s; %d of %d placed, %d closing",
                time.perf_counter() - self._start_time, kind, len(worker.jobs), worker.opened, new, result.admitting,
                result.wall, placed, len(self._queue.being_placed), len(self._finalizers.jobs),
            )  # fmt: skip

    def _halve_slots(self, worker: EnsembleWorker, jobs: Sequence[Job], problem: MemoryError) -> None:
        """Continue with half as many jobs at once, each from its last save.

        Memory that was free when slots were counted may have been taken by other users of the device.
        """
        worker.slots = max(1, len(jobs) // 2)
        self._slots = max(1, (len(jobs) + sum(len(other.jobs) for other in self._neighbours(worker))) // 2)
        for job in jobs:
            self._last_saved.pop(job, None)
            self._queue.drop(job)
        self._print_line(
            f"{problem}. They go on from their last checkpoints, {worker.slots} at once; to have more at once, end "
            "other programs on the device, or add devices (--device cuda:all)"
        )

    def _neighbours(self, worker: EnsembleWorker) -> list[EnsembleWorker]:
        """Other workers with an ensemble on the same device."""
        return [other for other in self._workers if self._is_shared and other is not worker and other.opened]

    def _save(self, worker: EnsembleWorker) -> None:
        """Save jobs whose last save is older than `checkpoint_every`, the oldest first, within the time for saving.

        Jobs with many rows in memory are saved in any case. The worker does not step meanwhile.
        """
        assert worker.ensemble is not None
        for member, job in sorted(worker.jobs.items(), key=lambda entry: self._last_saved[entry[1]]):
            start = time.perf_counter()
            allowed = max(_SAVING_ALLOWANCE, _SAVING_SHARE * (start - self._start_time))
            may_wait = start - self._last_saved[job] < self._checkpoint_every or worker.saving > allowed
            if may_wait and job.unsaved < _MOST_UNSAVED:
                continue
            job.save(worker.ensemble, member)
            self._last_saved[job] = time.perf_counter()
            worker.saving += self._last_saved[job] - start

    def _end_members(self, worker: EnsembleWorker, ended: Mapping[Member, tuple[Job, str]]) -> None:
        """End members with their verdicts: their last states are read together, and their slots are freed."""
        assert worker.ensemble is not None
        end_states: list[EndState] = []
        try:
            with worker.ensemble.reading(ended):
                end_states += map(worker.ensemble.end_state, ended)
        finally:  # a member whose end cannot be read must not be stepped on
            for member, (job, _) in ended.items():
                self._last_saved.pop(job, None)
                worker.retire(member)
        for (job, verdict), state in zip(ended.values(), end_states, strict=True):
            self._finalizers.close(job, verdict, state)

    def _shut_down(self, pending: "PendingBeats", workers: list[EnsembleWorker]) -> None:
        """Finish the beats, and save all jobs. Workers that prepare kernels have nothing to save."""
        while any(not worker.preparing for worker, _ in pending.values()):
            wait(pending, timeout=_STOP_INTERVAL, return_when=ALL_COMPLETED if self._is_shared else FIRST_COMPLETED)
            for future in self._completed(pending):
                self._process_beat(*pending.pop(future), future)
        self.left_behind = bool(pending) or self._backend.compiling()
        idle = [worker for worker in workers if worker not in [worker for worker, _ in pending.values()]]
        for worker in idle:
            for member, job in list(worker.jobs.items()):
                assert worker.ensemble is not None
                job.save(worker.ensemble, member)

    def announce(self, job: Job) -> None:
        """Report a job that takes long to begin: the placing of many grains."""
        grains = job.scene.grains.count
        if isinstance(job, FillJob) and grains >= _ANNOUNCED_GRAINS:
            self.report(ActiveJob(job.label, "placing", (f"placing {grains} grains",)))

    def report(self, *beginning: ActiveJob) -> None:
        """Publish the state of all jobs, if a report is due. `beginning`: jobs that are about to begin."""
        start = time.perf_counter()
        if start < self._next_report:
            return
        queue = self._queue
        finished, demanded = queue.count_runs()
        going = (*beginning, *self._active_jobs())
        self.meter.look(idle=bool(going) and all(job.phase in _BEFORE_STEPS for job in going))
        view = View(
            runs_done=finished,
            runs_asked=demanded,
            fillings_left=queue.fillings_left(),
            going=going,
            elsewhere=queue.claimed_elsewhere,
            work_done=self.meter.work,
            work_left=queue.work_left(),
            rate=self.meter.rate(),
            open_ended=queue.open_ended(),
        )
        self._publisher.show(view)
        now = time.perf_counter()
        self._next_report = now + max(_STOP_INTERVAL, (now - start) / _REPORT_SHARE)  # counting 10^5 runs takes a while

    def _active_jobs(self) -> list[ActiveJob]:
        """State of every active job."""
        compiling = self._backend.compiling()
        stepping = {job for worker in self._workers if not worker.preparing for job in list(worker.jobs.values())}
        statuses, closing, waiting = [], dict.fromkeys(self._finalizers.jobs), {*self._queue.being_placed.values()}
        for job in (*(job for job in self._queue.active.values() if job not in closing), *closing):
            if job in closing:
                statuses.append(ActiveJob(job.label, "writing", ("writing and measuring",)))
            elif job in waiting:
                statuses.append(ActiveJob(job.label, "placing", ("placing grains",)))
            elif job in stepping:
                phase = "settling" if isinstance(job, FillJob) else "discharging"
                statuses.append(ActiveJob(job.label, phase, job.doing()))
            elif compiling:
                statuses.append(ActiveJob(job.label, "compiling", ("compiling, once for this kind of scene",)))
            else:
                statuses.append(ActiveJob(job.label, "preparing", ("preparing kernels",)))
        return statuses


def _grain_steps(before: Status, after: Status) -> float:
    """Grain-steps of a member between two of its statuses."""
    return (after.step - before.step) * (after.grains + before.grains) / 2
