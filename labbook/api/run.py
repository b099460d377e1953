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

if TYPE_CHECKING:
    import pandas as pd

_ORDER = ("id", "i", "j", "wall", "step", *UNITS)
"""Of the columns of a table."""


@dataclass(frozen=True, eq=False, repr=False)
class Run(RunResult):
    """One run: its outcome, its measurements, and its recorded tables."""

    study: Study
    """The study whose result it is."""
    place: LabFolder
    """The folder of the lab that has it."""

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
        """The picture (PNG) of its bed in the middle of the window, or at its end if that came before; None without
        one."""
        return picture(self.folder)

    @property
    def tables(self) -> tuple[str, ...]:
        """Names of the recorded tables."""
        return tuple(self.run.data().tables)

    def frame(self, table: str = "crossing") -> "pd.DataFrame":
        """A recorded table: `crossing`, one row for every grain that left, or that of another probe (columns:
        `labbook.backend.probes`, and those of `RunData.rows` for unlike grains). SI, units in `attrs`. Raises
        LookupError; LabError if it cannot be read."""
        import pandas as pd

        data = self.run.data()
        if table not in data.tables:
            raise LookupError(f"this run has no table {table}; use one of: {', '.join(data.tables) or 'none'}")
        columns = sorted(
            data.rows(table).items(), key=lambda column: _ORDER.index(column[0]) if column[0] in _ORDER else len(_ORDER)
        )
        made = pd.DataFrame({name: column for name, column in columns if name != "member"})
        units = {name: UNITS[name] for name in made if name in UNITS}
        made.attrs = {"study": self.study.name, "run_key": self.run_key, "units": units}
        return made

    def trajectories(self) -> Trajectories:
        """Trajectories of the grains, as arrays. Raises NotRecorded (of `labbook.export.frames`)."""
        found = Trajectories.of(self.run.data())
        if found is None:
            remedy = "add record={'every': '10 ms', 'replicates': ...} to the study and run it"
            raise NotRecorded(f"{self} kept no frames: {remedy}")
        return found

    def recording(self) -> Path:
        """The file (.rrd) for the rerun viewer, written if it does not exist. Raises NotRecorded or ViewerMissing."""
        return of_run(self.folder, self.place.folder, self.study.name, self.point)

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
            The file.

        Raises:
            NotRecorded: The run kept no frames.
            NoColouring: Its grains cannot be coloured so.
            NoFilm: The format is unknown or needs an encoder that is not installed.
        """
        name, point = self.study.name, self.point
        record = RunRecord.read(self.folder)
        out = (
            path_of(self.place.folder / "films", record, name, point, f"-{colour}.webp") if path is None else Path(path)
        )
        return film(shot_of_run(self.folder, colour, name, point), out, seconds=seconds, size=size).path

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
        shown = f'<div style="display:flex;flex-wrap:wrap;gap:1.5em">{bed}{numbers}</div>'
        return html.titled(f"{self.study.name}, {label}, {self.repeat}", shown)

    def __repr__(self) -> str:
        recorded = ", recorded" if self.recorded else ""
        return f"<Run of {self.study.name}, {self.point.label}, {self.repeat}: {self.outcome}{recorded}>"


def _quantities(measured: Mapping[str, Measured]) -> str:
    """The numbers of a run, as its page shows them."""
    rows = []
    for name, one in measured.items():
        shown = display.quantity(name, one.unit)
        value = display.with_error(one.value, one.error, shown.scale) if math.isfinite(one.value) else "–"
        rows.append((shown.name, value, shown.unit, one.note))
    return html.table(("quantity", "value ± error", "unit", "note"), rows)
