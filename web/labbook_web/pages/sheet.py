"""The contact sheet of a study: pictures of its beds, rows by one swept key and columns by another."""

from collections.abc import Sequence
from dataclasses import dataclass

from labbook.api import Results
from labbook.results import display
from labbook.results.points import PointResult

Value = float | str


@dataclass(frozen=True)
class Tile:
    """A point on the sheet, and the run whose picture is shown; None of a point without runs."""

    point: int
    """Counted from 1."""
    label: str
    run: str | None
    remark: str = ""


@dataclass(frozen=True)
class Sheet:
    """Tiles by row and column; None where no point is. `fixed`: what all tiles have in common although it is swept;
    `shown`, `points`: how many points of the study are on it, and how many it has."""

    row_key: str
    column_key: str
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    tiles: tuple[tuple[Tile | None, ...], ...]
    fixed: str
    shown: int
    points: int

    @property
    def said(self) -> str:
        """What the sheet shows, in words; points that are left out are counted."""
        parts = [f"Columns: {self.column_key}"] if self.column_key else []
        parts += [f"rows: {self.row_key}"] if self.row_key else []
        text = ", ".join(parts)
        if self.fixed:
            text += f"{'; ' if text else ''}at {self.fixed}"
        if self.shown < self.points:
            text += f"{'; ' if text else ''}{self.shown} of {self.points} points"
        return text


def sheet(results: Results, most_rows: int = 1000, most_columns: int = 1000) -> Sheet:
    """The contact sheet of all points of a study; of more rows or columns than wanted, some that are evenly spread.

    Columns are by the key that takes most values, rows by the next; of keys beyond these the first value is shown.
    """
    points = results.study.points
    done = {result.point.index: result for result in results.points}
    ats = {point.index: dict(point.at) for point in points}
    names = dict.fromkeys(name for at in ats.values() for name in at)
    values = {name: _values([at[name] for at in ats.values() if name in at]) for name in names}
    ranked = sorted((name for name in values if len(values[name]) > 1), key=lambda name: -len(values[name]))
    column, row = (*ranked, "", "")[:2]
    first = points[0].at
    fixed = {name: first[name] for name in ranked[2:] if name in first}
    columns = _spread(values.get(column, ()), most_columns)
    rows = _spread(values.get(row, ()), most_rows)
    places = {
        (at.get(row), at.get(column)): index
        for index, at in reversed(ats.items())
        if all(at.get(name) == value for name, value in fixed.items())
    }
    tiles = tuple(tuple(_tile(results, done, places.get((r, c))) for c in columns or (None,)) for r in rows or (None,))
    return Sheet(
        display.key(row).name if row else "",
        display.key(column).name if column else "",
        tuple(_said(row, value) for value in rows),
        tuple(_said(column, value) for value in columns),
        tiles,
        display.label(fixed),
        sum(tile is not None for line in tiles for tile in line),
        len(points),
    )


def _values(found: Sequence[Value]) -> tuple[Value, ...]:
    distinct = tuple(dict.fromkeys(found))
    if any(isinstance(value, str) for value in distinct):
        return distinct
    return tuple(sorted(distinct))


def _spread(values: Sequence[Value], most: int) -> tuple[Value, ...]:
    if len(values) <= most:
        return tuple(values)
    step = (len(values) - 1) / max(most - 1, 1)
    return tuple(values[round(k * step)] for k in range(most))


def _said(name: str, value: Value) -> str:
    return f"{display.amount(name, value)} {display.key(name).unit}".rstrip()


def _tile(results: Results, done: dict[int, PointResult], index: int | None) -> Tile | None:
    if index is None:
        return None
    point, result = results.study.points[index], done.get(index)
    label = display.label(point.at) or "the only point"
    if result is None:
        return Tile(index + 1, label, None)
    return Tile(index + 1, label, result.runs[0].run_key, result.remark)
