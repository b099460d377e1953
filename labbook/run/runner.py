"""A study carried out in this process: what is missing is planned, put on a board, and executed."""

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
from labbook.plan.devices import enough, slots
from labbook.plan.plan import Plan, Planner
from labbook.plan.possible import check
from labbook.run.board import TOGETHER, Board
from labbook.run.closing import Closer, Closing
from labbook.run.execution import CHECKPOINT_EVERY, Execution
from labbook.run.job import Bench
from labbook.run.live import Publisher
from labbook.run.shard import WHOLE, Seat, Shard, part_of, shard_of
from labbook.run.stopping import Request
from labbook.run.summary import Summary
from labbook.run.watch import Unwatched, Watcher
from labbook.study import Study

_CLOSING = 15
"""Threads, at most, that place grains, and write and measure what members of one ensemble leave."""


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
    """On a CPU; None: one a core. A GPU has a lane for fillings and one for runs."""
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

    repeats: Mapping[int, Sequence[tuple[int, int]]] | None = None
    """The runs that are done, by index of the point, each by its seed and discharge; None: what the study asks for."""
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
        closers = self._closers()
        try:
            return self._carried_out(closers)
        finally:
            for closer in closers:
                closer.end()

    def _carried_out(self, closers: Sequence[Closer]) -> Summary:
        begun = time.perf_counter()
        observe = Observe.of(self.study.measure, self.study.window)
        index = Index(self.lab)
        catalogue = Catalogue(self.lab)
        try:
            plan, planner = self._plan(index, catalogue, observe)
            bench, shared = Bench(self.lab, self.backend, self.device), [point.shared for point in plan.points]
            holds = shard_of(shared, self.backend.capabilities, self.shard)
            board = self._board(bench, planner, index, observe, shared, holds)
            board.pin(plan)
            if not board.runs()[1] and self.seat is None:
                self.watcher.tell(f"Part {self.shard} has no runs: the study has fewer packings than parts")
            self.backend.precompile(board.expected(), self.device)
            publisher = Publisher(self.lab, self.study.name, self.backend.capabilities.name, self.device, self.watcher)
            closing = Closing(board, closers)
            board.placing = closing.placing
            execution = Execution(
                board,
                closing,
                self.backend,
                self.device,
                self.lanes or (cores() if self.device == "cpu" else 1),
                slots(self.backend, self.device, plan.points),
                enough(plan.points),
                publisher,
                self.request,
                self.watcher.tell,
                self.checkpoint_every,
            )
            board.beginning = execution.announce
            with self.request.listening(self.watcher.tell), publisher:
                execution.carry_out()
            execution.report()
        finally:
            catalogue.close()
            index.close()
        return Summary(
            tally=board.tally,
            points=tuple(board.points[at] for at in sorted(board.points)),
            stopped=self.request.made,
            wall_time=time.perf_counter() - begun,
            work_done=execution.meter.work,
            problems=tuple(index.report.problems),
            left_behind=execution.left_behind,
            holds=holds,
            preparing=execution.meter.preparing,
            stepping=execution.meter.stepping,
            study=planner.study,
            campaign=() if planner.campaign is None else tuple(planner.campaign.lines),
        )

    def _closers(self) -> list[Closer]:
        """Threads that place grains and close jobs: one on a CPU, where lanes want all cores, and end their jobs one by
        one. Where much seems to be lacking, their processes start while it is planned."""
        threads = 1 if self.device == "cpu" else min(_CLOSING, cores())
        closers = [Closer(alone=threads == 1) for _ in range(threads)]
        points = self.study.points
        runs = fewest_runs(self.study) * len(points) if self.repeats is None else sum(map(len, self.repeats.values()))
        lacking = runs - len(folders(self.lab.runs))
        grains = max((point.scene.grains.count for point in points), default=0)
        if threads > 1 and lacking > 1 and lacking * grains >= TOGETHER:
            for closer in closers:
                closer.begin()
        return closers

    def _plan(self, index: Index, catalogue: Catalogue, observe: Observe) -> tuple[Plan, Planner]:
        """What is to be run, with the planner that says what follows from results. Raises what `run` raises."""
        capabilities = self.backend.capabilities
        planner = Planner(self.study, catalogue, capabilities, self.packings_of, writes=True)
        if planner.campaign is not None and (self.base is not None or self.shard != WHOLE):
            raise Conflict(
                f"{self.study.path}: adapt: a strategy chooses the points of the whole study from its results"
                "\n    remedy: leave out --shard and --base; several processes may run it in one lab and share the work"
            )
        base = None if self.base is None else self._brought(index, self.base)
        check(self.backend, self.device, planner.points if base is None else [one.shared for one in base.points])
        if base is not None:
            plan = planner.of_base(base)
        else:
            plan = planner.plan() if self.repeats is None else planner.these(self.repeats)
        self._keep_study()
        done = [item.keys.run for item in plan.items if item.state == "done"]
        if base is not None:  # the others are measured where they are
            done = [key for key in done if self.lab.run(key).exists()]
        if index.derive(done, observe) and self.base is None and self.repeats is None:
            plan = planner.plan()
        return plan, planner

    def _board(
        self,
        bench: Bench,
        planner: Planner,
        index: Index,
        observe: Observe,
        shared: Sequence[PointDemand],
        holds: Callable[[Demand], bool],
    ) -> Board:
        """A board for the part of this process, and for the rest of the shard once that is done."""
        own, rest = holds, None
        if self.seat is not None:
            own, rest = part_of(shared, self.backend.capabilities, self.seat, holds), holds
        return Board(bench, planner, index, observe, packings_only=self.packings_only, holds=own, rest=rest)

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
        """Keep the text of the study in the lab, and the files that it names. Raises OSError for a full disk, or where
        such a file cannot be copied; AttachedError where one is gone."""
        study = self.study
        studies.attach(self.lab, study.beside.files.values())
        try:
            studies.keep(self.lab, study.name, study.text, study.calibration_file, study.beside.files)
        except OSError as error:
            if is_full(error):
                raise
            where = error.filename or self.lab.studies
            self.watcher.tell(f"The study runs, but its file could not be copied to the lab: {where}: {error.strerror}")
