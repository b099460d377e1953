"""The queue of a study's missing fillings and runs, and the jobs that are active in this process."""

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
from labbook.plan.plan import Item, Plan, Planner, PointPlan, done_and_demanded, place_in_order
from labbook.plan.possible import specified
from labbook.run.discharge import DischargeJob
from labbook.run.fill import FillJob
from labbook.run.job import Job, JobContext, JobFailed, LabEntry
from labbook.run.shard import everything
from labbook.scene import Packing, Scene
from labbook.study.problems import and_others

_REFRESH_INTERVAL = 1.0  # s, at least, between two looks at what other processes have done
_REFRESH_SHARE = 0.05  # of the main thread's time may go into that
_MAX_COMPILED_AHEAD = 1000  # points, at most, whose kernels are compiled before they begin
PLACE_AHEAD_GRAINS = 50_000
"""Number of grains to place at once from which helper processes place them: that takes a second, as long as their
start."""
_MAX_REASON = 10_000  # characters, at most, of a reason that is kept
_EXTRAPOLATE_FROM = 0.05  # progress from which a discharge is extrapolated


@dataclass(eq=False)
class StartedJob:
    """A job that has begun: its start and the Spec that it needs."""

    job: Job
    start: Packing | Checkpoint
    spec: Spec


@dataclass
class Tally:
    """Numbers of runs and packings that ended in a session, and its failures.

    Args:
        ran: Outcome by run key, for the runs that ended in this session.
        resumed: Number of runs that continued from a checkpoint.
        packings: Number of packings made.
        failed: Reasons of failures.
        lost: Keys of runs and packings that failed, and of runs that needed them.
    """

    ran: dict[str, str] = field(default_factory=dict)
    resumed: int = 0
    packings: int = 0
    failed: list[str] = field(default_factory=list)
    lost: set[str] = field(default_factory=set)


@dataclass(frozen=True)
class PlacingPool:
    """Helper processes that place the grains of fillings while other jobs are stepped.

    Args:
        place: Submits a placement: closed scene, kind of start, seed.
        ahead: Maximum number of fillings whose grains are being placed, or wait for their ensemble.
    """

    place: Callable[[Scene, str, int], "Future[Packing]"]
    ahead: int


KINDS = frozenset({FillJob.kind, DischargeJob.kind})
EndedJob = tuple[Job, str, LabEntry]
"""A job whose output is in the lab, its verdict, and its lab entry."""


@contextmanager
def _release_on_error(claim: Claim | Job) -> Iterator[None]:
    """Release a claim if the body fails: otherwise no job of this process could get the key again."""
    try:
        yield
    except BaseException:
        claim.release()
        raise


class JobQueue:
    """Queue of a study's missing jobs: fillings first, then runs whose packings exist.

    Claims in the lab prevent two processes from running the same job.

    Args:
        context: Lab, backend and device.
        planner: Plans points again as results arrive.
        index: Index of the lab, to which ended jobs are added.
        observe: Measures and window of the study.
        packings_only: Make only the packings of the runs.
        holds: Decides which runs are made here.
        rest: Decides the same once those are done; None: no others.
    """

    def __init__(
        self, context: JobContext, planner: Planner, index: Index, observe: Observe, *, packings_only: bool = False,
        holds: Callable[[Demand], bool] = everything, later: Callable[[Demand], bool] | None = None,
    ):  # fmt: skip
        self._packings_only, self._own, self._holds, self._holds_later = packings_only, holds, holds, later
        self._expected_work: dict[str, float] = {}
        """Expected grain-steps, by key of the run or packing."""
        self._work_taken, self._work_forecast = 0.0, 0.0
        """Grain-steps of the discharges that ended here, and their forecast."""
        self._context, self._planner, self._index, self._observe = context, planner, index, observe
        self.tally = Tally()
        self.pending: dict[str, Item] = {}
        """Runs that have not begun, by key, in the order in which they begin."""
        self._is_sorted = True
        self._runs_by_packing: dict[str, set[str]] = defaultdict(set)
        """Keys of runs that were ever pending, by the key of their packing."""
        self.active: dict[str, Job] = {}
        self._other_specs: set[tuple[str, Spec]] = set()
        """(key, Spec) of jobs that turned out to need another Spec: to find out again would take long."""
        self.points: dict[int, PointPlan] = {}
        self._points_by_run: dict[str, set[int]] = defaultdict(set)
        """Indices of points, by the key of a run that they need: points with equal scenes share runs."""
        self._points_by_packing: dict[str, set[int]] = defaultdict(set)
        """Indices of points, by the key of a packing from which their runs start."""
        self._claimed_elsewhere: set[str] = set()
        """Keys of jobs that another process had claimed at the last refresh."""
        self._next_refresh = 0.0
        self.placing: PlacingPool | None = None
        """Helpers that place the grains of many fillings; None: they are placed when the filling begins."""
        self._ahead_decision: bool | None = False
        """Decision to place grains ahead; None: to be made, since runs were added."""
        self.being_placed: dict[str, FillJob] = {}
        """Claimed fillings that have not begun: their grains are being placed, or wait for an ensemble."""
        self.on_begin: Callable[[Job], None] = lambda job: None
        """Called before a job begins: placing many grains takes long."""

    @cached_property
    def _fill_times(self) -> Mapping[str, float]:
        """Mean simulated time of earlier fillings [s], by key of the closed scene; read once."""
        return self._planner.catalogue.settling()

    def load_plan(self, plan: Plan) -> None:
        """Add the points of a plan, and those that the study's strategy proposes."""
        for point in plan.points:
            self._add_point(point)
        self._add_proposed()
        self._remove_leftovers(plan.items)

    def _add_proposed(self) -> None:
        """Add points that the study's strategy proposes now."""
        while new := self._planner.proposed(self.points):
            for point in new:
                self._add_point(point)

    def _add_point(self, point: PointPlan) -> None:
        """Add a point whose pending runs have just been looked up."""
        self.points[point.shared.point.index] = point
        for item in point.items:
            self._add_run(item)

    def _add_run(self, item: Item) -> None:
        """Add a run whose state has just been looked up, if it is missing and belongs to this process."""
        key, index = item.keys.run, item.demand.point.index
        self._points_by_run[key].add(index)
        self._points_by_packing[item.keys.packing].add(index)
        # what ended here is not begun again: points with other guards could hand it to and fro
        is_known = key in self.active or key in self.tally.lost or key in self.tally.ran
        queued = self.pending.get(key)
        if self._lacks(item) and not is_known:
            self._is_sorted &= queued is not None and place_in_order(queued) == place_in_order(item)
            self._ahead_decision = self._ahead_decision or None
            self.pending[key] = item
            self._runs_by_packing[item.keys.packing].add(key)

    def _lacks(self, item: Item) -> bool:
        lacks = not item.packed if self._packings_only else item.state != "done"
        return lacks and self._holds(item.demand)

    def _remove_leftovers(self, items: Sequence[Item]) -> None:
        """Remove the unfinished work, or lock files, of processes that were killed after they put a result in place."""
        lab = self._context.lab
        done = {item.keys.run for item in items if item.state == "done"}
        done |= {item.keys.packing for item in items if item.packed}
        for key in done & lab.touched():
            if claim := lab.claim(key):
                with lab.alone(key):  # whose lock file goes with it
                    lab.clear(key)
                claim.release()

    def add_later(self) -> None:
        """Add the runs of `later`, some of which other processes may have claimed."""
        if self._holds_later is None:
            return
        self._holds, self._holds_later = self._holds_later, None
        for point in list(self.points.values()):
            self._add_point(self._planner.point(point))
        self._add_proposed()

    def expected(self) -> list[Expected]:
        """List the kernels that the first points need, with their numbers of members."""
        todo = self.pending.values()
        fillings = {item.keys.packing: item.demand.shared for item in todo if not item.packed}
        runs = [] if self._packings_only else [item.demand.shared for item in todo]
        expected_kernels = []
        for shared, count in islice(Counter(fillings.values()).items(), _MAX_COMPILED_AHEAD):
            filling, _ = specified(self._context.backend, shared)
            expected_kernels.append(Expected(filling, shared.closed, shared.filling_numerics, count))
        for shared, count in islice(Counter(runs).items(), _MAX_COMPILED_AHEAD):
            _, discharge = specified(self._context.backend, shared)
            expected_kernels.append(Expected(discharge, shared.scene, shared.numerics, count))
        return expected_kernels

    def members(self, spec: Spec) -> int:
        """Count the known fillings and runs, not done, that need `spec`."""
        keys = {key for key, job in self.active.items() if self._needs(job.demand, type(job)) == spec}
        for key, item in self.pending.items():
            if not item.packed and self._needs(item.demand, FillJob) == spec:
                keys.add(item.keys.packing)
            if not self._packings_only and self._needs(item.demand, DischargeJob) == spec:
                keys.add(key)
        return len(keys)

    def _needs(self, demand: Demand, kind: type[Job]) -> Spec:
        """Spec that a filling or a run of a demand needs."""
        filling, discharge = specified(self._context.backend, demand.shared)
        return filling if kind is FillJob else discharge

    @property
    def claimed_elsewhere(self) -> int:
        """Number of jobs that another process had claimed at the last refresh."""
        return len(self._claimed_elsewhere)

    def jobs(self, spec: Spec | None = None, kinds: Collection[str] = KINDS) -> Iterator[StartedJob]:
        """Begin jobs one after another, as far as this process can get them, fillings first.

        Args:
            spec: Spec that they need; None: that of the first one.
            kinds: Kinds of jobs to begin.
        """
        if self._claimed_elsewhere:
            self._refresh()
        self._sort()
        for key, job in list(self.being_placed.items()) if FillJob.kind in kinds else ():
            if job.is_placed and spec in (None, self._needs(job.demand, FillJob)):
                del self.being_placed[key]
                if started := self._begin(job, spec):
                    spec = started.spec
                    yield started
        for kind, begin_job, packed in ((FillJob.kind, self._fill, False), (DischargeJob.kind, self._discharge, True)):
            if kind not in kinds or (not packed and self._places_ahead()):
                continue
            for key in list(self.pending):  # `begin` may take some away, or find that they are packed
                item = self.pending.get(key)
                if item is None or item.packed != packed or (not packed and item.keys.packing in self.active):
                    continue
                if started := begin_job(item, spec):
                    spec = started.spec
                    yield started

    def _sort(self) -> None:
        """Sort the pending runs into the order in which they begin."""
        if not self._is_sorted:
            self.pending = dict(sorted(self.pending.items(), key=lambda entry: place_in_order(entry[1])))
            self._is_sorted = True

    def _places_ahead(self) -> bool:
        """Decide whether helpers place the grains of fillings before these begin."""
        if self.placing is None:
            return False
        if self._ahead_decision is None:
            lacking = {item.keys.packing: item for item in self.pending.values() if not item.packed}
            grains = sum(item.demand.point.scene.grains.count for item in lacking.values())
            self._ahead_decision = len(lacking) > 1 and grains >= PLACE_AHEAD_GRAINS
        return self._ahead_decision

    def place_ahead(self) -> None:
        """Claim the next fillings and let helpers place their grains, if there are enough grains to pay for the
        helpers."""
        if self.placing is None or not self._places_ahead():
            return
        if 2 * len(self.being_placed) > self.placing.ahead:  # a look at all runs takes a while
            return
        self._sort()
        for item in list(self.pending.values()):
            key = item.keys.packing
            if len(self.being_placed) >= self.placing.ahead:
                return
            if not (item.packed or key in self.active or key in self._claimed_elsewhere) and (
                job := self._claim_filling(item, self.placing)
            ):
                self.active[key] = self.being_placed[key] = job

    def _refresh(self) -> None:
        """Look up, from time to time, what other processes have done: to find out by claiming each run would take
        long."""
        start = time.perf_counter()
        if start < self._next_refresh:
            return
        self._claimed_elsewhere.clear()
        for previous in list(self.points.values()):
            point = self._planner.point(previous)
            done_elsewhere = {item.keys.run for item in point.items if item.state == "done"} & self.pending.keys()
            if self._index.derive(sorted(done_elsewhere), self._observe):  # decisions rest on what was just measured
                point = self._planner.point(previous)
            self._add_point(point)
        self._add_proposed()
        lacking = {item.keys.run for point in self.points.values() for item in point.items if self._lacks(item)}
        for key in self.pending.keys() - lacking:
            del self.pending[key]
        now = time.perf_counter()
        self._next_refresh = now + max(_REFRESH_INTERVAL, (now - start) / _REFRESH_SHARE)

    def _fill(self, item: Item, spec: Spec | None) -> StartedJob | None:
        key = item.keys.packing
        if key in self.active or (key, spec) in self._other_specs:
            return None
        job = self._claim_filling(item)
        return None if job is None else self._begin(job, spec)

    def _claim_filling(self, item: Item, placing: PlacingPool | None = None) -> FillJob | None:
        """Claim the filling that a run waits for; None if the packing exists, or another process has the claim.

        Args:
            item: A run.
            placing: Helpers that place its grains, if it starts with that.
        """
        key, lab, demand = item.keys.packing, self._context.lab, item.demand
        if self._is_in_lab(key):
            self._mark_packed(key)
            return None
        if (claim := self._claim(key)) is None:
            return None
        with _release_on_error(claim):
            if not self._is_in_lab(key):
                placed = None  # a file is read in this process, which knows where its content is
                placing = placing if demand.filling.file is None and demand.filling.stream is None else None
                if placing and demand.shared.packings_of is None and not (lab.work(key) / PROGRESS).exists():
                    placed = placing.place(demand.shared.closed, demand.filling.kind, demand.seed)
                return FillJob(self._context, demand, item.keys, claim, self._served_points(key), placed)
        claim.release()  # put there between the look and the claim
        self._mark_packed(key)
        return None

    def _claim(self, key: str) -> Claim | None:
        """Claim a key; None while another process has it."""
        claim = self._context.lab.claim(key)
        if claim is None:
            self._claimed_elsewhere.add(key)
        else:
            self._claimed_elsewhere.discard(key)
        return claim

    def _served_points(self, packing: str) -> str:
        """Label of the points whose runs start from a packing; empty if all points do."""
        indices = self._points_by_packing[packing]
        if len(indices) == len(self.points):
            return ""
        return self.points[min(indices)].shared.point.label + and_others(len(indices) - 1)

    def _is_in_lab(self, packing: str) -> bool:
        """Check that a packing is in the lab and can be read."""
        return self._planner.catalogue.packing_problem(packing) is None

    def _discharge(self, item: Item, spec: Spec | None) -> StartedJob | None:
        key, lab, backend = item.keys.run, self._context.lab, self._context.backend
        if (key, spec) in self._other_specs:
            return None
        fresh = item.state in ("missing", "stale")  # one that goes on may observe more
        if fresh and spec is not None and specified(backend, item.demand.shared)[1] != spec:
            return None
        if (claim := self._claim(key)) is None:
            return None
        with _release_on_error(claim):
            lab.recover(key, lab.run(key))
            current = self._planner.refresh(item)
        if current.state == "done":  # by another process, or when its packing was made again
            claim.release()
            self._index_runs({key: run_rows(lab.run(key), self._observe)})
            if key in self.pending:
                self._give_up(key, f"{self.pending[key].reason}, though its folder is complete: {lab.run(key)}")
            return None
        job = DischargeJob(self._context, item.demand, item.keys, claim, self._observe)
        return self._begin(job, spec)

    def _begin(self, job: Job, spec: Spec | None) -> StartedJob | None:
        with _release_on_error(job):
            self.on_begin(job)
            try:
                start = job.begin()
            except JobFailed as problem:
                self.record_failure(job, str(problem))
                return None
            finally:
                for folder, reason in job.damaged.items():
                    self._index.note(folder, reason)
            # Only now: what a resumed job observes, and so its Spec, follows from its save.
        needed = self._context.backend.specialise(job.widest, job.numerics, job.declared)
        if spec is not None and needed != spec:
            self.drop(job)
            self._other_specs.add((job.key, spec))
            return None
        self.active[job.key] = job
        if isinstance(job, DischargeJob):
            self.pending.pop(job.key, None)
        return StartedJob(job, start, needed)

    def record_ended(self, ended: Sequence[EndedJob]) -> None:
        """Record jobs whose output is in the lab: release their claims, and index them in one transaction."""
        for job, _, _ in ended:  # their folders are in place: who claims the keys now finds them done
            job.release()
            self.active.pop(job.key, None)
        fillings = [(job, entry) for job, _, entry in ended if isinstance(job, FillJob)]
        if fillings:
            self._record_packings(fillings)
        runs = [(job, verdict, entry) for job, verdict, entry in ended if not isinstance(job, FillJob)]
        if runs:
            self._record_runs(runs)

    def _record_packings(self, ended: Sequence[tuple[FillJob, LabEntry]]) -> None:
        problems = self._index.put_packings({job.folder: entry.rows[0] for job, entry in ended})
        for job, entry in ended:
            if problem := problems[job.folder]:
                self._give_up(job.key, f"{job.label}: {problem}")  # to make it once more would give the same
                continue
            if entry.packing is not None:
                stamp = entry.rows[0]["stamp"]
                remember_packing(job.folder, stamp, *entry.packing)
                self._planner.catalogue.note_packing(job.key, stamp)
            self.tally.packings += 1
            self._mark_packed(job.key)

    def _record_runs(self, ended: Sequence[EndedJob]) -> None:
        for job, verdict, _ in ended:
            self._work_taken += job.work
            self._work_forecast += job.progress() * self._estimate(job.key, job.demand, filling=False)
            self.tally.ran[job.key] = verdict
            self.tally.resumed += job.resumed
        problems = self._index_runs({job.key: entry.rows for job, _, entry in ended})
        self.tally.failed += [f"{job.label}: {problem}" for job, _, _ in ended if (problem := problems[job.key])]

    def _index_runs(self, ended: Mapping[str, RunRows]) -> dict[str, str | None]:
        """Index runs whose folders are in place, and plan their points again.

        Args:
            ended: Rows of each run, made by `run_rows`, by its key.

        Returns:
            Why each run cannot be read, by its key; None for readable ones.
        """
        lab = self._context.lab
        problems = self._index.put_runs({lab.run(key): rows for key, rows in ended.items()})
        done_by_point: dict[int, list[str]] = defaultdict(list)
        for key in ended:
            self.pending.pop(key, None)
            for index in self._points_by_run[key]:
                done_by_point[index].append(key)
        previous = {index: self.points[index] for index in done_by_point}
        for point in self._planner.after(self.points, {index: done_by_point[index] for index in sorted(done_by_point)}):
            index = point.shared.point.index
            self.points[index] = point
            # what is known of others that wait stands: their packings may have been made since they were looked at
            changed = [point.items[point.indices[key]] for key in done_by_point[index]]
            if len(point.items) > len(previous[index].items):
                changed += (item for item in point.items if item.keys.run not in previous[index].indices)
            for item in changed:
                if item.keys.run not in self.pending:
                    self._add_run(item)
        self._add_proposed()
        return {key: problems[lab.run(key)] for key in ended}

    def record_failure(self, job: Job, why: str) -> None:
        """Record the failure of a job; runs that wait for its packing are given up."""
        if isinstance(job, FillJob) and job.demand.shared.packings_of is None:
            # for a plan to tell; written while the claim on its folder is held
            reason = why.removeprefix(f"{job.label}: ")[:_MAX_REASON]
            FillingFailure(why=reason, max_time=job.max_time).write(job.journal.folder)
        job.release()
        self.active.pop(job.key, None)
        self._give_up(job.key, why)

    def _give_up(self, lost_key: str, reason: str) -> None:
        """Remove the run or packing with this key, and the runs that wait for it."""
        self.tally.failed.append(reason)
        for key, item in list(self.pending.items()):
            if lost_key in (key, item.keys.packing):
                self.tally.lost.add(key)
                del self.pending[key]
        self.tally.lost.add(lost_key)

    def drop(self, job: Job) -> None:
        """Release a job that was saved and is continued later."""
        job.release()
        self.active.pop(job.key, None)

    def _mark_packed(self, key: str) -> None:
        self._claimed_elsewhere.discard(key)
        for run in self._runs_by_packing[key] & self.pending.keys():
            if self._packings_only:
                del self.pending[run]
            else:
                self.pending[run] = replace(self.pending[run], packed=True)

    # for progress

    def count_runs(self) -> tuple[int, int]:
        """Number of runs that are done, and of all demanded so far; a run that several points share counts once."""
        return done_and_demanded(self.points.values(), self._own)

    def fillings_left(self) -> int:
        """Number of packings that pending runs need, also those being made."""
        return len({item.keys.packing for item in self._own_pending().values() if not item.packed})

    def _own_pending(self) -> dict[str, Item]:
        """Pending runs of this process's own part: other processes report the rest."""
        if self._own is self._holds:
            return self.pending
        return {key: item for key, item in self.pending.items() if self._own(item.demand)}

    def open_ended(self) -> bool:
        """True if a job takes longer than expected, so that `work_left` is a lower bound."""
        return any(job.open_ended for job in self.active.values())

    def work_left(self) -> float:
        """Estimate the grain-steps that are left.

        Discharges past 5 % are extrapolated from the work they took. The forecast of the others is scaled by the ratio
        of actual to forecast work so far.
        """
        todo = self._own_pending()
        waiting = {item.keys.packing: item.demand for item in todo.values() if not item.packed}
        runs = {} if self._packings_only else todo
        remaining = sum(
            self._estimate(key, demand, filling=True) for key, demand in waiting.items() if key not in self.active
        )
        forecast = sum(self._estimate(key, item.demand, filling=False) for key, item in runs.items())
        work_taken, expected = self._work_taken, self._work_forecast
        for key, job in self.active.items():
            progress, filling = job.progress(), isinstance(job, FillJob)
            estimate = self._estimate(key, job.demand, filling=filling)
            if filling:
                remaining += (1 - progress) * estimate
            elif progress < _EXTRAPOLATE_FROM:
                forecast += (1 - progress) * estimate
            else:
                remaining += (1 - progress) / progress * job.work
                work_taken, expected = work_taken + job.work, expected + progress * estimate
        return remaining + forecast * (work_taken / expected if expected else 1.0)

    def _estimate(self, key: str, demand: Demand, *, filling: bool) -> float:
        if key not in self._expected_work:
            self._expected_work[key] = fill_work(demand, self._fill_times) if filling else discharge_work(demand.shared)
        return self._expected_work[key]
