"""Points of a sweep in rows and columns by their swept keys, as contact sheets and films of sweeps show them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

Value = float | str


@dataclass(frozen=True)
class Placement:
    """Places of points.

    Attributes:
        column: Key of the columns, the one with most values; empty where no key takes two.
        row: Keys of the rows.
        columns: Values of the columns, numbers by size [SI]; None in the only one without a key.
        rows: Values of the rows, one for each of `row`; empty in the only one without a key.
        fixed: Values of keys that have neither rows nor columns: of them the first point's is shown.
        points: Number of the point at each row and column; of several the first.
    """

    column: str
    row: tuple[str, ...]
    columns: tuple[Value | None, ...]
    rows: tuple[tuple[Value | None, ...], ...]
    fixed: Mapping[str, Value]
    points: Mapping[tuple[int, int], int]


def placement(ats: Sequence[Mapping[str, Value]], row_keys: int | None = 1) -> Placement:
    """Place points by their swept keys: columns by the key with most values, rows by the next.

    Args:
        ats: Values of the swept keys [SI] of each point.
        row_keys: Number of keys of the rows; None: all but that of the columns.
    """
    names = dict.fromkeys(name for at in ats for name in at)
    values = {name: _ordered([at[name] for at in ats if name in at]) for name in names}
    ranked = sorted((name for name in values if len(values[name]) > 1), key=lambda name: -len(values[name]))
    column, remaining = (ranked[0], ranked[1:]) if ranked else ("", [])
    row = tuple(remaining if row_keys is None else remaining[:row_keys])
    fixed = {name: ats[0][name] for name in remaining[len(row) :] if name in ats[0]}
    rest = [k for k, at in enumerate(ats) if all(at.get(name) == value for name, value in fixed.items())]
    combined = dict.fromkeys(tuple(ats[k].get(name) for name in row) for k in rest)
    rows = tuple(sorted(combined, key=lambda row_values: _rank(row, row_values, values)))
    columns: tuple[Value | None, ...] = values[column] if column else (None,)
    points = dict[tuple[int, int], int]()
    for k in rest:
        if column and column not in ats[k]:
            continue
        cell = rows.index(tuple(ats[k].get(name) for name in row)), columns.index(ats[k].get(column))
        points.setdefault(cell, k)
    return Placement(column, row, columns, rows, fixed, points)


def _rank(keys: Sequence[str], row: Sequence[Value | None], values: Mapping[str, Sequence[Value]]) -> list[int]:
    """Places of the values of a row among those of their keys, for sorting; missing ones are first."""
    return [-1 if value is None else values[key].index(value) for key, value in zip(keys, row, strict=True)]


def _ordered(values: Sequence[Value]) -> tuple[Value, ...]:
    distinct = tuple(dict.fromkeys(values))
    if any(isinstance(value, str) for value in distinct):
        return distinct
    return tuple(sorted(distinct))
