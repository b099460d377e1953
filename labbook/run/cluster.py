"""A study on the workers of a Dask cluster: they share nothing with this machine, neither files nor a database.

A task is a batch of runs with their packings. A worker carries it out in a lab of its own, in a temporary folder, for
some minutes at most, and gives back what is finished, and checkpoints of the rest: files as bytes. They are checked and
put in place here through the same door as those of `labbook import`; what is not finished becomes a task again. So a
worker that is lost costs the minutes since its task began. Only tasks of lost workers are repeated: how a run ends is
physics.
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
from labbook.lab.folder import LabError, LabFolder, is_beside, room
from labbook.lab.index import Index
from labbook.lab.journal import PROGRESS, Progress
from labbook.lab.merge import merge
from labbook.lab.records import Observe, Unreadable
from labbook.plan.demand import Demand
from labbook.plan.forecast import discharge_work, fill_work
from labbook.plan.plan import Item, Plan, Planner
from labbook.run.board import Tally
from labbook.run.runner import Runner
from labbook.run.shard import everything
from labbook.run.slurm import differs, expected
from labbook.run.stopping import Request
from labbook.run.summary import Summary
from labbook.run.watch import Going, Meter, Unwatched, View, Watcher
from labbook.scene import attached
from labbook.study import Study

SLICE = 300.0
"""Wall time after which a task gives back what it has [s]: what the loss of a worker costs at most."""
_BATCHES = 4
"""Tasks for each slot of the cluster, so that all end at about the same time."""
_LOSSES = 20
"""Times that a task is begun again after its worker was lost: one that always ends its worker must come to an end."""
_LOOK = 0.5  # s
ASKING, _TELLING = 2.0, 2.0  # s
_LEAVING = 60.0  # s that workers have to give back what they have when they are asked to stop

Files = dict[str, bytes]


class ClusterFailed(Exception):
    """The cluster cannot be reached, or has no workers that can do it; the message says why and what to do."""


@dataclass(frozen=True)
class Task:
    """What a worker is asked: runs by point, seed and discharge, with what they start from or go on from, by key."""

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
    """Name of the event that asks all workers to stop."""
    attached: Mapping[str, bytes] = field(default_factory=dict)
    """Contents of the files that the study names, by hash."""


@dataclass(frozen=True)
class Back:
    """What a worker gives back: folders by key, and what came of its runs."""

    packings: dict[str, Files] = field(default_factory=dict)
    runs: dict[str, Files] = field(default_factory=dict)
    works: dict[str, Files] = field(default_factory=dict)
    ran: dict[str, str] = field(default_factory=dict)
    resumed: int = 0
    failed: tuple[str, ...] = ()
    lost: frozenset[str] = frozenset()
    """Keys of the runs and packings that failed."""
    refused: str = ""
    """Why the worker could not do it at all."""
    work: float = 0.0


def carry_out(task: Task) -> Back:
    """Do a task on this worker, in a temporary folder."""
    for content in task.attached.values():
        attached.add(content)
    try:
        backend = load(task.backend)
        if changed := differs(task.expected, task.study, backend.capabilities):
            return Back(refused=f"{changed} on a worker: install the same versions there")
        with tempfile.TemporaryDirectory(prefix="labbook-") as scratch:
            return _carried_out(task, LabFolder(Path(scratch)), backend)
    except (BackendMissing, Unsupported, ImportError, LabError) as problem:
        return Back(refused=f"{type(problem).__name__}: {problem}")


def _carried_out(task: Task, lab: LabFolder, backend: Any) -> Back:
    for found, place in ((task.packings, lab.packing), (task.runs, lab.run), (task.works, lab.work)):
        for key, files in found.items():
            write(place(key), files)
    points = tuple(point for point in task.study.points if point.index in task.repeats)
    request, over = Request(), threading.Event()
    clock = threading.Thread(target=_stop_in_time, args=(task.slice, _asked(task), request, over), daemon=True)
    clock.start()
    try:
        lanes = 1 if task.device == "cpu" else None  # a thread of a worker is a lane
        study = replace(task.study, points=points)
        done = Runner(
            study, lab, backend, task.device, task.slice, lanes=lanes, repeats=task.repeats, request=request
        ).run()
    finally:
        over.set()
        clock.join()
    packings = {
        key: files for key in _names(lab.packings) if key not in task.packings and (files := read(lab.packing(key)))
    }
    runs = {key: files for key in _names(lab.runs) if (files := read(lab.run(key))) != task.runs.get(key)}
    works = {key: files for key in lab.working() if PROGRESS in (files := read(lab.work(key)))}
    return Back(
        packings,
        runs,
        works,
        done.tally.ran,
        done.tally.resumed,
        done.failed,
        frozenset(done.tally.lost),
        work=done.work_done,
    )


def _asked(task: Task) -> Callable[[], bool]:
    """Whether all workers are asked to stop."""
    from distributed import Event, get_client  # pyright: ignore[reportMissingImports]

    try:
        event = Event(task.stop, client=get_client())
    except ValueError:  # outside a worker there is nobody to ask
        return lambda: False
    return lambda: bool(event.is_set())


def _stop_in_time(slice: float, asked: Callable[[], bool], request: Request, over: threading.Event) -> None:
    """Ask a runner to stop when its time is over, or when all are asked."""
    end = time.monotonic() + slice
    while not over.wait(ASKING):
        if time.monotonic() >= end:
            request.made = True
        with suppress(Exception):  # the scheduler is away for a while
            request.made = request.made or asked()


def read(folder: Path) -> Files:
    """The files of a folder of the lab, but for what was evaluated and is made again."""
    try:
        entries = [one for one in os.scandir(folder) if one.is_file(follow_symlinks=False)]
    except FileNotFoundError:
        return {}
    return {
        one.name: Path(one.path).read_bytes()
        for one in sorted(entries, key=lambda one: one.name)
        if not (is_beside(one.name) and one.name != "picture.png") and not one.name.startswith(".")
    }


def write(folder: Path, files: Files) -> None:
    """Write files into a new folder. Raises Unreadable for names that would lead out of it."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        if name != os.path.basename(name) or name in ("", ".", ".."):
            raise Unreadable(f"{folder}: {name!r} is not the name of a file")
        (folder / name).write_bytes(content)


def _names(folder: Path) -> list[str]:
    return sorted(one.name for one in os.scandir(folder) if one.is_dir()) if folder.is_dir() else []


@dataclass(eq=False)
class Batch:
    """A task that is under way."""

    items: list[Item]
    losses: int = 0

    @property
    def keys(self) -> set[str]:
        """Keys that may come back of it."""
        return {key for item in self.items for key in (item.keys.run, item.keys.packing)}


@dataclass(eq=False)
class Cluster:
    """Carries out `study` in `lab` on the cluster whose scheduler is at `address`; like `Runner` otherwise. `backend`:
    its name; `device`: of every worker. Workers of GPUs declare a resource: `dask worker --resources GPU=1`."""

    study: Study
    lab: LabFolder
    backend: str
    address: str
    device: str = "cpu"
    slice: float = SLICE
    watcher: Watcher = field(default_factory=Unwatched)

    def run(self) -> Summary:
        """Run what is missing. Ctrl-C asks all workers to give back what they have, and ends early; the same command
        goes on.

        Raises ClusterFailed, and what `Runner.run` raises but DiskFull of workers.
        """
        from distributed import Client, Event  # pyright: ignore[reportMissingImports]

        begun = time.perf_counter()
        self._meter, self._tally, self.problems = Meter(), Tally(), dict[str, None]()
        self._event = f"labbook-stop-{secrets.token_hex(8)}"
        self._lost: set[str] = set()
        self._next_tell = 0.0
        self._expected = expected(self.study, load(self.backend).capabilities)
        self.observe = Observe.of(self.study.measure, self.study.window)
        try:
            client = Client(self.address, timeout="20s", set_as_default=False)
        except (OSError, ValueError) as error:
            raise ClusterFailed(
                f"no scheduler answers at {self.address}: {error}; start one: labbook cluster local"
            ) from error
        request = Request()
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
        wall = time.perf_counter() - begun
        problems = tuple(self.problems)
        work, tally = self._meter.work, self._tally
        found = Summary(tally, plan.points, request.made, wall, work, problems, False, everything)
        return replace(found, study=plan.study, campaign=plan.campaign)

    def _plan(self, index: Index) -> Plan:
        """As things stand, with the replicates that are asked for."""
        while True:
            catalogue = Catalogue(self.lab)
            try:
                plan = Planner(self.study, catalogue, load(self.backend).capabilities, writes=True).plan()
            finally:
                catalogue.close()
            done = [item.keys.run for item in plan.items if item.state == "done"]
            if not index.derive(done, self.observe):
                return plan

    def _carry_out(self, client, event, index: Index, request: Request) -> None:
        going: dict[Any, Batch] = {}
        stale, self._slots = True, 1
        waiting: list[Batch] = []
        told = False
        try:
            while not request.made:
                if stale and not waiting:
                    self._slots = max(1, _slots(client))
                    busy = {key for batch in going.values() for key in batch.keys}
                    plan, stale = self._plan(index), False
                    waiting = self._batches(plan, busy)
                    self._now = plan
                if not (waiting or going):
                    return
                while waiting and len(going) < 2 * self._slots:  # one more each, so that none waits for the network
                    batch = waiting.pop(0)
                    going[self._submit(client, batch)] = batch
                if not going and not told:
                    told = True
                    self.watcher.tell("Waiting: the cluster has no workers yet")
                for future, batch in _ended(client, going):
                    del going[future]
                    stale |= self._take(index, future, batch, waiting)
                self._tell(going)
            event.set()
            self._gather(client, index, going)
        finally:
            for future in going:
                future.cancel()

    def _batches(self, plan: Plan, busy: set[str]) -> list[Batch]:
        """What is to do, in batches of about the same work that fill the cluster a few times over: all runs from one
        packing in one."""
        packings: dict[str, list[Item]] = {}
        for item in plan.todo:
            if not {item.keys.run, item.keys.packing} & (busy | self._lost):
                packings.setdefault(item.keys.packing, []).append(item)
        work = {key: _work(items) for key, items in packings.items()}
        share = sum(work.values()) / (self._slots * _BATCHES)
        found: list[Batch] = []
        held = 0.0
        for key in sorted(packings, key=lambda one: -work[one]):
            if not found or held + work[key] > share:
                found.append(Batch([]))
                held = 0.0
            found[-1].items += packings[key]
            held += work[key]
        return found

    def _submit(self, client, batch: Batch):
        repeats: dict[int, tuple[tuple[int, int], ...]] = {}
        for item in batch.items:
            at = item.demand.point.index
            repeats[at] = (*repeats.get(at, ()), item.demand.number)
        keys = {item.keys.packing for item in batch.items}, {item.keys.run for item in batch.items}
        study = self._now.study  # with the points that its strategy has proposed
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

    def _take(self, index: Index, future, batch: Batch, waiting: list[Batch]) -> bool:
        """Take what came back; whether the plan may be another one now."""
        from distributed import CancelledError, KilledWorker  # pyright: ignore[reportMissingImports]

        try:
            back: Back = future.result()
        except (KilledWorker, CancelledError) as lost:
            batch.losses += 1
            if batch.losses <= _LOSSES:
                self.watcher.tell(f"A worker was lost: its {len(batch.items)} runs start again")
                waiting.append(batch)
                return False
            self._give_up(batch, f"{batch.losses} workers were lost while they ran it: {lost}")
            return True
        except Exception as problem:
            self._give_up(batch, f"{type(problem).__name__}: {problem}")
            return True
        if back.refused:
            raise ClusterFailed(back.refused)
        self.put_back(index, back, batch)
        self._meter.add(back.work)
        self._tally.ran |= back.ran
        self._tally.resumed += back.resumed
        self._tally.packings += len(back.packings)
        self._tally.failed += back.failed
        self._lost |= back.lost
        return True

    def _give_up(self, batch: Batch, why: str) -> None:
        self._lost |= {item.keys.run for item in batch.items}
        self._tally.failed.append(f"{len(batch.items)} runs, the first of {batch.items[0].demand.point.label}: {why}")

    def put_back(self, index: Index, back: Back, batch: Batch) -> None:
        """Check what came back, and put it in place."""
        self.lab.works.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=".back-", dir=self.lab.works))
        try:
            theirs, mine = LabFolder(scratch), batch.keys
            theirs.runs.mkdir()
            for found, place in ((back.packings, theirs.packing), (back.runs, theirs.run)):
                for key, files in found.items():
                    if key in mine:  # nothing else was asked for
                        write(place(key), files)
            for problem in merge(index, scratch).left_out:
                self.problems[problem] = None
            index.derive([key for key in back.runs if key in mine], self.observe)
            for key in (back.runs.keys() - back.works.keys()) & mine:
                if claim := self.lab.claim(key):
                    self.lab.clear(key)
                    claim.release()
            for key, files in back.works.items():
                if key in mine:
                    self._put_work(theirs.work(key), key, files)
        except Unreadable as problem:
            self.problems[str(problem)] = None
        finally:
            shutil.rmtree(scratch, ignore_errors=True)

    def _put_work(self, theirs: Path, key: str, files: Files) -> None:
        """Put a checkpoint in place of the one that is there."""
        write(theirs, files)
        if Progress.read(theirs) is None or (claim := self.lab.claim(key)) is None:
            return
        try:
            self.lab.clear(key)
            os.rename(theirs, self.lab.work(key))
        finally:
            claim.release()

    def _gather(self, client, index: Index, going: dict[Any, Batch]) -> None:
        """Take what workers give back that were asked to stop."""
        end = time.monotonic() + _LEAVING
        for future in list(going):
            if future.status == "pending" and not _processing(client, future):
                going.pop(future).items.clear()
                future.cancel()
        while going and time.monotonic() < end:
            for future, batch in _ended(client, going):
                del going[future]
                self._take(index, future, batch, [])

    def _tell(self, going: Mapping[Any, Batch]) -> None:
        if time.monotonic() < self._next_tell:
            return
        self._next_tell = time.monotonic() + _TELLING
        items = [item for item in self._now.items]
        every = {item.keys.run: item for item in items}
        done = sum(item.state == "done" or item.keys.run in self._tally.ran for item in every.values())
        left = sum(_work(batch.items) for batch in going.values())
        at_work = tuple(
            Going(f"{len(batch.items)} runs", "discharging", (f"the first of {batch.items[0].demand.point.label}",))
            for batch in going.values()
        )
        self.watcher.show(
            View(done, len(every), 0, at_work, 0, self._meter.work, left, self._meter.rate(), open_ended=True)
        )


def _work(items: Iterable[Item]) -> float:
    """Grain-steps of runs that start from one packing, or from several."""
    runs = list(items)
    missing: dict[str, Demand] = {item.keys.packing: item.demand for item in runs if not item.packed}
    return sum(discharge_work(item.demand.shared) for item in runs) + sum(map(fill_work, missing.values()))


def _slots(client) -> int:
    return sum(one["nthreads"] for one in client.scheduler_info(n_workers=-1)["workers"].values())


def _processing(client, future) -> bool:
    """Whether a worker has a task."""
    return any(future.key in keys for keys in client.processing().values())


def _ended(client, going: Mapping[Any, Batch]) -> list[tuple[Any, Batch]]:
    """Tasks that came to an end within a moment."""
    end = time.monotonic() + _LOOK
    while True:
        found = [(future, batch) for future, batch in going.items() if future.done()]
        if found or time.monotonic() >= end:
            return found
        time.sleep(0.02)
