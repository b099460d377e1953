"""One run of a study, with its measurements and its recorded tables."""

import math
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from labbook import html
from labbook.backend.probes import UNITS
from labbook.export.film import SECONDS, SIZE, film, shot_of_run
from labbook.export.frames import NotRecorded
from labbook.export.recording import middle_of, of_run, path_of
from labbook.export.viewer import show
from labbook.lab import LabFolder, RunRecord
from labbook.lab.runs import picture
from labbook.measure.trajectories import Trajectories
from labbook.results import display
from labbook.results.points import RunResult
from labbook.stats import Measured
from labbook.study import Point, Study
from labbook.warning import RenamedAttribute

if TYPE_CHECKING:
    import pandas as pd

_ORDER = ("id", "i", "j", "wall", "step", *UNITS)
"""Of the columns of a table."""


class FilmPath(type(Path())):
    """Path of a film, which a notebook plays."""

    def _repr_html_(self) -> str:
        if (size := self.stat().st_size) > _LARGEST_FILM:
            return html.lines([f"{self}: {size / 1e6:.3g} MB, too large for a notebook"])
        kind = self.suffix.lower().removeprefix(".")
        source = f"data:{'video' if kind == 'mp4' else 'image'}/{kind};base64,{b64encode(self.read_bytes()).decode()}"
        if kind == "mp4":
            return f'<video controls loop style="max-width:100%" src="{source}"></video>'
        return f'<img alt="Film" style="max-width:100%" src="{source}"/>'


_LARGEST_FILM = 20e6  # bytes: a notebook keeps what it shows


@dataclass(frozen=True, eq=False, repr=False)
class Run(RunResult):
    """A finished run: its outcome, its measurements, and its recorded tables.

    Args:
        study: Study whose result it is.
        lab_folder: Folder of the lab that has it.
    """

    study: Study
    lab_folder: LabFolder
    place = RenamedAttribute("lab_folder")

    @property
    def point(self) -> Point:
        """The point of the study."""
        return self.run.point

    @property
    def folder(self) -> Path:
        """Folder of the run."""
        return self.run.folder

    @property
    def picture(self) -> Path | None:
        """Path of the picture (PNG) of its bed in the middle of the window, or at its end if that came before; None
        without one."""
        return picture(self.folder)

    @property
    def tables(self) -> tuple[str, ...]:
        """Names of the recorded tables."""
        return tuple(self.run.data().tables)

    def frame(self, table: str = "crossing") -> "pd.DataFrame":
        """Read a recorded table as a data frame.

        Args:
            table: `crossing`, with one row for every discharged grain, or the table of another probe
                (`labbook.backend.probes`, and `RunData.rows` for grains that differ).

        Returns:
            The rows in SI, with units in `attrs`.

        Raises:
            LookupError: The run has no such table.
            LabError: The table cannot be read.
        """
        import pandas as pd

        data = self.run.data()
        if table not in data.tables:
            raise LookupError(f"this run has no table {table}; use one of: {', '.join(data.tables) or 'none'}")
        columns = sorted(
            data.rows(table).items(), key=lambda column: _ORDER.index(column[0]) if column[0] in _ORDER else len(_ORDER)
        )
        frame = pd.DataFrame({name: column for name, column in columns if name != "member"})
        units = {name: UNITS[name] for name in frame if name in UNITS}
        frame.attrs = {"study": self.study.name, "run_key": self.run_key, "units": units}
        return frame

    def trajectories(self) -> Trajectories:
        """Read the trajectories of the grains as arrays.

        Returns:
            Positions, velocities and orientations of every frame [SI].

        Raises:
            NotRecorded: The run kept no frames (of `labbook.export.frames`).
        """
        trajectories = Trajectories.of(self.run.data())
        if trajectories is None:
            remedy = "add record={'every': '10 ms', 'replicates': ...} to the study and run it"
            raise NotRecorded(f"{self} kept no frames: {remedy}")
        return trajectories

    def recording(self) -> Path:
        """Path of the recording (.rrd) for the rerun viewer, which is written if it does not exist.

        Raises:
            NotRecorded: The run kept no frames.
            ViewerMissing: rerun is not installed.
        """
        return of_run(self.folder, self.lab_folder.folder, self.study.name, self.point)

    def film(
        self, path: Path | str | None = None, *, colour: str = "layers", seconds: float = SECONDS, size: int = SIZE
    ) -> Path:
        """Write a film of the run.

        Args:
            path: File to write, with the ending .webp, .gif or .mp4 (needs ffmpeg); None: a WebP in LAB/films.
            colour: Property that grains are coloured by: layers, speed, force, species or orientation.
            seconds: Duration of the film.
            size: Pixels of the longer side of the bed.

        Returns:
            The file, which a notebook plays.

        Raises:
            NotRecorded: The run kept no frames.
            NoColouring: Its grains cannot be coloured so.
            NoFilm: The format is unknown or needs an encoder that is not installed.
        """
        name, point = self.study.name, self.point
        record = RunRecord.read(self.folder)
        out = (
            path_of(self.lab_folder.folder / "films", record, name, point, f"-{colour}.webp")
            if path is None
            else Path(path)
        )
        return FilmPath(film(shot_of_run(self.folder, colour, name, point), out, seconds=seconds, size=size).path)

    def view(self) -> None:
        """Open the rerun viewer and wait until it is closed. Raises NotRecorded, ViewerMissing or ViewerFailed."""
        show([self.recording()], middle_of([self.folder]))

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
        numbers += f"<div>{self.trace._repr_html_()}</div>" if self.trace is not None else ""
        content = f'<div style="display:flex;flex-wrap:wrap;gap:1.5em">{bed}{numbers}</div>'
        return html.titled(f"{self.study.name}, {label}, {self.repeat}", content)

    def __repr__(self) -> str:
        recorded = ", recorded" if self.recorded else ""
        return f"<Run of {self.study.name}, {self.point.label}, {self.repeat}: {self.outcome}{recorded}>"


def _quantities(measured: Mapping[str, Measured]) -> str:
    """The numbers of a run, as its page shows them."""
    rows = []
    for name, number in measured.items():
        display_of = display.quantity(name, number.unit)
        value = display.with_error(number.value, number.error, display_of.scale) if math.isfinite(number.value) else "–"
        rows.append((display_of.name, value, display_of.unit, number.note))
    return html.table(("quantity", "value ± error", "unit", "note"), rows)
