"""A study on the workers of a Dask cluster, which share neither files nor a database with this machine.

A task is a batch of runs with their packings. A worker runs it in a temporary lab, for some minutes at most, and
returns what is finished, and checkpoints of the rest: files as bytes. Here they pass the checks of `labbook import` and
are put in place; what is not finished becomes a task again. So a lost worker costs the minutes since its task began.
Only tasks of lost workers are repeated: an outcome of a run is physics.
"""

import os
import secrets
import shutil
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from labbook.backend import BackendMissing, Unsupported, load
from labbook.lab import studies
from labbook.lab.catalogue import Catalogue
from labbook.lab.folder import LabError, LabFolder, is_derived, room
from labbook.lab.index import Index
from labbook.lab.journal import PROGRESS, Progress
from labbook.lab.merge import merge
from labbook.lab.records import Observe, Unreadable
from labbook.plan.demand import Demand
from labbook.plan.forecast import discharge_work, fill_work
from labbook.plan.plan import Item, Plan, Planner
from labbook.run.job_queue import Tally
from labbook.run.runner import Runner
from labbook.run.shard import everything
from labbook.run.slurm import differs, expected
from labbook.run.stopping import StopRequest
from labbook.run.summary import Summary
from labbook.run.watch import ActiveJob, Meter, NullWatcher, View, Watcher
from labbook.scene import attached
from labbook.study import Study

TASK_TIME = 300.0
"""Wall time after which a task returns its results [s], the most that a lost worker costs."""
_TASKS_PER_SLOT = 4
"""Number of tasks for each slot of the cluster, so that all slots finish at about the same time."""
_MAX_LOSSES = 20
"""Maximum number of times that a task is repeated after its worker was lost: it may be the cause."""
_POLL_INTERVAL = 0.5  # s
STOP_INTERVAL, _VIEW_INTERVAL = 2.0, 2.0  # s
_GATHER_TIME = 60.0  # s that workers have to return their results when a stop is requested

Files = dict[str, bytes]


class ClusterFailed(Exception):
    """The cluster cannot be reached, or has no suitable workers; the message gives reason and remedy."""


@dataclass(frozen=True)
class Task:
    """A task for a worker.

    Args:
        study: The study, with the points of the task.
        backend: Name of the backend.
        device: Device of the worker.
        expected: Versions and hash that the worker must have (`labbook.run.slurm.expected`).
        repeats: (seed, discharge) of the runs, by index of the point.
        packings: Files of packings from which runs start, by key.
        runs: Files of runs that are continued, by key.
        works: Files of unfinished work, by key.
        slice: Wall time after which results are returned [s].
        stop: Name of the event that asks all workers to stop.
        attached: Contents of the files that the study names, by hash.
    """

    study: Study
    backend: str
    device: str
    expected: str
    repeats: Mapping[int, tuple[tuple[int, int], ...]]
    packings: Mapping[str, Files]
    runs: Mapping[str, Files]
    works: Mapping[str, Files]
    slice: float
    stop: str
    attached: Mapping[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class TaskResult:
    """Result of a task: files of folders by key, and counts of its runs.

    Args:
        packings: Files of finished packings, by key.
        runs: Files of finished runs, by key.
        works: Files of unfinished work, by key.
        ran: Outcome of the runs that ended, by key.
        resumed: Number of runs that continued from a checkpoint.
        failed: Reasons of failures.
        lost: Keys of the runs and packings that failed.
        refused: Why the worker cannot run the task at all; empty if it can.
        work: Grain-steps.
    """

    packings: dict[str, Files] = field(default_factory=dict)
    runs: dict[str, Files] = field(default_factory=dict)
    works: dict[str, Files] = field(default_factory=dict)
    ran: dict[str, str] = field(default_factory=dict)
    resumed: int = 0
    failed: tuple[str, ...] = ()
    lost: frozenset[str] = frozenset()
    refused: str = ""
    work: float = 0.0


def carry_out(task: Task) -> TaskResult:
    """Run a task on this worker, in a temporary folder."""
    for content in task.attached.values():
        attached.add(content)
    try:
        backend = load(task.backend)
        if changed := differs(task.expected, task.study, backend.capabilities):
            return TaskResult(refused=f"{changed} on a worker: install the same versions there")
        with tempfile.TemporaryDirectory(prefix="labbook-") as scratch:
            return _run_task(task, LabFolder(Path(scratch)), backend)
    except (BackendMissing, Unsupported, ImportError, LabError) as problem:
        return TaskResult(refused=f"{type(problem).__name__}: {problem}")


def _run_task(task: Task, lab: LabFolder, backend: Any) -> TaskResult:
    for folders, path_of in ((task.packings, lab.packing), (task.runs, lab.run), (task.works, lab.work)):
        for key, files in folders.items():
            write(path_of(key), files)
    points = tuple(point for point in task.study.points if point.index in task.repeats)
    request, is_over = StopRequest(), threading.Event()
    timer = threading.Thread(target=_stop_when_due, args=(task.slice, _stop_check(task), request, is_over), daemon=True)
    timer.start()
    try:
        workers = 1 if task.device == "cpu" else None  # a Dask worker's thread steps one ensemble
        study = replace(task.study, points=points)
        summary = Runner(
            study, lab, backend, task.device, task.slice, workers=workers, repeats=task.repeats, request=request
        ).run()
    finally:
        is_over.set()
        timer.join()
    packings = {
        key: files for key in _names(lab.packings) if key not in task.packings and (files := read(lab.packing(key)))
    }
    runs = {key: files for key in _names(lab.runs) if (files := read(lab.run(key))) != task.runs.get(key)}
    works = {key: files for key in lab.working() if PROGRESS in (files := read(lab.work(key)))}
    return TaskResult(
        packings,
        runs,
        works,
        summary.tally.ran,
        summary.tally.resumed,
        summary.failed,
        frozenset(summary.tally.lost),
        work=summary.work_done,
    )


def _stop_check(task: Task) -> Callable[[], bool]:
    """Return a function that tells whether all workers are asked to stop."""
    from distributed import Event, get_client  # pyright: ignore[reportMissingImports]

    try:
        event = Event(task.stop, client=get_client())
    except ValueError:  # outside a worker there is nobody to ask
        return lambda: False
    return lambda: bool(event.is_set())


def _stop_when_due(slice: float, is_asked: Callable[[], bool], request: StopRequest, is_over: threading.Event) -> None:
    """Request a stop when the task's time is over, or when all workers are asked to stop."""
    end = time.monotonic() + slice
    while not is_over.wait(STOP_INTERVAL):
        if time.monotonic() >= end:
            request.requested = True
        with suppress(Exception):  # the scheduler is away for a while
            request.requested = request.requested or is_asked()


def read(folder: Path) -> Files:
    """Read the files of a run, packing or work folder, without evaluations, which can be made again."""
    try:
        entries = [entry for entry in os.scandir(folder) if entry.is_file(follow_symlinks=False)]
    except FileNotFoundError:
        return {}
    return {
        entry.name: Path(entry.path).read_bytes()
        for entry in sorted(entries, key=lambda entry: entry.name)
        if not (is_derived(entry.name) and entry.name != "picture.png") and not entry.name.startswith(".")
    }


def write(folder: Path, files: Files) -> None:
    """Write files into a new folder. Raises Unreadable for names that would lead out of it."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        if name != os.path.basename(name) or name in ("", ".", ".."):
            raise Unreadable(f"{folder}: {name!r} is not the name of a file")
        (folder / name).write_bytes(content)


def _names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in os.scandir(folder) if entry.is_dir()) if folder.is_dir() else []


@dataclass(eq=False)
class Batch:
    """A submitted task: its runs, and the number of workers lost while they ran it."""

    items: list[Item]
    losses: int = 0

    @property
    def keys(self) -> set[str]:
        """Keys that its result may have."""
        return {key for item in self.items for key in (item.keys.run, item.keys.packing)}


@dataclass(eq=False)
class Cluster:
    """Runs a study in a lab on a Dask cluster, otherwise like `Runner`.

    Args:
        study: Study to run.
        lab: Folder of the lab.
        backend: Name of the backend.
        address: Address of the cluster's scheduler.
        device: Device of every worker. Workers with GPUs declare a resource: `dask worker --resources GPU=1`.
        slice: Wall time after which a task returns its results [s].
        watcher: Receives progress.
    """

    study: Study
    lab: LabFolder
    backend: str
    address: str
    device: str = "cpu"
    slice: float = TASK_TIME
    watcher: Watcher = field(default_factory=NullWatcher)

    def run(self) -> Summary:
        """Run what is missing. Ctrl-C asks all workers for their results, and ends early; the same command continues.

        Raises ClusterFailed, and what `Runner.run` raises, except DiskFull of workers.
        """
        from distributed import Client, Event  # pyright: ignore[reportMissingImports]

        start = time.perf_counter()
        self._meter, self._tally, self.problems = Meter(), Tally(), dict[str, None]()
        self._event = f"labbook-stop-{secrets.token_hex(8)}"
        self._failed_keys: set[str] = set()
        self._next_view = 0.0
        self._expected = expected(self.study, load(self.backend).capabilities)
        self.observe = Observe.of(self.study.measure, self.study.window)
        try:
            client = Client(self.address, timeout="20s", set_as_default=False)
        except (OSError, ValueError) as error:
            raise ClusterFailed(
                f"no scheduler answers at {self.address}: {error}; start one: labbook cluster local"
            ) from error
        request = StopRequest()
        with room(self.lab.folder):
            index = Index(self.lab)
            study, files = self.study, self.study.beside.files
            studies.attach(self.lab, files.values())
            studies.keep(self.lab, study.name, study.text, study.calibration_file, files)
            try:
                with request.listening(self.watcher.tell):
                    self._carry_out(client, Event(self._event, client=client), index, request)
                plan = self._plan(index)
            finally:
                index.close()
                client.close()
        wall = time.perf_counter() - start
        problems = tuple(self.problems)
        work, tally = self._meter.work, self._tally
        summary = Summary(tally, plan.points, request.requested, wall, work, problems, False, everything)
        return replace(summary, study=plan.study, campaign=plan.campaign)

    def _plan(self, index: Index) -> Plan:
        """Plan the missing runs, with the replicates that present results demand."""
        while True:
            catalogue = Catalogue(self.lab)
            try:
                plan = Planner(self.study, catalogue, load(self.backend).capabilities, writes=True).plan()
            finally:
                catalogue.close()
            done = [item.keys.run for item in plan.items if item.state == "done"]
            if not index.derive(done, self.observe):
                return plan

    def _carry_out(self, client, event, index: Index, request: StopRequest) -> None:
        submitted: dict[Any, Batch] = {}
        needs_plan, self._slots = True, 1
        waiting: list[Batch] = []
        has_reported = False
        try:
            while not request.requested:
                if needs_plan and not waiting:
                    self._slots = max(1, _slots(client))
                    active_keys = {key for batch in submitted.values() for key in batch.keys}
                    plan, needs_plan = self._plan(index), False
                    waiting = self._batches(plan, active_keys)
                    self._current_plan = plan
                if not (waiting or submitted):
                    return
                while waiting and len(submitted) < 2 * self._slots:  # one more each, so that none waits for the network
                    batch = waiting.pop(0)
                    submitted[self._submit(client, batch)] = batch
                if not submitted and not has_reported:
                    has_reported = True
                    self.watcher.tell("Waiting: the cluster has no workers yet")
                for future, batch in _completed(client, submitted):
                    del submitted[future]
                    needs_plan |= self._collect(index, future, batch, waiting)
                self._show_progress(submitted)
            event.set()
            self._gather(client, index, submitted)
        finally:
            for future in submitted:
                future.cancel()

    def _batches(self, plan: Plan, active_keys: set[str]) -> list[Batch]:
        """Group the missing runs into batches of equal work, several for each slot; all runs of a packing are in
        one."""
        packings: dict[str, list[Item]] = {}
        for item in plan.todo:
            if not {item.keys.run, item.keys.packing} & (active_keys | self._failed_keys):
                packings.setdefault(item.keys.packing, []).append(item)
        work = {key: _work(items) for key, items in packings.items()}
        share = sum(work.values()) / (self._slots * _TASKS_PER_SLOT)
        batches: list[Batch] = []
        batch_work = 0.0
        for key in sorted(packings, key=lambda one: -work[one]):
            if not batches or batch_work + work[key] > share:
                batches.append(Batch([]))
                batch_work = 0.0
            batches[-1].items += packings[key]
            batch_work += work[key]
        return batches

    def _submit(self, client, batch: Batch):
        repeats: dict[int, tuple[tuple[int, int], ...]] = {}
        for item in batch.items:
            index = item.demand.point.index
            repeats[index] = (*repeats.get(index, ()), item.demand.number)
        keys = {item.keys.packing for item in batch.items}, {item.keys.run for item in batch.items}
        study = self._current_plan.study  # with the points that its strategy has proposed
        task = Task(
            study=replace(study, adapt=None, points=tuple(p for p in study.points if p.index in repeats)),
            backend=self.backend,
            device=self.device,
            expected=self._expected,
            repeats=repeats,
            packings={key: read(self.lab.packing(key)) for key in keys[0] if self.lab.packing(key).is_dir()},
            runs={key: read(self.lab.run(key)) for key in keys[1] if self.lab.run(key).is_dir()},
            works={
                key: read(self.lab.work(key)) for key in keys[0] | keys[1] if (self.lab.work(key) / PROGRESS).exists()
            },
            slice=self.slice,
            stop=self._event,
            attached=attached.contents(study.beside.files.values()),
        )
        needed = {} if self.device == "cpu" else {"resources": {"GPU": 1}}
        with warnings.catch_warnings():  # of checkpoints that are large
            warnings.simplefilter("ignore", UserWarning)
            return client.submit(carry_out, task, pure=False, key=f"labbook-{secrets.token_hex(8)}", **needed)

    def _collect(self, index: Index, future, batch: Batch, waiting: list[Batch]) -> bool:
        """Process the result of a task. Returns True if the plan may have changed."""
        from distributed import CancelledError, KilledWorker  # pyright: ignore[reportMissingImports]

        try:
            result: TaskResult = future.result()
        except (KilledWorker, CancelledError) as error:
            batch.losses += 1
            if batch.losses <= _MAX_LOSSES:
                self.watcher.tell(f"A worker was lost: its {len(batch.items)} runs start again")
                waiting.append(batch)
                return False
            self._give_up(batch, f"{batch.losses} workers were lost while they ran it: {error}")
            return True
        except Exception as problem:
            self._give_up(batch, f"{type(problem).__name__}: {problem}")
            return True
        if result.refused:
            raise ClusterFailed(result.refused)
        self.store_result(index, result, batch)
        self._meter.add(result.work)
        self._tally.ran |= result.ran
        self._tally.resumed += result.resumed
        self._tally.packings += len(result.packings)
        self._tally.failed += result.failed
        self._failed_keys |= result.lost
        return True

    def _give_up(self, batch: Batch, reason: str) -> None:
        self._failed_keys |= {item.keys.run for item in batch.items}
        self._tally.failed.append(
            f"{len(batch.items)} runs, the first of {batch.items[0].demand.point.label}: {reason}"
        )

    def store_result(self, index: Index, result: TaskResult, batch: Batch) -> None:
        """Check the files of a result, and put them in place."""
        self.lab.works.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=".back-", dir=self.lab.works))
        try:
            scratch_lab, own_keys = LabFolder(scratch), batch.keys
            scratch_lab.runs.mkdir()
            for folders, path_of in ((result.packings, scratch_lab.packing), (result.runs, scratch_lab.run)):
                for key, files in folders.items():
                    if key in own_keys:  # nothing else was asked for
                        write(path_of(key), files)
            for problem in merge(index, scratch).left_out:
                self.problems[problem] = None
            index.derive([key for key in result.runs if key in own_keys], self.observe)
            # The run is in place: an older checkpoint of it must not be continued.
            for key in (result.runs.keys() - result.works.keys()) & own_keys:
                if claim := self.lab.claim(key):
                    self.lab.clear(key)
                    claim.release()
            for key, files in result.works.items():
                if key in own_keys:
                    self._store_checkpoint(scratch_lab.work(key), key, files)
        except Unreadable as problem:
            self.problems[str(problem)] = None
        finally:
            shutil.rmtree(scratch, ignore_errors=True)

    def _store_checkpoint(self, source: Path, key: str, files: Files) -> None:
        """Put unfinished work in place of the local one."""
        write(source, files)
        if Progress.read(source) is None or (claim := self.lab.claim(key)) is None:
            return
        try:
            self.lab.clear(key)
            os.rename(source, self.lab.work(key))
        finally:
            claim.release()

    def _gather(self, client, index: Index, submitted: dict[Any, Batch]) -> None:
        """Collect the results of workers that were asked to stop."""
        end = time.monotonic() + _GATHER_TIME
        for future in list(submitted):
            if future.status == "pending" and not _is_running(client, future):
                submitted.pop(future).items.clear()
                future.cancel()
        while submitted and time.monotonic() < end:
            for future, batch in _completed(client, submitted):
                del submitted[future]
                self._collect(index, future, batch, [])

    def _show_progress(self, submitted: Mapping[Any, Batch]) -> None:
        if time.monotonic() < self._next_view:
            return
        self._next_view = time.monotonic() + _VIEW_INTERVAL
        items = [item for item in self._current_plan.items]
        by_key = {item.keys.run: item for item in items}
        done = sum(item.state == "done" or item.keys.run in self._tally.ran for item in by_key.values())
        left = sum(_work(batch.items) for batch in submitted.values())
        at_work = tuple(
            ActiveJob(f"{len(batch.items)} runs", "discharging", (f"the first of {batch.items[0].demand.point.label}",))
            for batch in submitted.values()
        )
        self.watcher.show(
            View(done, len(by_key), 0, at_work, 0, self._meter.work, left, self._meter.rate(), open_ended=True)
        )


def _work(items: Iterable[Item]) -> float:
    """Grain-steps of runs, with their missing packings."""
    runs = list(items)
    missing: dict[str, Demand] = {item.keys.packing: item.demand for item in runs if not item.packed}
    return sum(discharge_work(item.demand.shared) for item in runs) + sum(map(fill_work, missing.values()))


def _slots(client) -> int:
    return sum(worker["nthreads"] for worker in client.scheduler_info(n_workers=-1)["workers"].values())


def _is_running(client, future) -> bool:
    """Return True if a worker runs a task."""
    return any(future.key in keys for keys in client.processing().values())


def _completed(client, submitted: Mapping[Any, Batch]) -> list[tuple[Any, Batch]]:
    """Wait a moment for tasks to end, and return those that have."""
    end = time.monotonic() + _POLL_INTERVAL
    while True:
        completed = [(future, batch) for future, batch in submitted.items() if future.done()]
        if completed or time.monotonic() >= end:
            return completed
        time.sleep(0.02)
