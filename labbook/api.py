"""labbook for Python: a lab with a backend, and what it does for a study.

The verbs of the command line do their work by these methods; docs/python.md lists all that is public.
"""

import errno
import math
import os
import re
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, fields, replace
from functools import cached_property
from html import escape
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from labbook import html
from labbook.accuracy import BESIDE, write
from labbook.backend import Backend, Unsupported
from labbook.backend import load as load_backend
from labbook.backend.probes import UNITS
from labbook.export.packing import check_spheres, write_packings
from labbook.export.recording import NotRecorded, of_run
from labbook.export.study import write_numbers, write_recordings
from labbook.export.viewer import show
from labbook.fit import LAWS, FitError, FitResult
from labbook.fit import named as named_law
from labbook.lab import Catalogue, LabError, LabFolder, NoCatalogue
from labbook.lab.folder import DEFAULT
from labbook.lab.index import Index
from labbook.lab.runs import picture
from labbook.measure.trajectories import Trajectories
from labbook.plan.advice import foresee, forewarn
from labbook.plan.demand import Conflict
from labbook.plan.devices import named
from labbook.plan.plan import Plan, flow_rates
from labbook.report import gallery, page, style, tables
from labbook.results import display
from labbook.results.calibrating import Calibrated, PilotStopped, calibrate, flow_and_filling
from labbook.results.find import find
from labbook.results.frames import frames, known_interval
from labbook.results.points import FLOW_RATE, ORIFICE, RunResult
from labbook.results.series import Series, series_of
from labbook.results.study import Results as Found
from labbook.run.cluster import Cluster
from labbook.run.devices import Crew
from labbook.run.notebook import NotebookBar, counting, in_notebook
from labbook.run.progress import Bar
from labbook.run.runner import CHECKPOINT_EVERY, Runner, Summary
from labbook.run.shard import WHOLE, Shard
from labbook.run.watch import Unwatched, Watcher
from labbook.scene.quantities import parse
from labbook.stats import Measured
from labbook.study import Point, Study, load
from labbook.study.keys import find as find_keys
from labbook.study.pilot import first_needed, whole
from labbook.study.problems import grouped, instead
from labbook.study.source import given_path
from labbook.warning import LabWarning, by_a_verb, caller, warn

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["Conflict", "Lab", "LabWarning", "Results", "Run"]


def _is_study(given: object) -> None:
    if not isinstance(given, Study):
        raise TypeError(f"a Study is needed, and not {given!r}; read a file with labbook.load(path)")


@dataclass(frozen=True)
class Lab:
    """A folder with runs and packings, and the backend and device that make them.

    The folder is created at the first write; `~` is the home folder, as in a shell. Several processes may use one lab
    at once: they share the work.
    """

    folder: Path | str = DEFAULT
    backend: str = "numba"
    """Backend that makes the runs, and whose runs `results` reads: `numba` (CPU) or `warp` (GPU)."""
    device: str = "cpu"
    """Device, such as `cpu` or `cuda:0`; several as `cuda:0,cuda:1` or `cuda:all`."""

    def __post_init__(self):
        object.__setattr__(self, "folder", given_path(self.folder, "labbook.Lab: folder"))

    @property
    def place(self) -> LabFolder:
        """The folder, with methods for the places in it."""
        return LabFolder(Path(self.folder))

    def plan(self, study: Study) -> Plan:
        """The runs that `study` still needs in this lab and why, with a forecast of time and disk space, and warnings.

        Raises Unsupported, Conflict or MeasureError if the backend cannot do it, TooLarge, BackendMissing, LabError.
        """
        _is_study(study)
        with self._catalogue() as catalogue, _in_python():
            return foresee(study, catalogue, load_backend(self.backend), self.device)

    def run(
        self,
        study: Study,
        progress: bool | Watcher = True,
        checkpoint_every: float = CHECKPOINT_EVERY,
        shard: str | None = None,
        base: Path | str | None = None,
        cluster: str | None = None,
    ) -> Summary:
        """Make the runs that `study` still needs; finished runs are not repeated.

        progress: whether to show a bar, or a Watcher to inform. checkpoint_every: wall time [s] between two saves of a
        run; more if saving took over 5 % of the time. shard: I/N, to run only part I of N parts of the study, which
        have about the same forecast cost; all runs from one packing are in one part. base: another lab, whose runs are
        not repeated and whose packings are used. cluster: address of a Dask scheduler; its workers run the study
        (extra `cluster`). Ctrl-C saves unfinished runs and returns; a second one raises KeyboardInterrupt and keeps the
        last checkpoints. Either way the next call goes on. Failed runs give a warning and are named in the summary.
        If anything is to run, the warnings of the plan are repeated before, unless progress is False. Raises what
        `plan` does except TooLarge, before anything runs; ValueError for a wrong `shard`; DiskFull.
        """
        _is_study(study)
        part = WHOLE if shard is None else Shard.parse(shard)
        other = None if base is None else LabFolder(given_path(base, "base"))
        backend, plain = load_backend(self.backend), isinstance(progress, bool)
        with _in_python():
            foreseen = () if progress is False else self._forewarned(study, backend)
        with _watching(progress) as watcher, _in_python():
            for line in foreseen:
                watcher.tell(line)
            if cluster is not None:
                summary = Cluster(study, self.place, self.backend, cluster, self.device, watcher=watcher).run()
            else:
                first, *others = named(self.device, backend)
                options = (checkpoint_every, watcher)
                if others:
                    runner = Crew(study, self.place, self.backend, (first, *others), *options, part, other)
                else:
                    runner = Runner(study, self.place, backend, first, *options, shard=part, base=other)
                summary = runner.run()
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

        def looked() -> tuple[str, ...]:
            with self._catalogue() as catalogue:
                return tuple(f"Warning: {line}" for line in forewarn(study, catalogue, backend, self.device))

        try:
            return looked()
        except NoCatalogue:
            index = Index(self.place)  # to run makes the index of a lab without one, where a plan only looks
            index.close()
            return (*(f"Unreadable: {problem}" for problem in index.found.problems), *looked())

    def _no_flow(self, study: Study, summary: Summary) -> str:
        """Why no point has a flow rate, though the study measures it and runs are done; empty if one has."""
        done = [[item.keys.run for item in point.items if item.state == "done"] for point in summary.points]
        if FLOW_RATE not in study.measure or not any(done):
            return ""
        with self._catalogue() as catalogue:
            if any(flow_rates(study, catalogue, keys) for keys in done):
                return ""
            found = find(study, catalogue, self.backend, lambda done: None)
        return "; ".join(dict.fromkeys(filter(None, (point.no_flow for point in found.points)))) or "see the report"

    def pilot(self, study: Study, progress: bool | Watcher = True, seeds: int | None = None) -> Study:
        """`study` with numerics chosen from its pilot: runs that measure the effect of numerics on the flow rate.

        seeds: None for the pilot that the requested error needs, which has two time steps; a study whose scenes are
        calibrated, or that requests no error, needs none and is returned as it is. With a number a whole pilot is
        run, needed or not: seven settings of time step and stiffness with `seeds` runs each, at the first and last
        point. A study that sweeps numerics is its own pilot.

        The calibration is written beside the study file, where `load` finds it, or into the lab for a study made
        in Python. Raises what `run` raises; NotCalibrated where too few runs flowed or scenes of this kind cannot be
        calibrated, PilotStopped after Ctrl-C; OSError where the calibration cannot be written, before anything runs.
        """
        _is_study(study)
        runs = first_needed(study) if seeds is None else whole(study, seeds)
        if runs is None:
            return study
        file = self.place.studies / f"{study.name}{BESIDE}" if not study.source else study.path.with_suffix(BESIDE)
        if study.source and not os.access(file.parent, os.W_OK):
            raise PermissionError(errno.EACCES, "the calibration of its pilot cannot be written there", str(file))
        write(file, [one.effects for one in effects_of_numerics(self, runs, progress)])
        return load(study.path) if study.source else study.change({"accuracy.calibration": str(file.resolve())})

    def results(self, study: Study, progress: bool | Callable[[int], None] = True) -> "Results":
        """Results of `study` so far. Runs that are not evaluated yet are evaluated now, and the numbers are kept.

        progress: whether to show how many runs are evaluated, or a function to call. Unreadable runs give a warning
        and are left out; measures that fail on a run give one too. Raises LabError.
        """
        _is_study(study)
        if not Path(self.folder).exists():
            warn(f"there is no lab {self.folder} yet, so that it has no runs")
        with self._catalogue() as catalogue, _counting(progress, "evaluating runs") as told:
            found = find(study, catalogue, self.backend, told)
        for problem in grouped(found.unreadable):
            warn(f"left out: {problem}")
        for problem in grouped(found.unmeasured):
            warn(f"not measured: {problem}")
        return Results(**{one.name: getattr(found, one.name) for one in fields(found)}, lab=self)

    def frame(
        self, study: Study | str | None = None, outcome: str | None = None, limit: int | None = None
    ) -> "pd.DataFrame":
        """All runs of the lab, the latest first: one row per run, with units in `attrs`.

        study: only runs first made for this study (or its name); outcome: only runs with this outcome, or
        `unreadable`, or `suspect`; limit: largest number of rows. Raises LabError, and ValueError for an outcome or the
        name of a study that no run has.
        """
        with self._catalogue() as catalogue:
            if absent := catalogue.absent(study if isinstance(study, str) else None, outcome):
                raise ValueError(absent)
            made = catalogue.runs(study.name if isinstance(study, Study) else study, outcome, limit)
        made.attrs = {"lab": str(self.folder), "units": {"duration": "s", "wall_time": "s", "rate": "1/s"}}
        return made

    def __repr__(self) -> str:
        head = f"<Lab {self.folder} on {self.backend}, {self.device}"
        try:
            with self._catalogue() as catalogue:
                counts, packings = catalogue.counts(), catalogue.packing_count()
        except LabError as error:
            return f"{head}: {error}>"
        by = ", ".join(f"{count} {outcome}" for outcome, count in sorted(counts.items()))
        held = f"{sum(counts.values())} runs{f' ({by})' if by else ''}, {packings} packings"
        return f"{head}: {held}>"

    def _repr_html_(self) -> str:
        try:
            with self._catalogue() as catalogue:
                counts, packings = catalogue.studies(), catalogue.packing_count()
        except LabError as error:
            return escape(f"<Lab {self.folder} on {self.backend}, {self.device}: {error}>")
        rows = [(one.study or "–", one.backend, one.outcome, str(one.runs)) for one in counts]
        listed = html.table(("study", "backend", "outcome", "runs"), rows[:_SHOWN]) if rows else ""
        more = [f"and {len(rows) - _SHOWN} more rows"] if len(rows) > _SHOWN else []
        runs = sum(one.runs for one in counts)
        said = f"{runs} run{'' if runs == 1 else 's'}, {packings} packing{'' if packings == 1 else 's'}"
        return html.titled(f"Lab {self.folder} on {self.backend}, {self.device}: {said}", listed, html.lines(more))

    @contextmanager
    def _catalogue(self) -> Iterator[Catalogue]:
        catalogue = Catalogue(self.place)
        try:
            yield catalogue
        finally:
            catalogue.close()


def effects_of_numerics(lab: Lab, pilot: Study, progress: bool | Watcher = True) -> tuple[Calibrated, ...]:
    """What numerics do to the flow rate, scene by scene, from a pilot, whose missing runs are made.

    Raises what `Lab.pilot` raises.
    """
    for point in pilot.points:
        flow_and_filling(point)  # refuses, before anything runs, scenes that have no groups
    if lab.run(pilot, progress).stopped:
        raise PilotStopped
    return calibrate(pilot.name, lab.results(pilot, False).points)


@dataclass(frozen=True, eq=False, repr=False)
class Results(Found):
    """All results of a study, with its tables, figures and files."""

    lab: Lab = Lab()
    """The lab that has the runs."""

    def frame(self) -> "pd.DataFrame":
        """A row a point: `point` (from 1), what was swept, and of each quantity its mean over replicates (`flow_rate`),
        standard error (`flow_rate_error`), the ends of its 95 % interval (`flow_rate_low`, `flow_rate_high`) and the
        number of runs in the mean (`flow_rate_n`); `runs`: finished runs of the point, however they ended;
        `replicates`: those in the mean of the flow rate, or in any mean if the study does not measure it; `remark`.

        SI, units in `attrs`; NaN for what is not known, so error and interval of a mean of one run are NaN.
        """
        import pandas as pd

        rows: list[dict[str, Any]] = []
        units, measured = self.study.units, FLOW_RATE in self.study.measure
        rates = [f"{FLOW_RATE}{end}" for end in (*_ENDS, "_n") if measured]
        for result in self.points:
            row: dict[str, Any] = {"point": result.point.index + 1, **result.point.at}
            row |= {name: 0 if name.endswith("_n") else math.nan for name in rates}  # also where no run has one
            for name, pooled in result.pooled.items():
                low, high = known_interval(pooled.low, pooled.high)
                row |= {name: pooled.value, f"{name}_error": pooled.error, f"{name}_low": low, f"{name}_high": high}
                row[f"{name}_n"] = pooled.n
            numbers = {name: one for run in result.runs for name, one in run.measured.items() if name in result.pooled}
            for name, one in numbers.items():
                units |= {f"{name}{end}": one.unit for end in _ENDS}
            n = row[f"{FLOW_RATE}_n"] if measured else max((one.n for one in result.pooled.values()), default=0)
            rows.append({**row, "runs": len(result.runs), "replicates": n, "remark": result.remark})
        swept = dict.fromkeys(key for point in self.study.points for key in point.at)
        empty = ["point", *swept, *rates, "runs", "replicates", "remark"]
        made = pd.DataFrame(rows, columns=None if rows else empty)
        for name in (f"{one}_n" for one in dict.fromkeys(one for result in self.points for one in result.pooled)):
            made[name] = made[name].fillna(0).astype(int)  # of points that lack it
        made.attrs = {"study": self.study.name, "units": units}
        return made

    def frames(self) -> dict[str, "pd.DataFrame"]:
        """All tables by name, one row per number, as `labbook export` writes them: see `labbook.results.frames.frames`.

        SI, with units in `attrs` and in columns called `unit`.
        """
        return frames(self)

    def fit(self, law: str, at: Mapping[str, Any] | None = None) -> FitResult:
        """Fit of the law with this name (`beverloo_3d` or `Beverloo 3d`) to flow rates against the orifice; the study
        need not list it.

        at: the series, if other keys than the orifice are swept (`{"container.angle": "30 deg"}`). Raises FitError,
        LookupError if `at` is missing or matches no series.
        """
        series, law = self._series(at), named_law(law)
        if law not in series.fits:
            (series,) = series_of(series.points, (law,)) or (series,)
        if law in series.fits:
            return series.fits[law]
        if law in LAWS:
            raise FitError("; ".join(series.problems))
        raise FitError(f"no law of the flow rate is called {law}; {instead(law, LAWS)}")

    def figures(self, at: Mapping[str, Any] | None = None) -> tuple[str, ...]:
        """Names of the figures that `plot` can draw. at: only figures of this series (None: of all series)."""
        series = self.series if at is None else (self._series(at),)
        own = [name for one in series for name in gallery.of_series(self, one)]
        shared = [*gallery.of_results(self)]
        return tuple(dict.fromkeys([*own, *shared] if len(series) == 1 else [*shared, *own]))

    def plot(self, name: str | None = None, at: Mapping[str, Any] | None = None) -> "Figure":
        """One of the report's figures, by its name in `figures()` (None: the first) or that of its file in the report
        (`flow`, `fit`); a notebook displays it.

        at: the series, as for `fit`. Raises LookupError for an unknown figure.
        """
        name = gallery.FILES.get(name or "", name) or next(iter(self.figures(at)), "flow_rate")
        if name not in (known := self.figures()):
            there = ", ".join(known) or "none, as there are no series of finished points"
            raise gallery.NothingToShow(f"no figure of these results is called {name}; there are: {there}")
        draw = gallery.of_results(self).get(name)
        if draw is None and self.series:
            draw = gallery.of_series(self, self._series(at)).get(name)
        if draw is None:
            raise gallery.NothingToShow(f"this series has no figure {name}; it has: {', '.join(self.figures(at))}")
        return style.displayed(draw())

    @cached_property
    def runs(self) -> "tuple[Run, ...]":
        """All runs, ordered by point and seed."""
        return tuple(
            Run(run.run, run.measured, run.measures, run.window, run.counted, self)
            for p in self.points
            for run in p.runs
        )

    def run(self, point: Point | int | None = None, seed: int = 1, *, at: Mapping[str, Any] | None = None) -> "Run":
        """The run with this seed of a point: a Point of the study, its number (from 1), or the one whose swept values
        are `at` (`{"container.orifice": "18 mm", "contact.friction": 0.2}`). Raises LookupError, TypeError."""
        if (point is None) == (at is None):
            raise TypeError("give a point (a Point of the study, or its number from 1) or the values `at` it")
        number = self._at(at) if at is not None else point.index + 1 if isinstance(point, Point) else point
        if isinstance(number, bool) or not isinstance(number, Integral):
            raise TypeError(f"a Point of the study or its number is needed, and not {point!r}")
        for run in self.runs:
            if (run.point.index + 1, run.seed) == (number, seed):
                return run
        there = ", ".join(_listed([f"({run.point.index + 1}, {run.seed})" for run in self.runs])) or "none"
        raise LookupError(f"no finished run of point {number} with seed {seed}; there are, as (point, seed): {there}")

    def _at(self, at: Mapping[str, Any]) -> int:
        """The number of the point with these values. Raises LookupError."""
        points = self.study.points
        keys = list(dict.fromkeys(key for point in points for key in point.at))
        asked: dict[str, float | str] = {}
        for key, value in at.items():
            meant = [name for name in keys if name == key or name.endswith(f".{key}")]
            if len(meant) != 1:
                raise LookupError(f"at: the study does not sweep {key}; {instead(str(key), keys)}")
            asked[meant[0]] = _value(meant[0], value, points[0])
        found = [one for one in points if all(_same(one.at.get(key), value) for key, value in asked.items())]
        if len(found) == 1:
            return found[0].index + 1
        there = "; ".join(_listed([_written(one.at) for one in found or points]))
        raise LookupError(f"{len(found)} points are at {dict(at)}; there are: {there}")

    def report(self, folder: Path | str | None = None) -> Path:
        """Write the report, one HTML file, and its figures as PNG, SVG and PDF, into a folder (None:
        LAB/reports/NAME). Returns the path of the page."""
        return page.write(self, self._folder(folder, "reports"))

    def export(
        self,
        folder: Path | str | None = None,
        kind: Literal["csv", "parquet"] = "csv",
        vtk: bool = False,
        packings: bool = False,
        every: float | None = None,
        say: Callable[[str], None] = lambda text: None,
    ) -> list[Path]:
        """Write all tables; with `vtk` also recorded runs for ParaView, with `packings` also initial packings as data
        files of LIGGGHTS and LAMMPS. Returns the paths.

        folder: None for LAB/exports/NAME. every: also write the table `inside`, the number of grains inside at times
        this far apart [s]. say: called with the name of each file. Raises ValueError for another kind, NoParquet (of
        `labbook.export.study`) without pyarrow, NotSpheres (of `labbook.export.packing`) for packings of rods, and
        Unreadable (of `labbook.lab`) for a damaged one.
        """
        if packings:
            check_spheres(self.study)
        there = self._folder(folder, "exports")
        paths = write_numbers(self, there, kind, every)
        if packings:
            paths += write_packings(self, self.lab.place, there / "packings", say)
        return paths + (write_recordings(self, there / "vtk", say) if vtk else [])

    def _folder(self, given: Path | str | None, kind: str) -> Path:
        """The folder that was given for files, or that of this study in the lab."""
        if given is None:
            return Path(self.lab.folder) / kind / self.study.name
        return given_path(given, f"results.{kind.removesuffix('s')}: folder")

    def _series(self, at: Mapping[str, Any] | None) -> Series:
        """The one series that `at` names. Raises LookupError."""
        if not self.series:
            raise LookupError("there is no series, as no point with an orifice is done")
        asked = {}
        for key, value in (at or {}).items():
            name = self._key(str(key))
            asked[name] = _value(name, value, self.study.points[0])
        found = [one for one in self.series if all(_same(one.at.get(key), value) for key, value in asked.items())]
        if len(found) == 1:
            return found[0]
        there = "; ".join(_listed([_written(one.at) for one in self.series]))
        if at:
            raise LookupError(f"{len(found)} series are at {dict(at)}; there are: {there}")
        raise LookupError(f"the study has several series: say which by `at`; there are: {there}")

    def _key(self, name: str) -> str:
        """The key, by which series are told apart, that is called so; its last part will do where it is the only one.
        Raises LookupError."""
        keys = list(dict.fromkeys(key for one in self.series for key in one.at))
        meant = [key for key in keys if key == name or key.endswith(f".{name}")]
        if len(meant) == 1:
            return meant[0]
        if len(meant) > 1:
            raise LookupError(f"at: {name} may be {' or '.join(meant)}")
        if name == ORIFICE or ORIFICE.endswith(f".{name}"):
            raise LookupError(
                f"at: {ORIFICE} is the axis of every series and tells none apart; "
                + (f"series are told apart by {', '.join(keys)}" if keys else "there is one series: leave out `at`")
            )
        raise LookupError(f"at: series are not told apart by {name}; {instead(name, keys)}")

    def __repr__(self) -> str:
        head = f"<Results of {self.study.name} on {self.lab.backend} in {self.lab.folder}: "
        lines = [
            head + ("no finished run; lab.run(study) makes them>" if not self.points else f"{len(self.runs)} runs>")
        ]
        for result in self.points:
            flow = result.flow_rate
            said = "no flow rate" if flow is None else f"W = {display.with_error(flow.value, flow.error, 1e3)} g/s"
            lines.append(
                f"  {result.label or 'the only point'}: {said}" + (f" ({result.remark})" * bool(result.remark))
            )
        return "\n".join(lines[:_SHOWN] + ([f"  and {len(lines) - _SHOWN} more"] if len(lines) > _SHOWN else []))

    def _repr_html_(self) -> str:
        if not self.points:
            return escape(repr(self))
        shown = "".join(f"<div>{escape(line)}</div>" for line in page.summary(self))
        return f"<div><b>{escape(self.study.name)}</b></div>{shown}{_html(tables.flow_table(self))}{self._picture()}"

    def _picture(self) -> str:
        """The first figure of all, as the notebook's own: of several series the one that shows them all."""
        drawn = {**(gallery.of_results(self) if len(self.series) > 1 else {})}
        for one in self.series[:1]:
            drawn |= gallery.of_series(self, one)
        for draw in list(drawn.values())[:1]:
            data, size = style.for_a_screen(draw())
            return f'<img width="{size["width"]}" src="data:image/png;base64,{b64encode(data).decode()}"/>'
        return ""


@dataclass(frozen=True, eq=False, repr=False)
class Run(RunResult):
    """One run: its outcome, its measurements, and its recorded tables."""

    results: Results

    @property
    def point(self) -> Point:
        """The point of the study."""
        return self.run.point

    @property
    def folder(self) -> Path:
        """Folder of the run."""
        return self.results.lab.place.run(self.run_key)

    @property
    def picture(self) -> Path | None:
        """The picture (PNG) of its bed in the middle of the window, or at its end if that came before; None without
        one."""
        return picture(self.folder)

    @property
    def tables(self) -> tuple[str, ...]:
        """Names of the recorded tables."""
        return tuple(self.run.data().tables)

    def frame(self, table: str = "crossing") -> "pd.DataFrame":
        """A recorded table: `crossing`, one row for every grain that left, or that of another probe (columns:
        `labbook.backend.probes`). SI, units in `attrs`. Raises LookupError; LabError if it cannot be read."""
        import pandas as pd

        found = self.run.data().tables
        if table not in found:
            raise LookupError(f"this run has no table {table}; use one of: {', '.join(found) or 'none'}")
        columns = sorted(
            found[table].items(), key=lambda one: _ORDER.index(one[0]) if one[0] in _ORDER else len(_ORDER)
        )
        made = pd.DataFrame({name: column for name, column in columns if name != "member"})
        units = {name: UNITS[name] for name in made if name in UNITS}
        made.attrs = {"study": self.results.study.name, "run_key": self.run_key, "units": units}
        return made

    def trajectories(self) -> Trajectories:
        """Trajectories of the grains, as arrays. Raises NotRecorded (of `labbook.export.recording`)."""
        found = Trajectories.of(self.run.data())
        if found is None:
            remedy = "add record={'every': '10 ms', 'replicates': ...} to the study and run it"
            raise NotRecorded(f"{self} kept no frames: {remedy}")
        return found

    def recording(self) -> Path:
        """The file (.rrd) for the rerun viewer, written if it does not exist. Raises NotRecorded or ViewerMissing."""
        return of_run(self.folder, Path(self.results.lab.folder), self.results.study.name, self.point)

    def view(self) -> None:
        """Open the rerun viewer and wait until it is closed. Raises NotRecorded, ViewerMissing or ViewerFailed."""
        show([self.recording()])

    def _repr_html_(self) -> str:
        label = self.point.label or "the only point"
        state = (
            f"{self.outcome}{', recorded' if self.recorded else ''}{f', suspect: {self.suspect}' * bool(self.suspect)}"
        )
        facts = html.table((), [("outcome", state), ("run", self.run_key[:16]), ("folder", str(self.folder))])
        bed = ""
        if self.picture is not None:
            data = b64encode(self.picture.read_bytes()).decode()
            bed = f'<img alt="The bed" style="max-height:16em" src="data:image/png;base64,{data}"/>'
        numbers = f"<div>{facts}{_quantities(self.measured)}</div>"
        shown = f'<div style="display:flex;flex-wrap:wrap;gap:1.5em">{bed}{numbers}</div>'
        return html.titled(f"{self.results.study.name}, {label}, seed {self.seed}", shown)

    def __repr__(self) -> str:
        recorded = ", recorded" if self.recorded else ""
        return f"<Run of {self.results.study.name}, {self.point.label}, seed {self.seed}: {self.outcome}{recorded}>"


_ORDER = ("id", "i", "j", "wall", "step", *UNITS)
"""Of the columns of a table."""
_OPTION = re.compile(r"(?<=use )--(device|backend) ([\w:]*\w)")
"""Of the command line, with its value."""
_ENDS = ("", "_error", "_low", "_high")
"""Of the names of columns that have the unit of their quantity."""
_NAMED = 12
"""Series, points or runs that a message names."""
_SHOWN = 40
"""Lines of a plain text."""


class _Quiet(Unwatched):
    """Shows nothing, and warns of what must not be missed, at the line of the user's code that is at work."""

    def __init__(self):
        self._place = caller()  # lines are told from threads of their own

    def tell(self, line: str) -> None:
        """Warn of it."""
        warn(line, self._place)


@contextmanager
def _in_python() -> Iterator[None]:
    """Names arguments of Python where a message names options of the command line, unless a verb has called."""
    try:
        yield
    except Unsupported as problem:
        if by_a_verb():
            raise
        said = _OPTION.sub(lambda found: f"{found[1]}={found[2]!r}", problem.remedy).replace("--", "")
        raise Unsupported(problem.key.removeprefix("--"), said) from problem


def _watching(progress: bool | Watcher) -> AbstractContextManager[Watcher]:
    """Who is told how runs go."""
    if not isinstance(progress, bool):
        return nullcontext(progress)
    if not progress:
        return nullcontext(_Quiet())
    if in_notebook():
        return NotebookBar()
    from rich.console import Console

    return Bar(Console(stderr=True))


@contextmanager
def _counting(progress: bool | Callable[[int], None], what: str) -> Iterator[Callable[[int], None]]:
    """A function to tell how many runs are done."""
    if not isinstance(progress, bool):
        yield progress
        return
    if progress and in_notebook():
        with counting(what) as told:
            yield told
        return
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not (progress and console.is_terminal)) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done: bar.update(task, completed=done)


def _value(key: str, value: Any, point: Point) -> float | str:
    """A value of a key in SI, or the word that it is; text is read as a study's, with its unit."""
    known = next((one for one in find_keys(key) if one.unit is not None), None)
    if isinstance(value, str) and known is not None:
        return parse(value, known.unit, point.scene.grains.diameter)
    return value if isinstance(value, str) else float(value)


def _written(at: Mapping[str, float | str]) -> str:
    """What tells a series apart, as one writes it for `at`: with units, and numbers that mean the very same value."""
    written: dict[str, float | str] = {}
    for key, value in at.items():
        shown = display.key(key)
        written[key] = value
        if not isinstance(value, str) and shown.unit:
            text = f"{value * shown.scale:.12g} {shown.unit}"
            with suppress(ValueError):  # units that are shown by a sign of their own
                written[key] = text if _same(parse(text, None), value) else value
    return repr(written)


def _listed(texts: Sequence[str]) -> list[str]:
    """The first of many, and how many there are."""
    return [*texts[:_NAMED], f"... ({len(texts)} in all)"] if len(texts) > _NAMED else [*texts]


def _same(one: float | str | None, other: float | str) -> bool:
    if isinstance(one, str) or isinstance(other, str) or one is None:
        return one == other
    return math.isclose(one, other, rel_tol=1e-9)


def _html(shown: tables.Table) -> str:
    """A table of a report as a notebook shows it."""
    return html.table(shown.headings, shown.rows, shown.notes)


def _quantities(measured: Mapping[str, Measured]) -> str:
    """The numbers of a run, as its page shows them."""
    rows = []
    for name, one in measured.items():
        shown = display.quantity(name, one.unit)
        value = display.with_error(one.value, one.error, shown.scale) if math.isfinite(one.value) else "–"
        rows.append((shown.name, value, shown.unit, one.note))
    return html.table(("quantity", "value ± error", "unit", "note"), rows)
