"""A lab with its backend and device: plans, runs, pilots and results of studies."""

import errno
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from labbook import html
from labbook.accuracy import BESIDE, extend, write
from labbook.api.progress import count_display, watching
from labbook.api.results import Results
from labbook.backend import Backend, Unsupported, load_to_plan
from labbook.backend import load as load_backend
from labbook.commands import command
from labbook.export.film import of_run
from labbook.export.frames import NotRecorded
from labbook.export.recording import path_of
from labbook.lab import Catalogue, LabError, LabFolder, NoCatalogue, Unreadable
from labbook.lab.folder import DEFAULT
from labbook.lab.index import Index
from labbook.plan.advice import foresee, forewarn
from labbook.plan.coverage import finished
from labbook.plan.devices import parse_devices
from labbook.plan.plan import Plan, flow_rates
from labbook.results.calibrating import Calibrated, NotCalibrated, PilotStopped, calibrate, flow_and_filling
from labbook.results.find import find
from labbook.results.points import FLOW_RATE
from labbook.run.cluster import Cluster
from labbook.run.devices import MultiDeviceRunner
from labbook.run.execution import CHECKPOINT_EVERY
from labbook.run.runner import Runner
from labbook.run.shard import WHOLE, Shard
from labbook.run.summary import Summary
from labbook.run.watch import Watcher
from labbook.study import Study
from labbook.study.pilot import first_needed, whole
from labbook.study.problems import grouped
from labbook.study.source import given_path
from labbook.warning import RenamedAttribute, called_by_command, warn

if TYPE_CHECKING:
    import pandas as pd

_OPTION = re.compile(r"(?<=use )--(device|backend) ([\w:]*\w)")
"""Of the command line, with its value."""
_ROWS = 40
"""Rows of a table."""


class PilotNeeded(Exception):
    """A shard of a study was requested that needs a pilot as a whole; the message has the remedy."""


def _is_study(given: object) -> None:
    if not isinstance(given, Study):
        raise TypeError(f"a Study is needed, and not {given!r}; read a file with labbook.load(path)")


@dataclass(frozen=True)
class Lab:
    """A folder with runs and packings, and the backend and device that make them.

    The folder is created at the first write. Several processes may use one lab at once: they share the work.

    Args:
        folder: The folder; `~` is the home folder, as in a shell.
        backend: Backend that makes the runs, and whose runs `results` reads: `numba` (CPU) or `warp` (GPU).
        device: Device, such as `cpu` or `cuda:0`; several as `cuda:0,cuda:1` or `cuda:all`.
    """

    folder: Path | str = DEFAULT
    backend: str = "numba"
    device: str = "cpu"
    place = RenamedAttribute("lab_folder")

    def __post_init__(self):
        object.__setattr__(self, "folder", given_path(self.folder, "labbook.Lab: folder"))

    @property
    def lab_folder(self) -> LabFolder:
        """The folder, with methods for the places in it."""
        return LabFolder(Path(self.folder))

    def plan(self, study: Study) -> Plan:
        """Plan a study: the runs that it still needs in this lab and why.

        Args:
            study: The study.

        Returns:
            The plan, with a forecast of time [s] and disk space [bytes], and warnings.

        Raises:
            Unsupported: The backend cannot compute a scene.
            Conflict: Two keys of the study cannot be fulfilled by the same runs.
            MeasureError: A measure does not apply to a scene.
            TooLarge: The runs need more memory than is free.
            BackendMissing: No such backend is installed.
            LabError: The lab or its index cannot be used.
        """
        _is_study(study)
        with self._catalogue() as catalogue, _in_python():
            return foresee(self._calibrated(study), catalogue, load_to_plan(self.backend), self.device)

    def run(
        self,
        study: Study,
        progress: bool | Watcher = True,
        checkpoint_every: float = CHECKPOINT_EVERY,
        shard: str | None = None,
        base: Path | str | None = None,
        cluster: str | None = None,
        pilot: bool = True,
    ) -> Summary:
        """Make the runs that a study still needs; finished runs are not repeated.

        Ctrl-C saves unfinished runs and returns; a second one raises KeyboardInterrupt and keeps the last checkpoints.
        Either way the next call continues. Failed runs are named in the summary, and give a warning unless `progress`
        is a Watcher. If anything is to run, the warnings of the plan are repeated before, unless `progress` is False.

        Args:
            study: The study.
            progress: True shows a bar, False nothing; or a Watcher to inform.
            checkpoint_every: Wall time [s] between two saves of a run; more if saving took over 5 % of the time.
            shard: `I/N`: run only part I of N parts of the study, of about the same forecast cost. All runs from one
                packing are in one part.
            base: Another lab, whose runs are not repeated and whose packings are used.
            cluster: Address of a Dask scheduler, whose workers run the study (extra `cluster`).
            pilot: Run the pilot first that a requested error may need (`pilot`). False: the default step is used where
                none can be chosen, and the error budget says that its bias is unknown.

        Returns:
            Summary of this session, with the runs that are done, failed or diverged.

        Raises:
            ValueError: `shard` is not of the form I/N.
            PilotNeeded: A `shard` is requested of a study that needs a pilot.
            PilotStopped: Ctrl-C ended the pilot.
            PermissionError: The calibration of the pilot cannot be written.
            DiskFull: The disk is full.
            Unsupported: As in `plan`, whose further errors except TooLarge are raised too, before anything runs.
        """
        _is_study(study)
        own_shard = WHOLE if shard is None else Shard.parse(shard)
        base_lab = None if base is None else LabFolder(given_path(base, "base"))
        backend, plain = load_backend(self.backend), isinstance(progress, bool)
        with watching(progress) as watcher, _in_python():
            study = self._calibrated(study)
            if pilot and (needed := first_needed(study)) is not None:
                study = self._piloted(study, needed, watcher, whole=shard is None)
            for line in () if progress is False else self._forewarned(study, backend):
                watcher.tell(line)
            if cluster is not None:
                summary = Cluster(study, self.lab_folder, self.backend, cluster, self.device, watcher=watcher).run()
            else:
                first, *more_devices = parse_devices(self.device, backend)
                options = (checkpoint_every, watcher)
                if more_devices:
                    runner = MultiDeviceRunner(
                        study, self.lab_folder, self.backend, (first, *more_devices), *options, own_shard, base_lab
                    )
                else:
                    runner = Runner(study, self.lab_folder, backend, first, *options, shard=own_shard, base=base_lab)
                summary = runner.run()
            summary = replace(summary, study=summary.study or study)
            if study.record is not None and study.record.film and not summary.stopped:
                self._film(summary.study or study, watcher)
        if shard is None and base is None and not summary.stopped:
            summary = replace(summary, no_flow=self._no_flow(study, summary))
        if plain:
            for why in grouped(summary.failed):
                warn(f"failed: {why}")
            if summary.no_flow:
                warn(f"no point of the study has a flow rate: {summary.no_flow}")
        return summary

    def _forewarned(self, study: Study, backend: Backend) -> tuple[str, ...]:
        """The warnings of a plan, and what was wrong with an index that has to be made first."""

        def forewarn_lines() -> tuple[str, ...]:
            with self._catalogue() as catalogue:
                return tuple(f"Warning: {line}" for line in forewarn(study, catalogue, backend, self.device))

        try:
            return forewarn_lines()
        except NoCatalogue:
            index = Index(self.lab_folder)  # to run makes the index of a lab without one, where a plan only looks
            index.close()
            return (*(f"Unreadable: {problem}" for problem in index.report.problems), *forewarn_lines())

    def _film(self, study: Study, watcher: Watcher) -> None:
        """Make films of the recorded runs of a study that have none. No study is lost for a film: problems are told."""
        with self._catalogue() as catalogue:
            runs = finished(catalogue, study, self.backend)
        for run in runs:
            if run.entry.coverage is None or run.entry.coverage.recording is None:
                continue
            try:
                path = path_of(self.lab_folder.folder / "films", run.record, study.name, run.point, "-layers.webp")
                watcher.tell(f"Film: {of_run(run.folder, path, study.name, run.point)}")
            except (Unreadable, NotRecorded, OSError) as problem:
                watcher.tell(f"No film of {run.point.label}, {run.repeat}: {problem}")

    def _piloted(self, study: Study, needed: Study, watcher: Watcher, whole: bool) -> Study:
        """The study with numerics chosen by its pilot. whole: whether all of its runs are to be made here."""
        by_command = called_by_command()
        skip = "--no-pilot" if by_command else "pilot=False"
        if not whole:
            first = (
                command("pilot", study.path, lab=self.folder, backend=self.backend)
                if by_command
                else "lab.pilot(study)"
            )
            raise PilotNeeded(f"{study.name} needs a pilot for all parts: give {first} first, or {skip}")
        runs = len(needed.points) * needed.replicates
        watcher.tell(f"Such scenes are not calibrated: a pilot of {runs} runs comes first ({skip} skips it)")
        try:
            study = self.pilot(study, watcher)
        except PilotStopped:
            raise
        except NotCalibrated as problem:
            watcher.tell(f"The pilot gave no calibration: {problem}. The default step is used; its bias is unknown")
            return study
        planned = (
            command("plan", study.path, lab=self.folder, backend=self.backend) if by_command else "lab.plan(study)"
        )
        watcher.tell(f"The pilot wrote {study.calibration_file}. To see the chosen numerics: {planned}")
        return study

    def _calibration_file(self, study: Study) -> Path:
        """File into which the pilot of a study writes its calibration: beside the study's file, else in the lab."""
        if study.source:
            return study.path.with_suffix(BESIDE)
        return (self.lab_folder.studies / f"{study.name}{BESIDE}").resolve()

    def _calibrated(self, study: Study) -> Study:
        """The study with the numerics that its pilot has made possible, if it had one since the study was read."""
        if not any(point.wants_pilot for point in study.points):
            return study
        file = self._calibration_file(study)
        return study.calibrated(file) if file.is_file() else study

    def _no_flow(self, study: Study, summary: Summary) -> str:
        """Reason that no point has a flow rate, though the study measures it and runs are done; empty if any has."""
        done = [[item.keys.run for item in point.items if item.state == "done"] for point in summary.points]
        if FLOW_RATE not in study.measure or not any(done):
            return ""
        with self._catalogue() as catalogue:
            if any(flow_rates(study, catalogue, keys) for keys in done):
                return ""
            results = find(study, catalogue, self.backend, lambda done: None)
        return "; ".join(dict.fromkeys(filter(None, (point.no_flow for point in results.points)))) or "see the report"

    def pilot(self, study: Study, progress: bool | Watcher = True, seeds: int | None = None) -> Study:
        """Choose the numerics of a study by its pilot: runs that measure the effect of numerics on the flow rate.

        The calibration is written beside the study file, where `load` finds it, or into the lab for a study made in
        Python. With `seeds` it replaces an older one; without, effects are added to the older one, and replace those of
        the same scenes. A study that sweeps numerics is its own pilot.

        Args:
            study: The study.
            progress: As for `run`.
            seeds: None: the pilot that the requested error needs, with two time steps; a study whose scenes are
                calibrated, or that requests no error, needs none and is returned as it is. A number: a whole pilot of
                seven settings of time step and stiffness at the first, middle and last point, with `seeds` runs each.

        Returns:
            The study with the chosen numerics.

        Raises:
            NotCalibrated: Too few runs flowed, or scenes of this kind cannot be calibrated.
            PilotStopped: Ctrl-C ended the pilot.
            OSError: The calibration cannot be written; raised before anything runs.
            Unsupported: As in `run`, whose further errors are raised too.
        """
        _is_study(study)
        runs = first_needed(study) if seeds is None else whole(study, seeds)
        if runs is None:
            return study
        file = self._calibration_file(study)
        if study.source and not os.access(file.parent, os.W_OK):
            raise PermissionError(errno.EACCES, "the calibration of its pilot cannot be written there", str(file))
        effects = [effect.effects for effect in effects_of_numerics(self, runs, progress)]
        extend(file, effects) if seeds is None else write(file, effects)
        return study.calibrated(file)

    def results(self, study: Study, progress: bool | Callable[[int], None] = True) -> Results:
        """Read the results of a study so far. Runs that are not evaluated yet are evaluated, and the numbers stored.

        Unreadable runs give a warning and are left out; measures that fail on a run give one too.

        Args:
            study: The study.
            progress: True shows the number of evaluated runs, False nothing; or a function to call with it.

        Returns:
            The results.

        Raises:
            LabError: The lab or its index cannot be used.
        """
        _is_study(study)
        if not Path(self.folder).exists():
            warn(f"there is no lab {self.folder} yet, so that it has no runs")
        with self._catalogue() as catalogue, count_display(progress, "evaluating runs") as count:
            kind = partial(Results, lab_folder=self.lab_folder, backend=self.backend)
            results = find(self._calibrated(study), catalogue, self.backend, count, kind)
        for problem in grouped(results.unreadable):
            warn(f"left out: {problem}")
        for problem in grouped(results.unmeasured):
            warn(f"not measured: {problem}")
        return results

    def frame(
        self, study: Study | str | None = None, outcome: str | None = None, limit: int | None = None
    ) -> "pd.DataFrame":
        """List the runs of the lab as a data frame, the latest first.

        Args:
            study: Only runs first made for this study (or its name).
            outcome: Only runs with this outcome, or `unreadable`, or `suspect`.
            limit: Largest number of rows; None: all.

        Returns:
            One row per run, with units in `attrs`.

        Raises:
            LabError: The lab or its index cannot be used.
            ValueError: No run has this outcome or study.
        """
        with self._catalogue() as catalogue:
            if absent := catalogue.absent(study if isinstance(study, str) else None, outcome):
                raise ValueError(absent)
            frame = catalogue.runs(study.name if isinstance(study, Study) else study, outcome, limit)
        units = {"duration": "s", "wall_time": "s", "device_time": "s", "rate": "1/s"}
        frame.attrs = {"lab": str(self.folder), "units": units}
        return frame

    def __repr__(self) -> str:
        head = f"<Lab {self.folder} on {self.backend}, {self.device}"
        try:
            with self._catalogue() as catalogue:
                counts, packings = catalogue.counts(), catalogue.packing_count()
        except LabError as error:
            return f"{head}: {error}>"
        by = ", ".join(f"{count} {outcome}" for outcome, count in sorted(counts.items()))
        contents = f"{sum(counts.values())} runs{f' ({by})' if by else ''}, {packings} packings"
        return f"{head}: {contents}>"

    def _repr_html_(self) -> str:
        try:
            with self._catalogue() as catalogue:
                counts, packings = catalogue.studies(), catalogue.packing_count()
        except LabError as error:
            return escape(f"<Lab {self.folder} on {self.backend}, {self.device}: {error}>")
        rows = [(count.study or "–", count.backend, count.outcome, str(count.runs)) for count in counts]
        listed = html.table(("study", "backend", "outcome", "runs"), rows[:_ROWS]) if rows else ""
        rest = [f"and {len(rows) - _ROWS} more rows"] if len(rows) > _ROWS else []
        runs = sum(count.runs for count in counts)
        totals = f"{runs} run{'' if runs == 1 else 's'}, {packings} packing{'' if packings == 1 else 's'}"
        return html.titled(f"Lab {self.folder} on {self.backend}, {self.device}: {totals}", listed, html.lines(rest))

    @contextmanager
    def _catalogue(self) -> Iterator[Catalogue]:
        catalogue = Catalogue(self.lab_folder)
        try:
            yield catalogue
        finally:
            catalogue.close()


def effects_of_numerics(lab: Lab, pilot: Study, progress: bool | Watcher = True) -> tuple[Calibrated, ...]:
    """Measure the effect of numerics on the flow rate of each scene by a pilot, whose missing runs are made.

    Args:
        lab: Lab that has, or makes, the runs.
        pilot: The study that sweeps numerics.
        progress: As for `Lab.run`.

    Returns:
        Effects of numerics in each scene.

    Raises:
        PilotStopped: Ctrl-C ended the runs.
        NotCalibrated: A scene cannot be calibrated (raised before anything runs), or none has enough runs.
    """
    for point in pilot.points:
        flow_and_filling(point)  # refuses, before anything runs, scenes that have no groups
    if lab.run(pilot, progress).stopped:
        raise PilotStopped
    return calibrate(pilot.name, lab.results(pilot, False).points)


@contextmanager
def _in_python() -> Iterator[None]:
    """Names arguments of Python where a message names options of the command line, unless a verb has called."""
    try:
        yield
    except Unsupported as problem:
        if called_by_command():
            raise
        remedy = _OPTION.sub(lambda match: f"{match[1]}={match[2]!r}", problem.remedy).replace("--", "")
        raise Unsupported(problem.key.removeprefix("--"), remedy) from problem
