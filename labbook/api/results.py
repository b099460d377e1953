"""Results of a study as Python has them: with frames, fits, figures and files."""

import math
from base64 import b64encode
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

from labbook import html
from labbook.api.run import Run
from labbook.export.packing import check_spheres, write_packings
from labbook.export.stl import check_facets, write_walls
from labbook.export.study import write_numbers, write_recordings
from labbook.fit import LAWS, FitError, FitResult
from labbook.fit import law_name as named_law
from labbook.lab import LabFolder
from labbook.lab.records import repeat
from labbook.report import gallery, page, style, tables
from labbook.results import display
from labbook.results.calibrated import CalibrationResults
from labbook.results.calibrated import calibration as calibration_of
from labbook.results.explore import DesignSurface, inverse
from labbook.results.explore import explore as explored
from labbook.results.frames import frames, known_interval
from labbook.results.points import FLOW_RATE
from labbook.results.selection import listed, point_at, series_at
from labbook.results.series import series_of
from labbook.results.study import StudyResults
from labbook.results.surface import DesignValue, ResponseSurface
from labbook.results.surface import surface as surface_of
from labbook.scene.walls import AROUND
from labbook.study import Point
from labbook.study.problems import instead
from labbook.study.source import given_path
from labbook.study.stated import LawName, Swept
from labbook.warning import RenamedAttribute

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

_ENDS = ("", "_error", "_low", "_high")
"""Of the names of columns that have the unit of their quantity."""
_LINES = 40
"""Lines of a plain text."""


@dataclass(frozen=True, eq=False, repr=False)
class Results(StudyResults):
    """Results of a study, with its tables, figures and files.

    Args:
        lab_folder: Folder of the lab that has the runs.
        backend: Name of the backend that made the runs.
    """

    lab_folder: LabFolder = field(kw_only=True)
    place = RenamedAttribute("lab_folder")
    backend: str = field(kw_only=True)

    def frame(self) -> "pd.DataFrame":
        """Means of all points as a data frame, in SI, with units in `attrs`.

        Returns:
            A row for each point: `point` (from 1), swept keys, and of each quantity its mean over replicates
            (`flow_rate`), standard error (`flow_rate_error`), ends of its 95 % interval (`flow_rate_low`,
            `flow_rate_high`) and number of beds in the mean (`flow_rate_n`); `runs`: finished runs of any outcome;
            `replicates`: beds in the mean of the flow rate, or in any mean if the study does not measure it; `remark`.
            Unknown numbers are NaN, such as the error of a mean of one run.
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
            for name, number in numbers.items():
                units |= {f"{name}{end}": number.unit for end in _ENDS}
            n = (
                row[f"{FLOW_RATE}_n"]
                if measured
                else max((pooled_value.n for pooled_value in result.pooled.values()), default=0)
            )
            rows.append({**row, "runs": len(result.runs), "replicates": n, "remark": result.remark})
        swept = dict.fromkeys(key for point in self.study.points for key in point.at)
        empty = ["point", *swept, *rates, "runs", "replicates", "remark"]
        frame = pd.DataFrame(rows, columns=None if rows else empty)
        for name in (
            f"{quantity}_n"
            for quantity in dict.fromkeys(quantity for result in self.points for quantity in result.pooled)
        ):
            frame[name] = frame[name].fillna(0).astype(int)  # of points that lack it
        frame.attrs = {"study": self.study.name, "units": units}
        return frame

    def frames(self) -> dict[str, "pd.DataFrame"]:
        """All tables by name, as `labbook export` writes them (`labbook.results.frames.frames`).

        Returns:
            Data frames with one row per number, in SI, with units in `attrs` and in columns called `unit`.
        """
        return frames(self)

    @overload
    def fit(self, law: LawName, at: Swept | None = None) -> FitResult: ...

    @overload
    def fit(self, law: str, at: Mapping[str, Any] | None = None) -> FitResult: ...

    def fit(self, law: str, at: Mapping[str, Any] | None = None) -> FitResult:
        """Fit a law to flow rates against the orifice. The study need not list it.

        Args:
            law: Name of the law, `beverloo_3d` or `Beverloo 3d`.
            at: Values of the series, if other keys than the orifice are swept (`{"container.angle": "30 deg"}`).

        Returns:
            Fitted parameters with intervals, goodness and band.

        Raises:
            FitError: The law cannot be fitted to these points, or there is no such law.
            LookupError: `at` is missing or matches no series.
        """
        series, law = series_at(self.series, at, self.study.points[0]), named_law(law)
        if law not in series.fits:
            (series,) = series_of(series.points, (law,)) or (series,)
        if law in series.fits:
            return series.fits[law]
        if law in LAWS:
            raise FitError("; ".join(series.problems))
        raise FitError(f"no law of the flow rate is called {law}; {instead(law, LAWS)}")

    def surface(
        self, quantity: str = FLOW_RATE, over: str | None = None, at: Mapping[str, Any] | None = None
    ) -> ResponseSurface:
        """Predict a quantity between the swept values of a key, with its interval: by a law of the study if the points
        allow it, else interpolated. `surface.predict("21 mm")` gives value and ends.

        Args:
            quantity: Name of the quantity.
            over: The key, or its last part; None: the only swept key that takes numbers.
            at: Values of the other swept keys.

        Returns:
            The surface, which refuses values beyond the range.

        Raises:
            LookupError: The study does not have these keys or values.
            NoSurface: Too few points have the quantity (of `labbook.results.surface`).
        """
        return surface_of(self, quantity, over, at)

    def inverse(
        self, quantity: str, value: str | float, over: str | None = None, at: Mapping[str, Any] | None = None
    ) -> DesignValue:
        """Find the value of a swept key at which a quantity takes a given value.

        `results.inverse("flow_rate", "50 g/s")` gives the orifice for 50 g/s.

        Args:
            quantity: Name of the quantity.
            value: Its value: text with a unit, or a number in SI.
            over: The key, as for `surface`.
            at: Values of the other swept keys; if no point has them, a surface over all keys answers (`explore`).

        Returns:
            The value of the key with its 95 % interval.

        Raises:
            LookupError: The study does not have these keys or values.
            NoSurface: Too few points have the quantity, or it takes the value nowhere or repeatedly in the range.
            ValueError: The text is no such quantity.
        """
        return inverse(self, quantity, value, over, at)

    def explore(self, quantity: str = FLOW_RATE, at: Mapping[str, Any] | None = None) -> DesignSurface:
        """Model a quantity over all swept keys of numbers at once.

        Args:
            quantity: Name of the quantity.
            at: Values of the swept keys that take words or belong to numerics.

        Returns:
            The surface: `predict(design)` and `inverse(value, over, others)` with intervals, `influences` of the keys,
            `next_runs` and `next_study` with the gain of further runs.

        Raises:
            LookupError: The study does not have these keys or values.
            NoSurface: The points do not determine it (of `labbook.results.surface`).
        """
        return explored(self, quantity, at)

    def figures(self, at: Mapping[str, Any] | None = None) -> tuple[str, ...]:
        """List the figures that `plot` can draw.

        Args:
            at: Only figures of the series with these values; None: of all series.

        Returns:
            Their names.
        """
        series = self.series if at is None else (series_at(self.series, at, self.study.points[0]),)
        own = [name for each_series in series for name in gallery.of_series(self, each_series)]
        shared = [*gallery.of_results(self)]
        return tuple(dict.fromkeys([*own, *shared] if len(series) == 1 else [*shared, *own]))

    @overload
    def plot(self, name: gallery.FigureName | None = None, at: Swept | None = None) -> "Figure": ...

    @overload
    def plot(self, name: str | None = None, at: Mapping[str, Any] | None = None) -> "Figure": ...

    def plot(self, name: str | None = None, at: Mapping[str, Any] | None = None) -> "Figure":
        """Draw a figure of the report.

        Args:
            name: Name in `figures()`, or of its file in the report (`flow`, `fit`); None: the first.
            at: Values of the series, as for `fit`.

        Returns:
            The figure, which a notebook displays.

        Raises:
            LookupError: There is no such figure.
        """
        name = gallery.FILES.get(name or "", name) or next(iter(self.figures(at)), "flow_rate")
        if name not in (names := self.figures()):
            there = ", ".join(names) or "none, as there are no series of finished points"
            raise gallery.NothingToShow(f"no figure of these results is called {name}; there are: {there}")
        draw = gallery.of_results(self).get(name)
        if draw is None and self.series:
            draw = gallery.of_series(self, series_at(self.series, at, self.study.points[0])).get(name)
        if draw is None:
            raise gallery.NothingToShow(f"this series has no figure {name}; it has: {', '.join(self.figures(at))}")
        return style.displayed(draw())

    @cached_property
    def runs(self) -> tuple[Run, ...]:
        """All runs, ordered by point, seed and discharge."""
        return tuple(
            Run(run.run, run.measured, run.measures, run.window, run.counted, self.study, self.lab_folder)
            for p in self.points
            for run in p.runs
        )

    def run(
        self,
        point: Point | int | None = None,
        seed: int = 1,
        *,
        discharge: int = 1,
        at: Mapping[str, Any] | None = None,
    ) -> Run:
        """Find a run.

        Args:
            point: A Point of the study, or its number (from 1).
            seed: Seed of the bed.
            discharge: Number of the discharge of its bed, from 1.
            at: Swept values in place of `point` (`{"container.orifice": "18 mm", "contact.friction": 0.2}`).

        Returns:
            The run.

        Raises:
            LookupError: No finished run is there.
            TypeError: Neither or both of `point` and `at` are given.
        """
        if (point is None) == (at is None):
            raise TypeError("give a point (a Point of the study, or its number from 1) or the values `at` it")
        if at is not None:
            point = point_at(self.study.points, at)
        number = point.index + 1 if isinstance(point, Point) else point
        if isinstance(number, bool) or not isinstance(number, Integral):
            raise TypeError(f"a Point of the study or its number is needed, and not {point!r}")
        for run in self.runs:
            if (run.point.index + 1, run.seed, run.discharge) == (number, seed, discharge):
                return run
        several = any(run.discharge > 1 for run in self.runs)
        numbers = [(run.point.index + 1, run.seed, *([run.discharge] if several else [])) for run in self.runs]
        there = ", ".join(listed([f"({', '.join(map(str, one))})" for one in numbers])) or "none"
        lacking = f"no finished run of point {number} with {repeat(seed, discharge)}"
        names = "point, seed, discharge" if several else "point, seed"
        raise LookupError(f"{lacking}; there are, as ({names}): {there}")

    def calibration(self) -> CalibrationResults:
        """Infer the parameters of a study with `calibrate`, from the runs that the lab has.

        Returns:
            Posterior of the parameters, with predictions and the next experiment.

        Raises:
            NoPosterior: The study has no `calibrate`, or too few runs (of `labbook.results.calibrated`).
            LearnMissing: The extra `learn` is not installed (of `labbook.stats.emulator`).
        """
        return calibration_of(self)

    def report(self, folder: Path | str | None = None) -> Path:
        """Write the report, one HTML file, and its figures as PNG, SVG and PDF.

        Args:
            folder: Folder to write into; None: LAB/reports/NAME.

        Returns:
            Path of the page.
        """
        return page.write(self, self._folder(folder, "reports"))

    def export(
        self,
        folder: Path | str | None = None,
        kind: Literal["csv", "parquet"] = "csv",
        vtk: bool = False,
        packings: bool = False,
        every: float | None = None,
        say: Callable[[str], None] = lambda text: None,
        walls: bool = False,
        facets: int = AROUND,
        headings: bool = False,
    ) -> list[Path]:
        """Write all tables, and on request recordings, packings and walls.

        Args:
            folder: Folder to write into; None: LAB/exports/NAME.
            kind: Format of the tables.
            vtk: Also write recorded runs as VTK files for ParaView.
            packings: Also write initial packings as data files of LIGGGHTS and LAMMPS, with their walls as STL.
            every: Also write the table `inside`: number of grains inside, at times this far apart [s].
            say: Called with the name of each file.
            walls: Also write the walls of all containers as STL.
            facets: Corners of round walls in STL files.
            headings: Write units into the headings of CSV files (`container.orifice [m]`).

        Returns:
            Paths of the files.

        Raises:
            ValueError: There is no such kind, or too few facets.
            NoParquet: pyarrow is not installed (of `labbook.export.study`).
            NotSpheres: Packings of rods have no such files (of `labbook.export.packing`).
            Unreadable: A packing is damaged (of `labbook.lab`).
        """
        check_facets(facets)
        if packings:
            check_spheres(self.study)
        there = self._folder(folder, "exports")
        paths = write_numbers(self, there, kind, every, headings)
        if packings:
            paths += write_packings(self, self.lab_folder, there / "packings", say, facets)
        if walls:
            paths += write_walls(self.study, there / "walls", facets)
        return paths + (write_recordings(self, there / "vtk", say) if vtk else [])

    def _folder(self, folder: Path | str | None, kind: str) -> Path:
        """The folder that was given for files, or that of this study in the lab."""
        if folder is None:
            return self.lab_folder.folder / kind / self.study.name
        return given_path(folder, f"results.{kind.removesuffix('s')}: folder")

    def __repr__(self) -> str:
        head = f"<Results of {self.study.name} on {self.backend} in {self.lab_folder.folder}: "
        lines = [
            head + ("no finished run; lab.run(study) makes them>" if not self.points else f"{len(self.runs)} runs>")
        ]
        for result in self.points:
            flow = result.flow_rate
            flow_text = "no flow rate" if flow is None else f"W = {display.with_error(flow.value, flow.error, 1e3)} g/s"
            lines.append(
                f"  {result.label or 'the only point'}: {flow_text}" + (f" ({result.remark})" * bool(result.remark))
            )
        return "\n".join(lines[:_LINES] + ([f"  and {len(lines) - _LINES} more"] if len(lines) > _LINES else []))

    def _repr_html_(self) -> str:
        if not self.points:
            return escape(repr(self))
        lines = "".join(f"<div>{escape(line)}</div>" for line in page.summary(self))
        return f"<div><b>{escape(self.study.name)}</b></div>{lines}{_html(tables.flow_table(self))}{self._pictures()}"

    def _pictures(self) -> str:
        """The first figure of all, as the notebook's own: of several series the one that shows them all, and beside it
        the map of two swept keys."""
        figures = {**(gallery.of_results(self) if len(self.series) > 1 else {})}
        for series in self.series[:1]:
            figures |= gallery.of_series(self, series)
        map_figure, pictures = figures.pop("map", None), list[str]()
        for draw in (*figures.values(), *([map_figure] if map_figure is not None else [])):
            if pictures and draw is not map_figure:
                continue
            with suppress(gallery.NothingToShow):  # the points do not determine a map
                data, size = style.for_a_screen(draw())
                source = f"data:image/png;base64,{b64encode(data).decode()}"
                pictures.append(f'<img width="{size["width"]}" src="{source}"/>')
        return f'<div style="display:flex;flex-wrap:wrap;align-items:flex-start">{"".join(pictures)}</div>'


def _html(table: tables.Table) -> str:
    """A table of a report as a notebook shows it."""
    return html.table(table.headings, table.rows, table.notes)
