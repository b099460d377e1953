"""The loop of a run: lanes take jobs from the board, step them by beats, save them, and end them by the stop rule."""

import logging
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ALL_COMPLETED, FIRST_COMPLETED, Future, wait

from labbook.backend import Backend, EndState, Ensemble, Event, Member, Overflow
from labbook.filling import refill
from labbook.run.board import KINDS, Board, Started
from labbook.run.closing import Closing
from labbook.run.discharge import DischargeJob
from labbook.run.fill import FillJob
from labbook.run.job import Job
from labbook.run.lane import Hand, Lane, Turn
from labbook.run.live import Publisher
from labbook.run.stopping import Request
from labbook.run.watch import Going, Meter, View
from labbook.scene import Packing

CHECKPOINT_EVERY = 20.0
"""Wall time between two saves of a job [s], which is what a kill loses at most; longer where saving would take more
than its part of the time."""
_LOOK = 0.2  # s: how often a wait looks whether it was asked to stop
_SOON = 0.05  # s: how often a wait looks whether jobs were closed, or grains placed
_TELLING = 0.05  # of the main thread's time may go into telling how it goes
_SAVING = 0.05  # part of the time since the start, at most, that goes into saving the members of an ensemble
_LONG = 1.0  # s of saving that are allowed from the start
_MOST_UNSAVED = 2**28  # bytes of rows of a job that wait in memory for its next save
_POLL = 0.5  # s: how often claims that others hold are tried again
_MANY = 10_000  # grains that take a while to place
_TRACE = logging.getLogger("labbook.turns")
_BEFORE_STEPS = ("placing", "compiling", "preparing")

Turns = dict[Future[Turn], tuple[Lane, list[Started]]]


class Execution:
    """The jobs of one board on one device, while they are carried out.

    Attributes:
        meter: Grain-steps taken, and the time without any.
        left_behind: Whether threads still compile for jobs that were dropped.
    """

    def __init__(
        self,
        board: Board,
        closing: Closing,
        backend: Backend,
        device: str,
        lanes: int,
        slots: int,
        limit: int,
        publisher: Publisher,
        request: Request,
        say: Callable[[str], None],
        checkpoint_every: float,
    ):
        """Prepare lanes; nothing runs before `carry_out`.

        Args:
            board: Has the jobs.
            closing: Writes and measures what ended jobs leave.
            backend: Steps them.
            device: Where they are stepped.
            lanes: Ensembles that are stepped at once on a CPU. A GPU has two, which take turns.
            slots: Members that the device holds: a GPU in both ensembles together, a CPU in each.
            limit: Members of an ensemble, at most.
            publisher: Shows how jobs stand.
            request: By which a stop is asked for.
            say: Shows a line.
            checkpoint_every: Wall time between two saves of a job [s].
        """
        self.meter, self.left_behind = Meter(), False
        self._board, self._closing, self._backend, self._device = board, closing, backend, device
        self._publisher, self._request, self._say = publisher, request, say
        self._checkpoint_every = checkpoint_every
        self._slots, self._shared = slots, device != "cpu"
        """Members that the device holds, and whether lanes share it."""
        hands = [Hand()] * 2 if self._shared else [Hand() for _ in range(lanes)]
        kinds = [{FillJob.kind}, {DischargeJob.kind}] if self._shared else [KINDS] * lanes
        self._lanes = [Lane(backend, device, min(slots, limit), *own) for own in zip(kinds, hands, strict=True)]
        self._saved: dict[Job, float] = {}
        """When each job was saved last, or begun."""
        self._begun = time.perf_counter()
        self._next_report = float("-inf")

    def carry_out(self) -> None:
        """Take jobs from the board until none are left, or a stop is asked for; then everything is saved.

        Raises DiskFull; KeyboardInterrupt when asked again meanwhile.
        """
        lanes, turns = self._lanes, Turns()
        try:
            while not self._request.made:
                if not self._board.todo and (self._device == "cpu" or not self._board.going):
                    self._board.widen()
                busy = [lane for lane, _ in turns.values()]
                for lane in lanes if not (self._shared and busy) else ():
                    if lane not in busy:
                        turns |= self._next_turn(lane, turns)
                settled = self._closing.settle()  # now, while lanes are at work
                self._board.place_ahead()
                if self._request.made:
                    break
                if settled and len(turns) < len(lanes):  # there may be runs whose packings are made
                    continue
                if not (turns or self._closing.jobs or self._board.waiting):
                    if not self._board.todo:
                        return
                    self.report()
                    time.sleep(_POLL)  # others hold what is left
                    continue
                self._closing.wake.wait(_SOON if self._closing.jobs or self._board.waiting else _LOOK)
                self._closing.wake.clear()
                for turn in self._completed(turns):
                    self._visit(*turns.pop(turn), turn)
                self.report()
            self._leave(turns, lanes)
            self._closing.settle_all()
        except Exception:  # such as a full disk: the process ends now, and kernels must not be at work by then
            wait([turn for turn, (lane, _) in turns.items() if not lane.preparing])
            raise
        finally:
            busy = [lane.hand for lane, _ in turns.values()]
            closed = {lane.hand.do(lane.close): lane.hand for lane in lanes}
            wait([future for future, hand in closed.items() if hand not in busy])
            for hand in {*closed.values()}:
                hand.end()
            self._closing.end()
            for job in list(self._board.going.values()):
                self._board.dropped(job)

    def _completed(self, turns: "Turns") -> "list[Future[Turn]]":
        """Turns that have been taken, and can be accounted for: on a GPU both lanes, as a thread that reads a member
        must not meet another one that steps."""
        completed = [turn for turn in turns if turn.done()]
        return [] if self._shared and len(completed) < len(turns) else completed

    def _next_turn(self, lane: Lane, turns: "Turns") -> "Turns":
        new: list[Started] = []
        room = self._room(lane, turns)
        jobs = self._board.jobs(lane.spec if lane.jobs else None, lane.kinds)
        while len(lane.jobs) + len(new) < room and not self._request.made:
            started = next(jobs, None)
            if started is None:
                break
            new.append(started)
            self._saved[started.job] = time.perf_counter()
        if self._request.made or not (lane.jobs or new):
            return {}
        opens = new and lane.spec != new[0].spec
        turn = lane.start(new, min(room, self._board.members(new[0].spec)) if opens else 0)
        turn.add_done_callback(lambda _: self._closing.wake.set())
        return {turn: (lane, new)}

    def _room(self, lane: Lane, turns: "Turns") -> int:
        """Members that a lane can have now. Where a GPU has no room for both ensembles, the one without members makes
        way."""
        if not self._shared:
            return lane.slots
        busy = [one for one, _ in turns.values()]
        for neighbour in self._beside(lane):
            if self._slots - neighbour.opened < lane.slots and not neighbour.jobs and neighbour not in busy:
                neighbour.rest()
        return min(lane.slots, self._slots - sum(neighbour.opened for neighbour in self._beside(lane)))

    def _visit(self, lane: Lane, new: list[Started], turn: "Future[Turn]") -> None:
        """Account for a turn; end, save or leave going each of its jobs."""
        try:
            took = turn.result()
            rows = lane.rows()
        except (Overflow, ValueError, MemoryError) as problem:  # one bad start must not end the others
            jobs = dict.fromkeys((*lane.jobs.values(), *(started.job for started in new)))
            lane.jobs.clear()
            lane.rest()
            if isinstance(problem, MemoryError) and (len(jobs) > 1 or self._beside(lane)):
                self._fewer_at_once(lane, list(jobs), problem)
                return
            for job in jobs:
                self._board.failed(job, f"{job.label}: {problem}")
            return
        ensemble = lane.ensemble
        assert ensemble is not None
        self._trace(lane, len(new), took)
        self.meter.stepping += took.wall
        share = max(1, len(self._board.going))
        # of all before anything is done with one: a backend reads them together
        now = {member: ensemble.status(member) for member in lane.jobs}
        events: dict[Member, list[Event]] = defaultdict(list)
        for event in took.events:
            events[event.member].append(event)
        for member, job in lane.jobs.items():
            status, before = now[member], job.status
            work = (status.step - before.step) * (status.grains + before.grains) / 2
            self.meter.add(work)
            job.after(status, rows[member], took.wall, took.process / share, work)
        self._intervene(ensemble, lane.jobs)
        looking = {member: job for member, job in lane.jobs.items() if job.looks}
        with ensemble.reading(looking):
            for member, job in looking.items():
                job.look(ensemble, member)
        ended: dict[Member, tuple[Job, str]] = {}
        stages = {member: job.stage for member, job in lane.jobs.items()}
        for member, job in lane.jobs.items():
            if warning := job.warning():
                self._say(warning)
            if verdict := job.verdict(events[member]):
                ended[member] = job, verdict
        self._end(lane, ended)
        for member in [member for member, job in lane.jobs.items() if job.stage != stages[member]]:
            lane.change_scene(member)
        self._save(lane)

    def _intervene(self, ensemble: Ensemble, jobs: Mapping[Member, Job]) -> None:
        """Put grains back that have left, then break arches. Beds are read together, and only those that are needed: to
        read one alone takes longer than many steps of it."""

        def beds(members: Sequence[Member]) -> Mapping[Member, Packing]:
            with ensemble.reading(members):
                return {member: ensemble.bed(member) for member in members}

        fed = beds([member for member, job in jobs.items() if job.lacks_grains])
        places = zip(fed, refill([jobs[member].refill(bed) for member, bed in fed.items()]), strict=True)
        entering = {member: grains for member, grains in places if grains is not None}
        ensemble.put_back_all(entering)
        for member, grains in entering.items():
            jobs[member].refilled(grains)
        for member, bed in beds([member for member, job in jobs.items() if job.pauses]).items():
            jobs[member].intervene(ensemble, member, bed)

    def _trace(self, lane: Lane, new: int, took: Turn) -> None:
        """Log a turn, so that it can be seen what waits for what."""
        if _TRACE.isEnabledFor(logging.DEBUG):
            kind = FillJob.kind if isinstance(next(iter(lane.jobs.values())), FillJob) else DischargeJob.kind
            placed = sum(job.is_placed for job in self._board.waiting.values())
            _TRACE.debug(
                "%8.3f s: %-7s %4d of %4d, %4d new, admitted in %.3f s, beat %.3f s; %d of %d placed, %d closing",
                time.perf_counter() - self._begun, kind, len(lane.jobs), lane.opened, new, took.admitting, took.wall,
                placed, len(self._board.waiting), len(self._closing.jobs),
            )  # fmt: skip

    def _fewer_at_once(self, lane: Lane, jobs: Sequence[Job], problem: MemoryError) -> None:
        """Let a lane go on with half as many of its jobs at once, each from its last save: what else the device does
        may have taken memory that was free when slots were counted."""
        lane.slots = max(1, len(jobs) // 2)
        self._slots = max(1, (len(jobs) + sum(len(one.jobs) for one in self._beside(lane))) // 2)
        for job in jobs:
            self._saved.pop(job, None)
            self._board.dropped(job)
        self._say(
            f"{problem}. They go on from their last checkpoints, {lane.slots} at once; to have more at once, end other "
            "programs on the device, or add devices (--device cuda:all)"
        )

    def _beside(self, lane: Lane) -> list[Lane]:
        """Other lanes with an ensemble on the same device."""
        return [one for one in self._lanes if self._shared and one is not lane and one.opened]

    def _save(self, lane: Lane) -> None:
        """Save jobs that have not been saved for `checkpoint_every`, the longest unsaved first, while saving has its
        part of the time: the lane stands still meanwhile. Those with many rows in memory are saved in any case."""
        assert lane.ensemble is not None
        for member, job in sorted(lane.jobs.items(), key=lambda one: self._saved[one[1]]):
            begun = time.perf_counter()
            allowed = max(_LONG, _SAVING * (begun - self._begun))
            waits = begun - self._saved[job] < self._checkpoint_every or lane.saving > allowed
            if waits and job.unsaved < _MOST_UNSAVED:
                continue
            job.save(lane.ensemble, member)
            self._saved[job] = time.perf_counter()
            lane.saving += self._saved[job] - begun

    def _end(self, lane: Lane, ended: Mapping[Member, tuple[Job, str]]) -> None:
        """End members with their verdicts: what they leave is read together, and their slots are free then."""
        assert lane.ensemble is not None
        left: list[EndState] = []
        try:
            with lane.ensemble.reading(ended):
                left += map(lane.ensemble.end_state, ended)
        finally:
            for member, (job, _) in ended.items():
                self._saved.pop(job, None)
                lane.retire(member)
        for (job, verdict), state in zip(ended.values(), left, strict=True):
            self._closing.close(job, verdict, state)

    def _leave(self, turns: "Turns", lanes: list[Lane]) -> None:
        """Let the turns end, and save what is not finished by then. Lanes that prepare have nothing to save."""
        while any(not lane.preparing for lane, _ in turns.values()):
            wait(turns, timeout=_LOOK, return_when=ALL_COMPLETED if self._shared else FIRST_COMPLETED)
            for turn in self._completed(turns):
                self._visit(*turns.pop(turn), turn)
        self.left_behind = bool(turns) or self._backend.compiling()
        waited = [lane for lane in lanes if lane not in [lane for lane, _ in turns.values()]]
        for lane in waited:
            for member, job in list(lane.jobs.items()):
                assert lane.ensemble is not None
                job.save(lane.ensemble, member)

    def announce(self, job: Job) -> None:
        """Report a job that takes a while to begin: placing many grains does."""
        grains = job.scene.grains.count
        if isinstance(job, FillJob) and grains >= _MANY:
            self.report(Going(job.label, "placing", (f"placing {grains} grains",)))

    def report(self, *beginning: Going) -> None:
        """Publish how all jobs stand, now and then. beginning: jobs that are being begun."""
        begun = time.perf_counter()
        if begun < self._next_report:
            return
        board = self._board
        done, asked = board.runs()
        going = (*beginning, *self._going())
        self.meter.look(idle=bool(going) and all(one.phase in _BEFORE_STEPS for one in going))
        view = View(
            runs_done=done,
            runs_asked=asked,
            fillings_left=board.fillings_left(),
            going=going,
            elsewhere=board.elsewhere,
            work_done=self.meter.work,
            work_left=board.work_left(),
            rate=self.meter.rate(),
            open_ended=board.open_ended(),
        )
        self._publisher.show(view)
        now = time.perf_counter()
        self._next_report = now + max(_LOOK, (now - begun) / _TELLING)  # counting 10^5 runs takes a while

    def _going(self) -> list[Going]:
        """What every job is at."""
        compiling = self._backend.compiling()
        at_work = {job for lane in self._lanes if not lane.preparing for job in list(lane.jobs.values())}
        found, closing, waiting = [], dict.fromkeys(self._closing.jobs), {*self._board.waiting.values()}
        for job in (*(job for job in self._board.going.values() if job not in closing), *closing):
            if job in closing:
                found.append(Going(job.label, "writing", ("writing and measuring",)))
            elif job in waiting:
                found.append(Going(job.label, "placing", ("placing grains",)))
            elif job in at_work:
                phase = "settling" if isinstance(job, FillJob) else "discharging"
                found.append(Going(job.label, phase, job.doing()))
            elif compiling:
                found.append(Going(job.label, "compiling", ("compiling, once for this kind of scene",)))
            else:
                found.append(Going(job.label, "preparing", ("preparing kernels",)))
        return found
