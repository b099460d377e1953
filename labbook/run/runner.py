"""Carrying out a study: lanes take jobs from the board, step them by beats, save them, and end them by the
stop rule."""

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from typing import Any

from labbook.backend import Backend, Compiles, Member, Overflow, Precompiles
from labbook.backend.machine import cores
from labbook.lab import studies
from labbook.lab.catalogue import Catalogue
from labbook.lab.folder import LabFolder, is_full, room
from labbook.lab.index import Index
from labbook.lab.merge import bring
from labbook.lab.records import Observe
from labbook.plan.demand import Demand, PackingsOf, recorded_in_words, stopping_rule
from labbook.plan.devices import slots
from labbook.plan.plan import Plan, Planner, PointPlan, check, counted
from labbook.run.board import Board, Started, Tally
from labbook.run.closing import Closing
from labbook.run.fill import FillJob
from labbook.run.job import Bench, Job
from labbook.run.lane import Lane, Turn
from labbook.run.live import Publisher
from labbook.run.shard import WHOLE, Seat, Shard, everything, part_of, shard_of
from labbook.run.stopping import Request
from labbook.run.watch import Going, Meter, Unwatched, View, Watcher
from labbook.scene.quantities import duration, percent
from labbook.study import Study
from labbook.study.problems import grouped

CHECKPOINT_EVERY = 20.0
"""Wall time between two saves of a job [s], which is what a kill loses at most; longer where saving would take more
than its part of the time."""
_LOOK = 0.2  # s: how often a wait looks whether it was asked to stop
_TELLING = 0.05  # of the main thread's time may go into telling how it goes
_SAVING = 0.05  # part of the time since the start, at most, that goes into saving the members of an ensemble
_LONG = 1.0  # s of saving that are allowed from the start
_MOST_UNSAVED = 2**28  # bytes of rows of a job that wait in memory for its next save
_POLL = 0.5  # s: how often claims that others hold are tried again
_CLOSING = 8  # threads, at most, that write and measure what members of one ensemble leave
_MANY = 10_000  # grains that take a while to place
_WRONG = 1.5  # a forecast of replicates that is off by this factor is told


_BEFORE_STEPS = ("placing", "compiling", "preparing")
_NOTABLE = 0.05  # part of the wall time that went into preparing, from which on it is told


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
    left_behind: bool = False
    """Whether threads of this process still compile for jobs that were dropped: nothing waits for them but the end of
    the process, unless it is ended by `os._exit`."""
    holds: Callable[[Demand], bool] = everything
    """Whether a run belongs to the part that was asked for; it is these that are counted."""
    no_flow: str = ""
    """Why no point of the study has a flow rate, though the study measures it; empty if one has."""
    preparing: float = 0.0
    """Wall time [s] in which no job took steps, since all waited for kernels or for grains to be placed."""

    @property
    def done(self) -> int:
        """Runs of the study that are there."""
        return counted(self.points, self.holds)[0]

    @property
    def asked(self) -> int:
        """Runs that the study asks for so far."""
        return counted(self.points, self.holds)[1]

    @property
    def failed(self) -> tuple[str, ...]:
        """Why runs failed, which are not there therefore."""
        return tuple(self.tally.failed)

    @property
    def diverged(self) -> dict[str, list[int]]:
        """Seeds of the runs that diverged, now or earlier, by the label of their point."""
        found: dict[str, list[int]] = {}
        for point in self.points:
            for item in point.items:
                if item.state == "done" and item.outcome == "diverged":
                    found.setdefault(item.demand.point.label, []).append(item.demand.seed)
        return found

    @property
    def suspect(self) -> dict[str, dict[int, str]]:
        """Why runs are suspect and left out of every mean, by the label of their point and their seed."""
        found: dict[str, dict[int, str]] = {}
        for item in (item for point in self.points for item in point.items):
            if item.state == "done" and item.suspect and not item.counts:
                found.setdefault(item.demand.point.label, {})[item.demand.seed] = item.suspect
        return found

    @property
    def complete(self) -> bool:
        """Whether all runs are there, and none diverged or is suspect."""
        return self.done == self.asked and not self.diverged and not self.suspect

    def lines(self) -> list[str]:
        """What came of it, line by line."""
        tally, outcomes = self.tally, Counter(self.tally.ran.values())
        lines = [f"{self.done} of {self.asked} runs done"]
        if tally.ran or tally.packings:
            stepping = self.wall_time - self.preparing
            what = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items()) or "none ended"
            made = f"{tally.packings} packing{'' if tally.packings == 1 else 's'}"
            lines[0] += f"; now: {what}; {made}; {duration(self.wall_time)}"
            if stepping > 0:
                apart = f" without {duration(self.preparing)} of compiling and loading kernels"
                lines[0] += f", {self.work_done / stepping / 1e6:.2f} M grain-steps/s"
                lines[0] += apart if self.preparing > max(1.0, _NOTABLE * self.wall_time) else ""
        if self.points and (recorded := recorded_in_words(point.shared for point in self.points)):
            lines.append(recorded)
        if tally.resumed:
            lines.append(f"{tally.resumed} continued from a checkpoint")
        for point in self.points:
            decision = point.decision
            if decision and decision.ended == "nothing":
                lines.append(
                    f"{point.shared.point.label}: none of {len(point.items)} runs has a flow rate, so no more are "
                    "made: labbook report tells why"
                )
            if decision and decision.ended and decision.pooled:
                short = (
                    ""
                    if decision.ended == "tolerance"
                    else ": the requested error is not reached, and accuracy.max_replicates allows no more runs"
                )
                lines.append(
                    f"{point.shared.point.label}: flow rate to {percent(decision.pooled.relative, '.2f')} "
                    f"with {decision.pooled.n} replicates{_foreseen(point, decision.pooled.n)}{short}"
                )
        for label, seeds in self.diverged.items():
            many = f"seeds {', '.join(map(str, seeds))}" if len(seeds) > 1 else f"seed {seeds[0]}"
            lines.append(f"Diverged: {label}, {many}: stopped by a guard, and left out of every mean")
        for label, reasons in self.suspect.items():
            for seed, why in reasons.items():
                lines.append(f"Suspect: {label}, seed {seed}: {why}; left out of every mean")
        lines += [f"Failed: {why}" for why in grouped(tally.failed)]
        lines += [f"Unreadable: {problem}" for problem in self.problems]
        return lines + ([f"No point of the study has a flow rate: {self.no_flow}"] if self.no_flow else [])

    def __repr__(self) -> str:
        stopped = ["Stopped early; everything is saved: run the study again to go on"] if self.stopped else []
        return "\n".join(self.lines() + stopped)


def _foreseen(point: PointPlan, needed: int) -> str:
    """That the forecast of replicates was wrong, if it was."""
    shared = point.shared
    choice = shared.point.choice
    if choice is None:
        return ""
    foreseen = stopping_rule(shared.study, shared.point).forecast(choice.scatter)
    wrong = max(needed, foreseen) > _WRONG * min(needed, foreseen)
    return f" ({foreseen} were expected, from a scatter of {percent(choice.scatter, '.2f')})" if wrong else ""


Turns = dict[Future[Turn], tuple[Lane, list[Started]]]


@dataclass(eq=False)
class Runner:
    """Carries out `study` in `lab` on `backend`. Several at once share the work by claims."""

    study: Study
    lab: LabFolder
    backend: Backend
    device: str = "cpu"
    checkpoint_every: float = CHECKPOINT_EVERY
    watcher: Watcher = field(default_factory=Unwatched)
    lanes: int | None = None
    """None: one a core on a CPU, else one."""
    packings_of: PackingsOf | None = None
    """Whose packings the runs start from, which must be there; None: the backend makes its own."""
    packings_only: bool = False
    """Make the packings that the runs would start from, and no runs."""
    shard: Shard = WHOLE
    """The part of the runs that are done."""
    seat: Seat | None = None
    """Which of several processes in one lab this is; None: it takes runs as they come."""
    base: LabFolder | None = None
    """A lab whose finished runs are not made again, and whose packings and shorter runs are gone on from."""

    seeds: Mapping[int, Sequence[int]] | None = None
    """The runs that are done, by index of the point and seed; None: what the study asks for."""
    request: Request = field(default_factory=Request)
    """By which another thread may ask it to stop."""

    def run(self) -> Summary:
        """Run what is missing; Ctrl-C, SIGTERM or SIGHUP saves what is going on and ends early.

        Raises KeyboardInterrupt when asked again meanwhile; the last saves stay good, and threads of lanes may still be
        in the middle of a beat. Raises DiskFull; Unsupported, Conflict or MeasureError before anything runs.
        """
        with room(self.lab.folder):
            return self._run()

    def _run(self) -> Summary:
        begun = time.perf_counter()
        self._stop = self.request
        self._left_behind = False
        self._meter, self._next_tell = Meter(), float("-inf")
        self._saved: dict[Job, float] = {}
        self._begun = begun
        observe = Observe.of(self.study.measure, self.study.window)
        index = Index(self.lab)
        catalogue = Catalogue(self.lab)
        try:
            planner = Planner(self.study, catalogue, self.backend.capabilities, self.packings_of)
            base = None if self.base is None else self._brought(index, self.base)
            check(self.backend, self.device, planner.points if base is None else [one.shared for one in base.points])
            if base is not None:
                plan = planner.of_base(base)
            else:
                plan = planner.plan() if self.seeds is None else planner.these(self.seeds)
            self._keep_study()
            done = [item.keys.run for item in plan.items if item.state == "done"]
            if base is not None:  # the others are measured where they are
                done = [key for key in done if self.lab.run(key).exists()]
            if index.derive(done, observe) and self.base is None and self.seeds is None:
                plan = planner.plan()
            bench = Bench(self.lab, self.backend, self.device)
            shared, capabilities = [point.shared for point in plan.points], self.backend.capabilities
            holds = shard_of(shared, capabilities, self.shard)
            own = holds if self.seat is None else part_of(shared, capabilities, self.seat, holds)
            rest = None if self.seat is None else holds
            only = self.packings_only
            self._board = Board(bench, planner, index, observe, packings_only=only, holds=own, rest=rest)
            self._board.beginning = self._tell_beginning
            self._board.pin(plan)
            if not self._board.runs()[1] and self.seat is None:
                self.watcher.tell(f"Part {self.shard} has no runs: the study has fewer packings than parts")
            if isinstance(self.backend, Precompiles):
                self.backend.precompile(self._board.expected(), self.device)
            # on a CPU lanes want all cores, and end their jobs one by one
            self._closing = Closing(self._board, 1 if self.device == "cpu" else min(_CLOSING, cores()))
            name = self.backend.capabilities.name
            self._publisher = Publisher(self.lab, self.study.name, name, self.device, self.watcher)
            with self._stop.listening(self.watcher.tell), self._publisher:
                self._carry_out(slots(self.backend, self.device, plan.points))
            self._tell()
        finally:
            catalogue.close()
            index.close()
        points = tuple(self._board.points[at] for at in sorted(self._board.points))
        wall = time.perf_counter() - begun
        problems, work = tuple(index.found.problems), self._meter.work
        left = self._left_behind
        preparing = self._meter.preparing
        return Summary(
            self._board.tally, points, self._stop.made, wall, work, problems, left, holds, preparing=preparing
        )

    def _brought(self, index: Index, base: LabFolder) -> Plan:
        """What is lacking in `base`; of what this process is to do, what `base` has of it is brought here."""
        catalogue = Catalogue(base)
        try:
            plan = Planner(self.study, catalogue, self.backend.capabilities, self.packings_of).plan()
        finally:
            catalogue.close()
        holds = shard_of([point.shared for point in plan.points], self.backend.capabilities, self.shard)
        mine = [item for item in plan.todo if holds(item.demand)]
        packings = dict.fromkeys(item.keys.packing for item in mine if item.packed)
        bring(index, base, packings, [item.keys.run for item in mine])
        return plan

    def _keep_study(self) -> None:
        """Keep the text of the study in the lab. Raises OSError for a full disk only."""
        try:
            studies.keep(self.lab, self.study.name, self.study.text, self.study.calibration_file)
        except OSError as error:
            if is_full(error):
                raise
            where = error.filename or self.lab.studies
            self.watcher.tell(f"The study runs, but its file could not be copied to the lab: {where}: {error.strerror}")

    def _carry_out(self, slots: int) -> None:
        many = self.lanes or (cores() if self.device == "cpu" else 1)
        self._lanes = lanes = [Lane(self.backend, self.device, slots) for _ in range(many)]
        turns: Turns = {}
        try:
            while not self._stop.made:
                self._closing.settle()
                if not self._board.todo and (self.device == "cpu" or not self._board.going):
                    self._board.widen()
                busy = [lane for lane, _ in turns.values()]
                for lane in lanes:
                    if lane not in busy:
                        turns |= self._next_turn(lane)
                if self._stop.made:
                    break
                if not (turns or self._closing.jobs):
                    if not self._board.todo:
                        return
                    self._tell()
                    time.sleep(_POLL)  # others hold what is left
                    continue
                awaited: list[Future[Any]] = [*turns, *self._closing.futures]
                for done in wait(awaited, timeout=_LOOK, return_when=FIRST_COMPLETED).done:
                    if done in turns:
                        self._visit(*turns.pop(done), done)
                self._tell()
            self._leave(turns, lanes)
            self._closing.settle_all()
        except Exception:  # such as a full disk: the process ends now, and kernels must not be at work by then
            wait([turn for turn, (lane, _) in turns.items() if not lane.preparing])
            raise
        finally:
            busy = [lane for lane, _ in turns.values()]
            for lane in lanes:
                if lane not in busy:
                    lane.close()
                lane.end()
            self._closing.end()
            for job in list(self._board.going.values()):
                self._board.dropped(job)

    def _next_turn(self, lane: Lane) -> "Turns":
        if lane.slots > 1 and not lane.jobs and self._closing.jobs:
            return {}  # what they let begin comes into one ensemble, which is laid out once
        new: list[Started] = []
        while len(lane.jobs) + len(new) < lane.slots and not self._stop.made:
            spec = lane.spec if lane.jobs else new[0].spec if new else None
            started = self._board.next(spec)
            if started is None:
                break
            new.append(started)
            self._saved[started.job] = time.perf_counter()
        if self._stop.made or not (lane.jobs or new):
            return {}
        return {lane.start(new): (lane, new)}

    def _visit(self, lane: Lane, new: list[Started], turn: "Future[Turn]") -> None:
        """Account for a turn; end, save or leave going each of its jobs."""
        try:
            took = turn.result()
            rows = lane.rows()
        except (Overflow, ValueError, MemoryError) as problem:  # one bad start must not end the others
            jobs = dict.fromkeys((*lane.jobs.values(), *(started.job for started in new)))
            lane.jobs.clear()
            lane.close()
            if isinstance(problem, MemoryError) and len(jobs) > 1:
                self._fewer_at_once(lane, list(jobs), problem)
                return
            for job in jobs:
                self._board.failed(job, f"{job.label}: {problem}")
            return
        ensemble = lane.ensemble
        assert ensemble is not None
        share = max(1, len(self._board.going))
        # of all before anything is done with one: a backend reads them together
        now = {member: ensemble.status(member) for member in lane.jobs}
        for member, job in list(lane.jobs.items()):
            status, before = now[member], job.status
            work = (status.step - before.step) * (status.grains + before.grains) / 2
            self._meter.add(work)
            job.after(status, rows[member], took.wall, took.process / share, work)
            job.look(ensemble, member)
            if warning := job.warning():
                self.watcher.tell(warning)
            verdict = job.verdict([event for event in took.events if event.member == member])
            if verdict:
                self._end(lane, member, job, verdict)
        self._save(lane)

    def _fewer_at_once(self, lane: Lane, jobs: Sequence[Job], problem: MemoryError) -> None:
        """Let a lane go on with half as many of its jobs at once, each from its last save: what else the device does
        may have taken memory that was free when slots were counted."""
        lane.slots = len(jobs) // 2
        for job in jobs:
            self._saved.pop(job, None)
            self._board.dropped(job)
        self.watcher.tell(
            f"{problem}. They go on from their last checkpoints, {lane.slots} at once; to have more at once, end other "
            "programs on the device, or add devices (--device cuda:all)"
        )

    def _save(self, lane: Lane) -> None:
        """Save jobs that have not been saved for `checkpoint_every`, the longest unsaved first, while saving has its
        part of the time: the lane stands still meanwhile. Those with many rows in memory are saved in any case."""
        assert lane.ensemble is not None
        for member, job in sorted(lane.jobs.items(), key=lambda one: self._saved[one[1]]):
            begun = time.perf_counter()
            allowed = max(_LONG, _SAVING * (begun - self._begun))
            waits = begun - self._saved[job] < self.checkpoint_every or lane.saving > allowed
            if waits and job.unsaved < _MOST_UNSAVED:
                continue
            job.save(lane.ensemble, member)
            self._saved[job] = time.perf_counter()
            lane.saving += self._saved[job] - begun

    def _end(self, lane: Lane, member: Member, job: Job, verdict: str) -> None:
        assert lane.ensemble is not None
        try:
            left = job.leave(lane.ensemble, member)
        finally:
            self._saved.pop(job, None)
            lane.retire(member)
        self._closing.close(job, verdict, left)

    def _leave(self, turns: "Turns", lanes: list[Lane]) -> None:
        """Let the turns end, and save what is not finished by then. Lanes that prepare have nothing to save."""
        while any(not lane.preparing for lane, _ in turns.values()):
            for turn in wait(turns, timeout=_LOOK, return_when=FIRST_COMPLETED).done:
                self._visit(*turns.pop(turn), turn)
        self._left_behind = bool(turns) or self._compiling()
        waited = [lane for lane in lanes if lane not in [lane for lane, _ in turns.values()]]
        for lane in waited:
            for member, job in list(lane.jobs.items()):
                assert lane.ensemble is not None
                job.save(lane.ensemble, member)

    def _tell_beginning(self, job: Job) -> None:
        grains = job.scene.grains.count
        if isinstance(job, FillJob) and grains >= _MANY:
            self._tell(Going(job.label, "placing", (f"placing {grains} grains",)))

    def _tell(self, *beginning: Going) -> None:
        begun = time.perf_counter()
        if begun < self._next_tell:
            return
        board = self._board
        done, asked = board.runs()
        going = (*beginning, *self._going())
        self._meter.look(idle=bool(going) and all(one.phase in _BEFORE_STEPS for one in going))
        view = View(
            runs_done=done,
            runs_asked=asked,
            fillings_left=board.fillings_left(),
            going=going,
            elsewhere=board.elsewhere,
            work_done=self._meter.work,
            work_left=board.work_left(),
            rate=self._meter.rate(),
            open_ended=board.open_ended(),
        )
        self._publisher.show(view)
        now = time.perf_counter()
        self._next_tell = now + max(_LOOK, (now - begun) / _TELLING)  # counting 10^5 runs takes a while

    def _compiling(self) -> bool:
        return isinstance(self.backend, Compiles) and self.backend.compiling()

    def _going(self) -> list[Going]:
        """What every job is at."""
        compiling = self._compiling()
        at_work = {job for lane in self._lanes if not lane.preparing for job in list(lane.jobs.values())}
        found, closing = [], dict.fromkeys(self._closing.jobs)
        for job in (*(job for job in self._board.going.values() if job not in closing), *closing):
            if job in closing:
                found.append(Going(job.label, "writing", ("writing and measuring",)))
            elif job in at_work:
                phase = "settling" if isinstance(job, FillJob) else "discharging"
                found.append(Going(job.label, phase, job.doing()))
            elif compiling:
                found.append(Going(job.label, "compiling", ("compiling, once for this kind of scene",)))
            else:
                found.append(Going(job.label, "preparing", ("preparing kernels",)))
        return found
