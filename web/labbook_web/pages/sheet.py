"""The contact sheet of a study: pictures of its beds with their means, rows by one swept key and columns by another."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from labbook.api import Results
from labbook.export.recording import file_name
from labbook.results import display
from labbook.results.placement import placement
from labbook.results.points import FLOW_RATE, PointResult, RunResult
from labbook.results.study import StudyResults
from labbook.stats import Pooled

_DIGITS = 300
"""Smallest relative step of a number on a tile, as 1/300: further digits have no room, however small the error."""


@dataclass(frozen=True)
class Tile:
    """A point on the contact sheet.

    Attributes:
        point: Its number, from 1.
        label: Its settings.
        run: Key of the run whose picture is shown; None of a point without runs.
        remark: Remark on its results; empty without any.
        value: Its mean, or the reason why it has none.
        fraction: Position of the mean between the smallest, 0, and the largest, 1; None without a mean.
        film: The lab has a film of the run.
        recorded: The run kept frames, so that its bed can be shown in motion.
    """

    point: int
    label: str
    run: str | None
    remark: str = ""
    value: str = ""
    fraction: float | None = None
    film: bool = False
    recorded: bool = False


@dataclass(frozen=True)
class Sheet:
    """Contact sheet of a study.

    Attributes:
        row_key: Heading of the swept key of the rows; empty with a single row.
        column_key: Heading of the swept key of the columns.
        rows: Values of the row key.
        columns: Values of the column key.
        tiles: Tiles by row and column; None where the study has no point.
        fixed: Settings of further swept keys, the same on all tiles.
        tile_count: Number of points on the sheet.
        points: Number of points of the study.
        quantity: Heading of the values.
    """

    row_key: str
    column_key: str
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    tiles: tuple[tuple[Tile | None, ...], ...]
    fixed: str
    tile_count: int
    points: int
    quantity: str = ""

    @property
    def filmed(self) -> bool:
        """True if a tile has a film."""
        return any(tile is not None and tile.film for line in self.tiles for tile in line)

    @property
    def caption(self) -> str:
        """Caption of the sheet; points that are left out are counted."""
        parts = [f"Columns: {self.column_key}"] if self.column_key else []
        parts += [f"rows: {self.row_key}"] if self.row_key else []
        text = ", ".join(parts)
        if self.fixed:
            text += f"{'; ' if text else ''}at {self.fixed}"
        if self.tile_count < self.points:
            text += f"{'; ' if text else ''}{self.tile_count} of {self.points} points"
        return text


def leading(results: StudyResults) -> str:
    """Quantity on tiles and contact sheets: the flow rate, else the first one with a number; empty without any."""
    names = dict.fromkeys(name for result in results.points for name in result.pooled)
    return FLOW_RATE if FLOW_RATE in names else next(iter(names), "")


def unit_of(results: StudyResults, quantity: str) -> display.Notation:
    """Name, unit and scale of a measured quantity."""
    measured = (run.measured for result in results.points for run in result.runs)
    return display.quantity(quantity, next((numbers[quantity].unit for numbers in measured if quantity in numbers), ""))


def with_unit(pooled: Pooled, unit: display.Notation) -> str:
    """A mean with its interval and unit, such as `24.3 (23.4 to 25.2, 95 %) g/s, n = 3`."""
    interval, _, n = display.with_interval(pooled, unit.scale).rpartition(", n = ")
    return f"{interval} {unit.unit}".rstrip() + f", n = {n}"


def sheet(results: Results, running: Collection[str] = ()) -> Sheet:
    """Make the contact sheet of a study.

    Columns are by the key that takes most values, rows by the next; of further keys the first value is shown.

    Args:
        results: Results of the study.
        running: Labels of runs in progress.
    """
    points = results.study.points
    done = {result.point.index: result for result in results.points}
    layout = placement([point.at for point in points])
    make, row = _TileFactory(results, running), next(iter(layout.row), "")
    columns, rows = layout.columns, layout.rows
    tiles = tuple(tuple(make(done, layout.points.get((r, c))) for c in range(len(columns))) for r in range(len(rows)))
    return Sheet(
        display.key(row).heading if row else "",
        display.key(layout.column).heading if layout.column else "",
        tuple("–" if value is None else display.amount(row, value) for (value,) in rows) if row else (),
        tuple(display.amount(layout.column, value) for value in columns if value is not None),
        tiles,
        display.label(layout.fixed),
        sum(tile is not None for line in tiles for tile in line),
        len(points),
        make.unit.heading if make.quantity else "",
    )


def extremes(results: Results, limit: int) -> tuple[Tile, ...]:
    """Choose tiles that span the range of the means.

    Args:
        results: Results of a study.
        limit: Largest number of tiles.

    Returns:
        Tiles of points with runs, in the order of the study: the smallest and the largest mean, and others evenly
        between them by rank. Points without a mean count as smallest.
    """
    quantity, make = leading(results), _TileFactory(results)
    ranked = sorted(
        results.points, key=lambda result: result.pooled[quantity].value if quantity in result.pooled else float("-inf")
    )
    indices = _spread([result.point.index for result in ranked], limit)
    done = {result.point.index: result for result in results.points}
    return tuple(tile for index in sorted(indices) if (tile := make(done, index)) is not None)


def _spread(values: Sequence[int], limit: int) -> tuple[int, ...]:
    if len(values) <= limit:
        return tuple(values)
    step = (len(values) - 1) / max(limit - 1, 1)
    return tuple(values[round(k * step)] for k in range(limit))


class _TileFactory:
    """Factory of tiles with the leading quantity of the results."""

    def __init__(self, results: Results, labels: Collection[str] = ()):
        self._results, self._active = results, labels
        self.quantity = leading(results)
        self.unit = unit_of(results, self.quantity)
        means = [result.pooled[self.quantity].value for result in results.points if self.quantity in result.pooled]
        folder = next((run.run.folder.parent.parent for result in results.points for run in result.runs), None)
        films = folder / "films" / results.study.name if folder is not None else None
        self._films = {path.name for path in films.glob("*.webp")} if films is not None else set[str]()
        self._low, self._high = min(means, default=0.0), max(means, default=0.0)

    def __call__(self, done: dict[int, PointResult], index: int | None) -> Tile | None:
        if index is None:
            return None
        point, result = self._results.study.points[index], done.get(index)
        label = display.label(point.at) or "the only point"
        if result is None:
            running = (
                any(f" of {point.label}" in label for label in self._active) if point.label else bool(self._active)
            )
            return Tile(
                index + 1, label, None, value="running" if running else "waiting" if self._active else "not run"
            )
        pooled = result.pooled.get(self.quantity)
        value, fraction = self._without(result), None
        if pooled is not None:
            value = display.number(pooled.value, max(pooled.error, abs(pooled.value) / _DIGITS), self.unit.scale)
            fraction = (pooled.value - self._low) / (self._high - self._low) if self._high > self._low else 0.5
        run = min(result.runs, key=lambda run: (not self._filmed(result, run), not run.recorded))
        film = self._filmed(result, run)
        return Tile(index + 1, label, run.run_key, result.remark, value, fraction, film, run.recorded)

    def _filmed(self, result: PointResult, run: RunResult) -> bool:
        """True if the lab has a film of the run for this study."""
        name = f"{file_name(result.point.index, run.seed, run.discharge)}-{run.backend}-layers.webp"
        return run.recorded and name in self._films

    def _without(self, result: PointResult) -> str:
        """Reason why a point has no value, in a word; empty if no point has one."""
        if not self.quantity:
            return ""
        return next((how for how in ("clogged", "diverged") if result.outcomes[how]), "no value")
