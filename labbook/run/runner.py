"""Run a study in this process: plan what is missing, queue it, execute it."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from labbook.backend import Backend
from labbook.backend.machine import cores
from labbook.lab import studies
from labbook.lab.catalogue import Catalogue
from labbook.lab.folder import LabFolder, folders, is_full, room
from labbook.lab.index import Index
from labbook.lab.merge import bring
from labbook.lab.records import Observe
from labbook.plan.demand import Conflict, Demand, PackingsOf, PointDemand, fewest_runs
from labbook.plan.devices import largest_ensemble, slots
from labbook.plan.plan import Plan, Planner
from labbook.plan.possible import check
from labbook.run.execution import CHECKPOINT_EVERY, Execution
from labbook.run.finalizing import Finalizer, FinalizerPool
from labbook.run.helper import MAX_HELPERS
from labbook.run.job import JobContext
from labbook.run.job_queue import PLACE_AHEAD_GRAINS, JobQueue
from labbook.run.live import Publisher
from labbook.run.shard import WHOLE, ProcessRank, Shard, part_of, shard_of
from labbook.run.stopping import StopRequest
from labbook.run.summary import Summary
from labbook.run.watch import NullWatcher, Watcher
from labbook.study import Study


@dataclass(eq=False)
class Runner:
    """Runs a study in a lab on one backend and device. Several processes on one lab share the work by claims.

    Args:
        study: Study to run.
        lab: Folder of the lab.
        backend: Backend that steps the members.
        device: `cpu`, or the name of a GPU device.
        checkpoint_every: Wall time between saves of a job [s].
        watcher: Receives progress.
        workers: Number of ensembles stepped at once on a CPU; None: one for each core. A GPU has two.
        packings_of: Backend whose packings the runs start from; they must exist. None: `backend` makes its own.
        packings_only: Make the packings of the runs, and no runs.
        shard: Part of the runs to make.
        rank: Rank of this process among several in one lab; None: it takes runs as they come.
        base: Another lab, whose finished runs are not repeated and whose packings and shorter runs are continued.
        repeats: (seed, discharge) of the runs to make, by index of the point; None: all that the study demands.
        request: Stop request, which another thread may set.
    """

    study: Study
    lab: LabFolder
    backend: Backend
    device: str = "cpu"
    checkpoint_every: float = CHECKPOINT_EVERY
    watcher: Watcher = field(default_factory=NullWatcher)
    workers: int | None = None
    packings_of: PackingsOf | None = None
    packings_only: bool = False
    shard: Shard = WHOLE
    rank: ProcessRank | None = None
    base: LabFolder | None = None

    repeats: Mapping[int, Sequence[tuple[int, int]]] | None = None
    request: StopRequest = field(default_factory=StopRequest)

    def run(self) -> Summary:
        """Run what is missing. Ctrl-C, SIGTERM or SIGHUP saves the active jobs and ends early.

        Returns:
            Summary of the session.

        Raises:
            KeyboardInterrupt: A second stop signal. The last saves stay valid; worker threads may still be within a
                beat.
            DiskFull: The disk is full.
            Unsupported: The backend cannot run the study; raised before anything runs.
            Conflict: Options contradict each other; raised before anything runs.
            MeasureError: A measure does not fit a scene; raised before anything runs.
        """
        with room(self.lab.folder):
            return self._run()

    def _run(self) -> Summary:
        finalizers = self._make_finalizers()
        try:
            return self._carry_out(finalizers)
        finally:
            for finalizer in finalizers:
                finalizer.end()

    def _carry_out(self, finalizers: Sequence[Finalizer]) -> Summary:
        start = time.perf_counter()
        observe = Observe.of(self.study.measure, self.study.window)
        index = Index(self.lab)  # before the catalogue, which refuses an index that is missing or of another version
        catalogue = Catalogue(self.lab)
        try:
            plan, planner = self._plan(index, catalogue, observe)
            context, shared = JobContext(self.lab, self.backend, self.device), [point.shared for point in plan.points]
            holds = shard_of(shared, self.backend.capabilities, self.shard)
            queue = self._make_queue(context, planner, index, observe, shared, holds)
            queue.load_plan(plan)
            if not queue.count_runs()[1] and self.rank is None:
                self.watcher.tell(f"Part {self.shard} has no runs: the study has fewer packings than parts")
            self.backend.precompile(queue.expected(), self.device)
            publisher = Publisher(self.lab, self.study.name, self.backend.capabilities.name, self.device, self.watcher)
            finalizer_pool = FinalizerPool(queue, finalizers)
            queue.placing = finalizer_pool.placing
            execution = Execution(
                queue,
                finalizer_pool,
                self.backend,
                self.device,
                self.workers or (cores() if self.device == "cpu" else 1),
                slots(self.backend, self.device, plan.points),
                largest_ensemble(plan.points),
                publisher,
                self.request,
                self.watcher.tell,
                self.checkpoint_every,
            )
            queue.on_begin = execution.announce
            with self.request.listening(self.watcher.tell), publisher:
                execution.carry_out()
            execution.report()
        finally:
            catalogue.close()
            index.close()
        return Summary(
            tally=queue.tally,
            points=tuple(queue.points[at] for at in sorted(queue.points)),
            stopped=self.request.requested,
            wall_time=time.perf_counter() - start,
            work_done=execution.meter.work,
            problems=tuple(index.report.problems),
            left_behind=execution.left_behind,
            holds=holds,
            preparing=execution.meter.preparing,
            stepping=execution.meter.stepping,
            study=planner.study,
            campaign=() if planner.campaign is None else tuple(planner.campaign.lines),
        )

    def _make_finalizers(self) -> list[Finalizer]:
        """Start the finalizers: one on a CPU, where workers need all cores and end their jobs one by one.

        If much is missing their helper processes start now, while the study is planned.
        """
        threads = 1 if self.device == "cpu" else min(MAX_HELPERS, cores())
        finalizers = [Finalizer(alone=threads == 1) for _ in range(threads)]
        points = self.study.points
        runs = fewest_runs(self.study) * len(points) if self.repeats is None else sum(map(len, self.repeats.values()))
        missing = runs - len(folders(self.lab.runs))
        grains = max((point.scene.grains.count for point in points), default=0)
        if threads > 1 and missing > 1 and missing * grains >= PLACE_AHEAD_GRAINS:
            for finalizer in finalizers:
                finalizer.begin()
        return finalizers

    def _plan(self, index: Index, catalogue: Catalogue, observe: Observe) -> tuple[Plan, Planner]:
        """Plan the missing runs. Returns the plan, and the planner that updates it. Raises what `run` raises."""
        capabilities = self.backend.capabilities
        planner = Planner(self.study, catalogue, capabilities, self.packings_of, writes=True)
        if planner.campaign is not None and (self.base is not None or self.shard != WHOLE):
            raise Conflict(
                f"{self.study.path}: adapt: a strategy chooses the points of the whole study from its results"
                "\n    remedy: leave out --shard and --base; several processes may run it in one lab and share the work"
            )
        base = None if self.base is None else self._copy_from_base(index, self.base)
        check(self.backend, self.device, planner.points if base is None else [one.shared for one in base.points])
        if base is not None:
            plan = planner.of_base(base)
        else:
            plan = planner.plan() if self.repeats is None else planner.plan_runs(self.repeats)
        self._store_study()
        done = [item.keys.run for item in plan.items if item.state == "done"]
        if base is not None:  # the others are measured where they are
            done = [key for key in done if self.lab.run(key).exists()]
        # Planned again after new measurements: they decide on replicates, and a run may have turned out to be damaged.
        if index.derive(done, observe) and self.base is None and self.repeats is None:
            plan = planner.plan()
        return plan, planner

    def _make_queue(
        self,
        context: JobContext,
        planner: Planner,
        index: Index,
        observe: Observe,
        shared: Sequence[PointDemand],
        holds: Callable[[Demand], bool],
    ) -> JobQueue:
        """Make the job queue for the part of this process, and for the rest of the shard after it."""
        first, later = holds, None
        if self.rank is not None:
            first, later = part_of(shared, self.backend.capabilities, self.rank, holds), holds
        return JobQueue(context, planner, index, observe, packings_only=self.packings_only, holds=first, later=later)

    def _copy_from_base(self, index: Index, base: LabFolder) -> Plan:
        """Plan what is missing in `base`, and copy what `base` has of it into this lab."""
        catalogue = Catalogue(base)
        try:
            plan = Planner(self.study, catalogue, self.backend.capabilities, self.packings_of).plan()
        finally:
            catalogue.close()
        holds = shard_of([point.shared for point in plan.points], self.backend.capabilities, self.shard)
        own = [item for item in plan.todo if holds(item.demand)]
        packings = dict.fromkeys(item.keys.packing for item in own if item.packed)
        bring(index, base, packings, [item.keys.run for item in own])
        return plan

    def _store_study(self) -> None:
        """Store the text of the study in the lab, and its attached files.

        Raises:
            OSError: The disk is full, or an attached file cannot be copied.
            AttachedError: An attached file is missing.
        """
        study = self.study
        studies.attach(self.lab, study.beside.files.values())
        try:
            studies.keep(self.lab, study.name, study.text, study.calibration_file, study.beside.files)
        except OSError as error:
            if is_full(error):  # nothing else could be stored either; without its text the study still runs
                raise
            where = error.filename or self.lab.studies
            self.watcher.tell(f"The study runs, but its file could not be copied to the lab: {where}: {error.strerror}")
