"""From `sweep` and `points` to the values of each point.

Every entry of `points`, with every entry of `zip`, with every combination of the grid: the last grid key varies
fastest. What a sweep sets replaces what the study states elsewhere.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain, product
from typing import Any

from labbook.scene.quantities import DIGITS, leading_number, whole
from labbook.study.keys import find, nearest
from labbook.study.problems import Problem, quote
from labbook.study.source import Location, StudyText, dotted

MAX_POINTS = 100_000
BYTES = 8e3
"""Memory that a plan takes for a point with one run, as measured."""

_LIST = re.compile(r"\s*\[(.*)\]\s*(.*?)\s*", re.DOTALL)


@dataclass(frozen=True, eq=False)
class Value:
    """One value of one swept key and its line. Points have it in common, and it equals no other.

    raw: the value, its number rounded to 12 digits, so that 0.1 + 0.2 is 0.3. said: how labels have it.
    """

    raw: str | int | float | bool
    text: str
    line: int


Assignment = Mapping[str, Value]
"""Dotted key -> value: what one point sets."""


class Sweep:
    """The assignments that a study's `sweep` and `points` ask for, and what is wrong with them."""

    def __init__(self, source: StudyText):
        self._source = source
        self.problems: list[Problem] = []
        self.wrong: set[str] = set()
        """Keys that are not swept although the study says so, because of a problem."""
        grid, zipped = self._sweep()
        listed = self._points()
        self._no_key_twice(grid, zipped, listed)
        self._axes: list[list[Assignment]] = [
            listed or [{}],
            zipped or [{}],
            *([{key: value} for value in values] for key, values in grid.items()),
        ]
        if self.size > MAX_POINTS:
            location = ("sweep",) if "sweep" in source.data else ("points",)
            memory = f"a plan of them takes about {quote(f'{self.size * BYTES / 1e9:.3g}')} GB of memory"
            message = f"{quote(str(self.size))} points are more than {MAX_POINTS}; {memory}"
            self._problem(location, message, "sweep fewer values, or split the study")

    @property
    def size(self) -> int:
        """Number of points."""
        return math.prod(map(len, self._axes))

    def __iter__(self) -> Iterator[Assignment]:
        """The assignments, point by point."""
        for parts in product(*self._axes):
            yield dict(chain.from_iterable(part.items() for part in parts))

    def _sweep(self) -> tuple[dict[str, list[Value]], list[Assignment]]:
        if "sweep" not in self._source.data or not self._filled_mapping(self._source.data["sweep"], ("sweep",)):
            return {}, []
        raw = _mapping(self._source.data["sweep"])
        swept = [key for key in raw if key != "zip" and self._may_vary(key, ("sweep", key))]
        grid = {key: values for key in swept if (values := self._values(raw[key], ("sweep", key)))}
        zipped = self._zip(raw["zip"]) if "zip" in raw else []
        return grid, zipped

    def _zip(self, raw: Any) -> list[Assignment]:
        location = ("sweep", "zip")
        if not self._filled_mapping(raw, location):
            return []
        swept = [key for key in raw if self._may_vary(key, (*location, key))]
        columns = {key: self._values(raw[key], (*location, key), distinct=False) for key in swept}
        columns = {key: values for key, values in columns.items() if values}
        lengths = {key: len(values) for key, values in columns.items()}
        if len(set(lengths.values())) > 1:
            counts = ", ".join(f"{quote(key)}: {n}" for key, n in lengths.items())
            self._problem(location, f"zipped lists differ in length ({counts})", "give each the same number of values")
            self.wrong.update(columns)
            return []
        return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]

    def _points(self) -> list[Assignment]:
        if "points" not in self._source.data:
            return []
        raw = self._source.data["points"]
        if not isinstance(raw, list) or not raw:
            message = "a list of points is needed" if not isinstance(raw, list) else "the list of points is empty"
            self._problem(("points",), message, "write one `- {container.orifice: 30 mm}` for each point")
            return []
        listed: list[Assignment] = []
        for index, point in enumerate(raw):
            location = ("points", index)
            if not self._filled_mapping(point, location):
                continue
            keys = [key for key in point if self._may_vary(key, (*location, key))]
            assignment = {
                key: value for key in keys if (value := self._value(point[key], (*location, key))) is not None
            }
            if assignment:
                listed.append(assignment)
        return listed

    def _values(self, raw: Any, location: Location, distinct: bool = True) -> list[Value]:
        """The values of one key: a YAML list, or `[15, 30] deg` in quotes."""
        line = self._source.line(location)
        match = _LIST.fullmatch(raw) if isinstance(raw, str) else None
        values: list[Value | None]
        if match is not None:
            body, unit = match.groups()
            items = [item.strip() for item in body.split(",")] if body.strip() else []
            values = [_value(_scalar(f"{item} {unit}".strip()), location, line) for item in items]
        elif isinstance(raw, list):
            values = [self._value(item, (*location, index)) for index, item in enumerate(raw)]
        else:
            self._problem(location, "a sweep needs a list of values", 'write a list, or "[15, 30] deg" in quotes')
            return []
        if not values:
            self._problem(
                location, "the list is empty: nothing is swept", "list at least one value, or leave the key out"
            )
        distinct_values: dict[str, Value] = {}
        accepted: list[Value] = []
        for value in filter(None, values):
            if distinct and repr(value.raw) in distinct_values:
                message = f"{value.text} is listed twice"
                self.problems.append(self._at(value.line, location, message, "list each value once"))
                continue
            distinct_values[repr(value.raw)] = value
            accepted.append(value)
        return accepted

    def _value(self, raw: Any, location: Location) -> Value | None:
        if isinstance(raw, str | int | float | bool):
            return _value(raw, location, self._source.line(location))
        self._problem(location, "a single value is needed here", "write a quantity, a number or a word")
        return None

    def _may_vary(self, key: str, location: Location) -> bool:
        matches = find(key)
        if not matches:
            inside: Any = self._source.data
            for part in location:
                inside = inside[part]
            dotted_keys = (
                [f"{key}.{name}" for name in inside if find(f"{key}.{name}")] if isinstance(inside, dict) else []
            )
            remedy = f"write dotted keys, such as {dotted_keys[0]}: ..." if dotted_keys else nearest(key)
            self._problem(location, "there is no such key", remedy)
        elif not any(known.sweepable for known in matches):
            self._problem(location, "this key cannot vary within a study", "state it once, or write two studies")
        else:
            return True
        return False

    def _no_key_twice(self, grid: Mapping[str, Any], zipped: list[Assignment], listed: list[Assignment]) -> None:
        in_zip, in_points = set(chain.from_iterable(zipped)), set(chain.from_iterable(listed))
        for key in sorted({*grid} & in_zip):
            self._problem(("sweep", key), "is swept twice: here and in zip", "keep one of the two")
        for key in sorted(({*grid} | in_zip) & in_points):
            location = ("sweep", key) if key in grid else ("sweep", "zip", key)
            self._problem(location, "is swept here and listed in points", "keep one of the two")

    def _filled_mapping(self, raw: Any, location: Location) -> bool:
        if isinstance(raw, dict) and raw:
            return True
        message = "is empty: nothing is swept" if raw in ({}, None, []) else "a mapping of keys is needed"
        values = "30 mm" if location[0] == "points" else "[20 mm, 30 mm]"
        self._problem(location, message, f"write for example `container.orifice: {values}`, or leave it out")
        return False

    def _problem(self, location: Location, message: str, remedy: str) -> None:
        self.problems.append(self._at(self._source.line(location), location, message, remedy))

    def _at(self, line: int, location: Location, message: str, remedy: str) -> Problem:
        self.wrong.update(part for part in location if isinstance(part, str))
        return Problem(self._source.path, line, quote(dotted(location)), message, remedy)


def _value(raw: str | int | float | bool, location: Location, line: int) -> Value:
    """A value as it is written at `location`, below its key."""
    key = next(part for part in reversed(location) if isinstance(part, str))
    if any(known.type == "integer" for known in find(key)):
        raw = whole(raw)
    rounded = _rounded(raw)
    ratio = isinstance(raw, str) and "/" in raw
    return Value(rounded, quote(raw if ratio else rounded), line)


def _rounded(raw: str | int | float | bool) -> str | int | float | bool:
    """A number, or that of a quantity, with 12 digits at most; all else as it stands."""
    if isinstance(raw, float):
        return float(f"{raw:.{DIGITS}g}")
    number = leading_number(raw) if isinstance(raw, str) else None
    if number is None or not isinstance(raw, str):
        return raw
    text, value = number
    short = f"{value:.{DIGITS}g}"
    return raw if float(short) == value else short + raw.strip()[len(text) :]


def _mapping(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _scalar(text: str) -> str | int | float | bool:
    """Value of a plain YAML scalar: a number, else the text."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
