"""Carrying out a study: lanes take jobs from the board, step them by beats, save them, and end them by the
stop rule."""

import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from labbook.backend import Backend, Member, Overflow
from labbook.catalogue.catalogue import Catalogue
from labbook.catalogue.index import Index
from labbook.catalogue.lab import Lab, room
from labbook.catalogue.record import Observe
from labbook.plan.check import check
from labbook.plan.demand import PackingsOf
from labbook.plan.plan import Planner, PointPlan
from labbook.runner.board import Board, Started, Tally
from labbook.runner.job import Bench, Job, JobFailed
from labbook.runner.lane import Lane, Turn
from labbook.runner.provenance import cores
from labbook.runner.slots import slots
from labbook.runner.watch import Meter, Unwatched, View, Watcher

if TYPE_CHECKING:
    from labbook.study import Study

CHECKPOINT_EVERY = 20.0
"""Wall time between two saves of a job [s]: what a kill loses at most."""
_LOOK = 0.2  # s: how often a wait looks whether it was asked to stop
_POLL = 0.5  # s: how often claims that others hold are tried again


@dataclass(frozen=True)
class Summary:
    """What came of one `labbook run`."""

    tally: Tally
    points: tuple[PointPlan, ...]
    """How every point stands at the end, with the decision on its replicates."""
    stopped: bool
    """Whether it was asked to stop before the study was complete."""
    wall_time: float
    work_done: float
    """Grain-steps."""
    problems: tuple[str, ...]
    """Folders of the lab that cannot be read."""


Turns = dict[Future[Turn], tuple[Lane, list[Started]]]


@dataclass(eq=False)
class Runner:
    """Carries out `study` in `lab` on `backend`. Several at once share the work by claims."""

    study: "Study"
    lab: Lab
    backend: Backend
    device: str = "cpu"
    checkpoint_every: float = CHECKPOINT_EVERY
    watcher: Watcher = field(default_factory=Unwatched)
    lanes: int | None = None
    """None: one a core on a CPU, else one."""
    packings_of: PackingsOf | None = None
    """Whose packings the runs start from, which must be there; None: the engine makes its own."""
    packings_only: bool = False
    """Make the packings that the runs would start from, and no runs."""

    def run(self) -> Summary:
        """Run what is missing; Ctrl-C or SIGTERM saves what is going on and ends early.

        Raises DiskFull; Unsupported, Conflict or MeasureError before anything runs.
        """
        with room(self.lab.folder):
            return self._run()

    def _run(self) -> Summary:
        begun = time.perf_counter()
        self._stop = threading.Event()
        self._meter, self._told = Meter(), begun
        self._saved: dict[Job, float] = {}
        window = self.study.window
        observe = Observe(measure=self.study.measure, start=window.start, end=window.end)
        index = Index(self.lab)
        catalogue = Catalogue(self.lab)
        try:
            planner = Planner(self.study, catalogue, self.backend.capabilities, self.packings_of)
            plan = planner.plan()
            check(self.backend, self.device, plan.points)
            done = [item.keys.run for item in plan.items if item.state == "done"]
            if index.derive(done, observe):
                plan = planner.plan()
            bench = Bench(self.lab, self.backend, self.device)
            self._board = Board(bench, planner, index, observe, packings_only=self.packings_only)
            self._board.pin(plan)
            with self._signals():
                self._carry_out(slots(self.backend, self.device, plan.points))
            self._tell()
        finally:
            catalogue.close()
            index.close()
        points = tuple(self._board.points[at] for at in sorted(self._board.points))
        wall = time.perf_counter() - begun
        return Summary(
            self._board.tally, points, self._stop.is_set(), wall, self._meter.work, tuple(index.found.problems)
        )

    def _carry_out(self, slots: int) -> None:
        many = self.lanes or (cores() if self.device == "cpu" else 1)
        lanes = [Lane(self.backend, self.device, slots) for _ in range(many)]
        turns: Turns = {}
        with ThreadPoolExecutor(many, thread_name_prefix="labbook-lane") as pool:
            try:
                while not self._stop.is_set():
                    busy = [lane for lane, _ in turns.values()]
                    for lane in lanes:
                        if lane not in busy:
                            turns |= self._next_turn(pool, lane)
                    if not turns:
                        if not self._board.todo:
                            return
                        self._tell()
                        self._stop.wait(_POLL)  # others hold what is left
                        continue
                    for turn in wait(turns, timeout=_LOOK, return_when=FIRST_COMPLETED).done:
                        self._visit(*turns.pop(turn), turn)
                    self._tell()
                self._leave(turns, lanes)
            finally:
                wait(turns)
                for lane in lanes:
                    lane.close()
                for job in list(self._board.going.values()):
                    self._board.dropped(job)

    def _next_turn(self, pool: ThreadPoolExecutor, lane: Lane) -> "Turns":
        new: list[Started] = []
        while len(lane.jobs) + len(new) < lane.slots:
            spec = lane.spec if lane.jobs else new[0].spec if new else None
            started = self._board.next(spec)
            if started is None:
                break
            new.append(started)
            self._saved[started.job] = time.perf_counter()
        if not lane.jobs and not new:
            return {}
        return {pool.submit(lane.turn, new): (lane, new)}

    def _visit(self, lane: Lane, new: list[Started], turn: "Future[Turn]") -> None:
        """Account for a turn; end, save or leave going each of its jobs."""
        try:
            took = turn.result()
            rows = lane.rows()
        except (Overflow, ValueError, MemoryError) as problem:  # one bad start must not end the others
            for job in {*lane.jobs.values(), *(started.job for started in new)}:
                self._board.failed(job, f"{job.label}: {problem}")
            lane.jobs.clear()
            lane.close()
            return
        ensemble = lane.ensemble
        assert ensemble is not None
        share = max(1, len(self._board.going))
        for member, job in list(lane.jobs.items()):
            status, before = ensemble.status(member), job.status
            work = (status.step - before.step) * (status.grains + before.grains) / 2
            self._meter.add(work)
            job.after(status, rows[member], took.wall, took.process / share, work)
            job.look(ensemble, member)
            verdict = job.verdict([event for event in took.events if event.member == member])
            if verdict:
                self._end(lane, member, job, verdict)
            elif time.perf_counter() - self._saved[job] >= self.checkpoint_every:
                job.save(ensemble, member)
                self._saved[job] = time.perf_counter()

    def _end(self, lane: Lane, member: Member, job: Job, verdict: str) -> None:
        assert lane.ensemble is not None
        try:
            job.finish(verdict, lane.ensemble, member)
        except JobFailed as problem:
            self._board.failed(job, str(problem))
        else:
            self._board.finished(job, verdict)
        finally:
            self._saved.pop(job, None)
            lane.retire(member)

    def _leave(self, turns: "Turns", lanes: list[Lane]) -> None:
        """Let the turns end, and save what is not finished by then."""
        for turn in list(turns):
            self._visit(*turns.pop(turn), turn)
        for lane in lanes:
            for member, job in list(lane.jobs.items()):
                assert lane.ensemble is not None
                job.save(lane.ensemble, member)

    def _tell(self) -> None:
        if time.perf_counter() - self._told < _LOOK:
            return
        self._told = time.perf_counter()
        board = self._board
        done, asked = board.runs()
        view = View(
            runs_done=done,
            runs_asked=asked,
            fillings_left=board.fillings_left(),
            going=tuple(job.label for job in board.going.values()),
            elsewhere=board.elsewhere,
            work_done=self._meter.work,
            work_left=board.work_left(),
            rate=self._meter.rate(),
        )
        self.watcher.show(view)

    @contextmanager
    def _signals(self) -> Iterator[None]:
        """Ctrl-C and SIGTERM ask to stop; asked again, Ctrl-C interrupts at once (the last saves stay
        good)."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def ask(number, _frame):
            self._stop.set()
            signal.signal(signal.SIGINT, signal.default_int_handler)

        before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
