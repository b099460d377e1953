"""What is still to be done, and who does it: fillings first, then the runs whose packings are there."""

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice

from labbook.backend import Checkpoint, Expected, Spec
from labbook.lab.folder import Claim
from labbook.lab.index import Index, RunRows, run_rows
from labbook.lab.journal import PROGRESS, FillingFailure
from labbook.lab.packings import remember_packing
from labbook.lab.records import Observe
from labbook.plan.demand import Demand
from labbook.plan.forecast import discharge_work, fill_work
from labbook.plan.plan import Item, Plan, Planner, PointPlan, counted, place_in_order
from labbook.plan.possible import specified
from labbook.run.discharge import DischargeJob
from labbook.run.fill import FillJob
from labbook.run.job import Bench, Job, JobFailed, LabEntry
from labbook.run.shard import everything
from labbook.scene import Packing, Scene
from labbook.study.problems import and_others

_BETWEEN = 1.0  # s, at least, between two looks at what other processes have done
_LOOKING = 0.05  # of the main thread's time may go into that
_AHEAD = 1000  # points, at most, whose kernels are compiled before they begin
TOGETHER = 50_000
"""Grains of fillings that begin at once from which on other processes place them: it takes about a second, as it takes
to start these."""
_SAID = 10_000  # characters, at most, of a reason that is kept
_SOME_WAY = 0.05  # progress from which a discharge is extrapolated


@dataclass(eq=False)
class Started:
    """A job that has been begun: where it starts, and the Spec that it needs."""

    job: Job
    start: Packing | Checkpoint
    spec: Spec


@dataclass
class Tally:
    """What came of it."""

    ran: dict[str, str] = field(default_factory=dict)
    """Outcome by run key, of the runs that were done here."""
    resumed: int = 0
    packings: int = 0
    failed: list[str] = field(default_factory=list)
    lost: set[str] = field(default_factory=set)
    """Keys of the runs and packings that failed, and of runs that waited for these."""


@dataclass(frozen=True)
class Placing:
    """Processes that place the grains of fillings, while others are stepped."""

    place: Callable[[Scene, str, int], "Future[Packing]"]
    """Lets the grains of a closed scene be placed by a kind of start and a seed."""
    ahead: int
    """Fillings, at most, whose grains are being placed or wait for their ensemble."""


KINDS = frozenset({FillJob.kind, DischargeJob.kind})
Ended = tuple[Job, str, LabEntry]
"""A job whose content is in the lab, how it ended, and what the lab has of it."""


@contextmanager
def _given_back(held: Claim | Job) -> Iterator[None]:
    """Releases a claim if what is done within fails: nobody in this process could have its key again."""
    try:
        yield
    except BaseException:
        held.release()
        raise


class Board:
    """The study's runs that are not done, and the jobs that are going on here.

    `packings_only`: only the packings of the runs are asked for. `holds`: whether a run is done here;
    `rest`: whether it is, once the former are.
    """

    def __init__(
        self, bench: Bench, planner: Planner, index: Index, observe: Observe, *, packings_only: bool = False,
        holds: Callable[[Demand], bool] = everything, rest: Callable[[Demand], bool] | None = None,
    ):  # fmt: skip
        self._packings_only, self._own, self._holds, self._rest = packings_only, holds, holds, rest
        self._work: dict[str, float] = {}
        """Expected grain-steps, by the key of a run or packing."""
        self._took, self._foreseen = 0.0, 0.0
        """Grain-steps that discharges took which have ended here, and what was forecast for as much progress."""
        self._bench, self._planner, self._index, self._observe = bench, planner, index, observe
        self.tally = Tally()
        self.todo: dict[str, Item] = {}
        """By run key, in the order in which runs are begun."""
        self._ordered = True
        self._starting: dict[str, set[str]] = defaultdict(set)
        """Keys of runs, once to do, by the key of the packing that they start from."""
        self.going: dict[str, Job] = {}
        self._unfit: set[tuple[str, Spec]] = set()
        """Keys of jobs that need another Spec than one that was asked for: beginning a job to learn that is dear."""
        self.points: dict[int, PointPlan] = {}
        self._sharing: dict[str, set[int]] = defaultdict(set)
        """Points by the key of a run that they ask for: points with the same scene share runs."""
        self._standing: dict[str, set[int]] = defaultdict(set)
        """Points by the key of the packing that their runs start from."""
        self._elsewhere: set[str] = set()
        """Keys of jobs that another process was found to hold at the last look."""
        self._next_look = 0.0
        self.placing: Placing | None = None
        """Places the grains of many fillings; None: each when it is begun."""
        self._ahead: bool | None = False
        """True if grains are placed ahead; None: there are new runs, so that it is to be decided anew."""
        self.waiting: dict[str, FillJob] = {}
        """Fillings that are going on, but have not begun: their grains are being placed, or wait for an ensemble."""
        self.beginning: Callable[[Job], None] = lambda job: None
        """Called before a job is begun: placing many grains takes a while."""

    @cached_property
    def _settled(self) -> Mapping[str, float]:
        """How long fillings took before this process made any."""
        return self._planner.catalogue.settling()

    def pin(self, plan: Plan) -> None:
        """Take up a plan."""
        for point in plan.points:
            self._take(point)
        self._take_proposed()
        self._tidy(plan.items)

    def _take_proposed(self) -> None:
        """Take up what the strategy of the study proposes now."""
        while new := self._planner.proposed(self.points):
            for point in new:
                self._take(point)

    def _take(self, point: PointPlan) -> None:
        """Take up a point all runs of which that wait were looked at just now."""
        self.points[point.shared.point.index] = point
        for item in point.items:
            self._take_run(item)

    def _take_run(self, item: Item) -> None:
        """Take up a run that was looked at just now."""
        key, index = item.keys.run, item.demand.point.index
        self._sharing[key].add(index)
        self._standing[item.keys.packing].add(index)
        # what ended here is not begun again: points with other guards could hand it to and fro
        known = key in self.going or key in self.tally.lost or key in self.tally.ran
        had = self.todo.get(key)
        if self._lacks(item) and not known:
            self._ordered &= had is not None and place_in_order(had) == place_in_order(item)
            self._ahead = self._ahead or None
            self.todo[key] = item
            self._starting[item.keys.packing].add(key)

    def _lacks(self, item: Item) -> bool:
        lacks = not item.packed if self._packings_only else item.state != "done"
        return lacks and self._holds(item.demand)

    def _tidy(self, items: Sequence[Item]) -> None:
        """Remove what processes left in the work folder that were killed after they had put a run or packing in place:
        its unfinished work, or only the lock file."""
        lab = self._bench.lab
        done = {item.keys.run for item in items if item.state == "done"}
        done |= {item.keys.packing for item in items if item.packed}
        for key in done & lab.touched():
            if claim := lab.claim(key):
                with lab.alone(key):  # whose lock file goes with it
                    lab.clear(key)
                claim.release()

    def widen(self) -> None:
        """Take up runs of the `rest`, of which others may hold some."""
        if self._rest is None:
            return
        self._holds, self._rest = self._rest, None
        for point in list(self.points.values()):
            self._take(self._planner.point(point))
        self._take_proposed()

    def expected(self) -> list[Expected]:
        """What fillings and runs need, of the first points. Kernels are chosen by how many members there are."""
        todo = self.todo.values()
        fillings = {item.keys.packing: item.demand.shared for item in todo if not item.packed}
        runs = [] if self._packings_only else [item.demand.shared for item in todo]
        found = []
        for of, count in islice(Counter(fillings.values()).items(), _AHEAD):
            filling, _ = specified(self._bench.backend, of)
            found.append(Expected(filling, of.closed, of.filled_by, count))
        for of, count in islice(Counter(runs).items(), _AHEAD):
            _, discharge = specified(self._bench.backend, of)
            found.append(Expected(discharge, of.scene, of.numerics, count))
        return found

    def members(self, spec: Spec) -> int:
        """Fillings and runs, not done, that need `spec`, as far as is known."""
        keys = {key for key, job in self.going.items() if self._needs(job.demand, type(job)) == spec}
        for key, item in self.todo.items():
            if not item.packed and self._needs(item.demand, FillJob) == spec:
                keys.add(item.keys.packing)
            if not self._packings_only and self._needs(item.demand, DischargeJob) == spec:
                keys.add(key)
        return len(keys)

    def _needs(self, demand: Demand, kind: type[Job]) -> Spec:
        """The set of features of a filling or a run."""
        filling, discharge = specified(self._bench.backend, demand.shared)
        return filling if kind is FillJob else discharge

    @property
    def elsewhere(self) -> int:
        """Jobs that another process was found to hold at the last look."""
        return len(self._elsewhere)

    def jobs(self, spec: Spec | None = None, kinds: Collection[str] = KINDS) -> Iterator[Started]:
        """Begin one job after another: all that this process can have now, fillings first.

        Args:
            spec: The set of features that they need; None: that of the first one.
            kinds: Their kinds.
        """
        if self._elsewhere:
            self._look_around()
        self._sort()
        for key, job in list(self.waiting.items()) if FillJob.kind in kinds else ():
            if job.is_placed and spec in (None, self._needs(job.demand, FillJob)):
                del self.waiting[key]
                if started := self._begin(job, spec):
                    spec = started.spec
                    yield started
        for kind, begin, packed in ((FillJob.kind, self._fill, False), (DischargeJob.kind, self._discharge, True)):
            if kind not in kinds or (not packed and self._places_ahead()):
                continue
            for key in list(self.todo):  # `begin` may take some away, or find that they are packed
                item = self.todo.get(key)
                if item is None or item.packed != packed or (not packed and item.keys.packing in self.going):
                    continue
                if started := begin(item, spec):
                    spec = started.spec
                    yield started

    def _sort(self) -> None:
        """Bring runs into the order in which they are begun."""
        if not self._ordered:
            self.todo = dict(sorted(self.todo.items(), key=lambda one: place_in_order(one[1])))
            self._ordered = True

    def _places_ahead(self) -> bool:
        """Tell if other processes place the grains of fillings before these begin."""
        if self.placing is None:
            return False
        if self._ahead is None:
            lacking = {item.keys.packing: item for item in self.todo.values() if not item.packed}
            grains = sum(item.demand.point.scene.grains.count for item in lacking.values())
            self._ahead = len(lacking) > 1 and grains >= TOGETHER
        return self._ahead

    def place_ahead(self) -> None:
        """Claim the next fillings and let other processes place their grains, if that takes long enough to start these
        processes."""
        if self.placing is None or not self._places_ahead():
            return
        if 2 * len(self.waiting) > self.placing.ahead:  # a look at all runs takes a while
            return
        self._sort()
        for item in list(self.todo.values()):
            key = item.keys.packing
            if len(self.waiting) >= self.placing.ahead:
                return
            if not (item.packed or key in self.going or key in self._elsewhere) and (
                job := self._filling(item, self.placing)
            ):
                self.going[key] = self.waiting[key] = job

    def _look_around(self) -> None:
        """Take up what other processes have done, now and then: to find out run by run, by claiming each, is dear."""
        begun = time.perf_counter()
        if begun < self._next_look:
            return
        self._elsewhere.clear()
        for before in list(self.points.values()):
            point = self._planner.point(before)
            new = {item.keys.run for item in point.items if item.state == "done"} & self.todo.keys()
            if self._index.derive(sorted(new), self._observe):  # decisions rest on what was just measured
                point = self._planner.point(before)
            self._take(point)
        self._take_proposed()
        lacking = {item.keys.run for point in self.points.values() for item in point.items if self._lacks(item)}
        for key in self.todo.keys() - lacking:
            del self.todo[key]
        now = time.perf_counter()
        self._next_look = now + max(_BETWEEN, (now - begun) / _LOOKING)

    def _fill(self, item: Item, spec: Spec | None) -> Started | None:
        key = item.keys.packing
        if key in self.going or (key, spec) in self._unfit:
            return None
        job = self._filling(item)
        return None if job is None else self._begin(job, spec)

    def _filling(self, item: Item, placing: Placing | None = None) -> FillJob | None:
        """The filling that a run waits for, claimed; None if it is made already, or held by another process.

        placing: lets its grains be placed, if it starts with that.
        """
        key, lab, demand = item.keys.packing, self._bench.lab, item.demand
        if self._there(key):
            self._packed(key)
            return None
        if (claim := self._claim(key)) is None:
            return None
        with _given_back(claim):
            if not self._there(key):
                placed = None  # a file is read in this process, which knows where its content is
                placing = placing if demand.filling.file is None and demand.filling.stream is None else None
                if placing and demand.shared.packings_of is None and not (lab.work(key) / PROGRESS).exists():
                    placed = placing.place(demand.shared.closed, demand.filling.kind, demand.seed)
                return FillJob(self._bench, demand, item.keys, claim, self._served(key), placed)
        claim.release()  # put there between the look and the claim
        self._packed(key)
        return None

    def _claim(self, key: str) -> Claim | None:
        """The right to work on a key, or None while another process has it."""
        claim = self._bench.lab.claim(key)
        if claim is None:
            self._elsewhere.add(key)
        else:
            self._elsewhere.discard(key)
        return claim

    def _served(self, packing: str) -> str:
        """The points whose runs start from a packing, in words; empty if those are all points."""
        of = self._standing[packing]
        if len(of) == len(self.points):
            return ""
        return self.points[min(of)].shared.point.label + and_others(len(of) - 1)

    def _there(self, packing: str) -> bool:
        """Whether a packing is in the lab, and whole."""
        return self._planner.catalogue.packing_problem(packing) is None

    def _discharge(self, item: Item, spec: Spec | None) -> Started | None:
        key, lab, backend = item.keys.run, self._bench.lab, self._bench.backend
        if (key, spec) in self._unfit:
            return None
        fresh = item.state in ("missing", "stale")  # one that goes on may observe more
        if fresh and spec is not None and specified(backend, item.demand.shared)[1] != spec:
            return None
        if (claim := self._claim(key)) is None:
            return None
        with _given_back(claim):
            lab.mend(key, lab.run(key))
            now = self._planner.refresh(item)
        if now.state == "done":  # by another process, or when its packing was made again
            claim.release()
            self._done({key: run_rows(lab.run(key), self._observe)})
            if key in self.todo:
                self._lose(key, f"{self.todo[key].reason}, though its folder is complete: {lab.run(key)}")
            return None
        job = DischargeJob(self._bench, item.demand, item.keys, claim, self._observe)
        return self._begin(job, spec)

    def _begin(self, job: Job, spec: Spec | None) -> Started | None:
        with _given_back(job):
            self.beginning(job)
            try:
                start = job.begin()
            except JobFailed as problem:
                self.failed(job, str(problem))
                return None
            finally:
                for folder, why in job.damaged.items():
                    self._index.note(folder, why)
            needed = self._bench.backend.specialise(job.widest, job.numerics, job.declared)
        if spec is not None and needed != spec:
            self.dropped(job)
            self._unfit.add((job.key, spec))
            return None
        self.going[job.key] = job
        if isinstance(job, DischargeJob):
            self.todo.pop(job.key, None)
        return Started(job, start, needed)

    def finished(self, ended: Sequence[Ended]) -> None:
        """Take up jobs whose content has been put into the lab, in one transaction of the index."""
        for job, _, _ in ended:
            job.release()
            self.going.pop(job.key, None)
        fillings = [(job, entry) for job, _, entry in ended if isinstance(job, FillJob)]
        if fillings:
            self._filled(fillings)
        runs = [(job, verdict, entry) for job, verdict, entry in ended if not isinstance(job, FillJob)]
        if runs:
            self._discharged(runs)

    def _filled(self, ended: Sequence[tuple[FillJob, LabEntry]]) -> None:
        problems = self._index.put_packings({job.place: entry.rows[0] for job, entry in ended})
        for job, entry in ended:
            if problem := problems[job.place]:
                self._lose(job.key, f"{job.label}: {problem}")  # to make it once more would give the same
                continue
            if entry.packing is not None:
                stamp = entry.rows[0]["stamp"]
                remember_packing(job.place, stamp, *entry.packing)
                self._planner.catalogue.note_packing(job.key, stamp)
            self.tally.packings += 1
            self._packed(job.key)

    def _discharged(self, ended: Sequence[Ended]) -> None:
        for job, verdict, _ in ended:
            self._took += job.work
            self._foreseen += job.progress() * self._estimate(job.key, job.demand, filling=False)
            self.tally.ran[job.key] = verdict
            self.tally.resumed += job.resumed
        problems = self._done({job.key: entry.rows for job, _, entry in ended})
        self.tally.failed += [f"{job.label}: {problem}" for job, _, _ in ended if (problem := problems[job.key])]

    def _done(self, ended: Mapping[str, RunRows]) -> dict[str, str | None]:
        """Index runs that are in their folders, and see what their points ask for now.

        Args:
            ended: What `run_rows` gives of each, by its key.

        Returns:
            Why each cannot be read; None for one that can.
        """
        lab = self._bench.lab
        problems = self._index.put_runs({lab.run(key): rows for key, rows in ended.items()})
        done: dict[int, list[str]] = defaultdict(list)
        for key in ended:
            self.todo.pop(key, None)
            for index in self._sharing[key]:
                done[index].append(key)
        before = {index: self.points[index] for index in done}
        for point in self._planner.after(self.points, {index: done[index] for index in sorted(done)}):
            index = point.shared.point.index
            self.points[index] = point
            # what is known of others that wait stands: their packings may have been made since they were looked at
            looked_at = [point.items[point.places[key]] for key in done[index]]
            if len(point.items) > len(before[index].items):
                looked_at += (item for item in point.items if item.keys.run not in before[index].places)
            for item in looked_at:
                if item.keys.run not in self.todo:
                    self._take_run(item)
        self._take_proposed()
        return {key: problems[lab.run(key)] for key in ended}

    def failed(self, job: Job, why: str) -> None:
        """A job came to nothing; runs that wait for its packing are given up."""
        if isinstance(job, FillJob) and job.demand.shared.packings_of is None:
            # for a plan to tell; written while the claim on its folder is held
            reason = why.removeprefix(f"{job.label}: ")[:_SAID]
            FillingFailure(why=reason, max_time=job.max_time).write(job.journal.folder)
        job.release()
        self.going.pop(job.key, None)
        self._lose(job.key, why)

    def _lose(self, lost: str, why: str) -> None:
        """Give up the run or packing with this key, and what waits for it."""
        self.tally.failed.append(why)
        for key, item in list(self.todo.items()):
            if lost in (key, item.keys.packing):
                self.tally.lost.add(key)
                del self.todo[key]
        self.tally.lost.add(lost)

    def dropped(self, job: Job) -> None:
        """A job was saved and is left for another time."""
        job.release()
        self.going.pop(job.key, None)

    def _packed(self, key: str) -> None:
        self._elsewhere.discard(key)
        for run in self._starting[key] & self.todo.keys():
            if self._packings_only:
                del self.todo[run]
            else:
                self.todo[run] = replace(self.todo[run], packed=True)

    # for progress

    def runs(self) -> tuple[int, int]:
        """Runs done, and runs asked for so far; one that several points share counts once."""
        return counted(self.points.values(), self._own)

    def fillings_left(self) -> int:
        """Packings that runs still wait for, also those being made."""
        return len({item.keys.packing for item in self._mine().values() if not item.packed})

    def _mine(self) -> dict[str, Item]:
        """What is still to do of this process's own part: the rest is told by others."""
        if self._own is self._holds:
            return self.todo
        return {key: item for key, item in self.todo.items() if self._own(item.demand)}

    def open_ended(self) -> bool:
        """Whether a job goes on for longer than expected, so that more work may be left than `work_left` says."""
        return any(job.open_ended for job in self.going.values())

    def work_left(self) -> float:
        """Grain-steps still to be done here, as far as can be told.

        Discharges past 5 % are extrapolated from the work they took. The others are scaled by the ratio of actual to
        forecast work so far.
        """
        todo = self._mine()
        waiting = {item.keys.packing: item.demand for item in todo.values() if not item.packed}
        runs = {} if self._packings_only else todo
        left = sum(self._estimate(key, d, filling=True) for key, d in waiting.items() if key not in self.going)
        foreseen = sum(self._estimate(key, item.demand, filling=False) for key, item in runs.items())
        took, expected = self._took, self._foreseen
        for key, job in self.going.items():
            done, filling = job.progress(), isinstance(job, FillJob)
            estimate = self._estimate(key, job.demand, filling=filling)
            if filling:
                left += (1 - done) * estimate
            elif done < _SOME_WAY:
                foreseen += (1 - done) * estimate
            else:
                left += (1 - done) / done * job.work
                took, expected = took + job.work, expected + done * estimate
        return left + foreseen * (took / expected if expected else 1.0)

    def _estimate(self, key: str, demand: Demand, *, filling: bool) -> float:
        if key not in self._work:
            self._work[key] = fill_work(demand, self._settled) if filling else discharge_work(demand.shared)
        return self._work[key]
