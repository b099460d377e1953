"""Measurements in a CSV file, as entries that `reference` takes.

A line is a measured value. Its columns: keys of the study (`container.orifice [mm]`), `quantity` (left out:
`flow_rate`), `value [g/s]`, `error [g/s]` and `says`. A unit in a heading holds for all cells below that have none.
"""

import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from labbook.scene.quantities import leading_number
from labbook.study.keys import find, nearest
from labbook.study.problems import quote

LARGEST = 2_000_000
"""Size of a file [bytes]."""
LIMIT = 2000
"""Measured values in a file."""
COLUMNS = ("quantity", "value", "error", "says")
"""Columns that are no keys of a study."""
_QUANTITY = "flow_rate"
_HEADING = re.compile(r"\s*([^\[\]]*?)\s*(?:\[\s*([^\[\]]*?)\s*\])?\s*")


class NotAMeasurement(ValueError):
    """A file of measurements is wrong at a line.

    Attributes:
        line: Its number.
        column: Heading of the column; empty for the line as a whole.
        remedy: How to put it right.
    """

    def __init__(self, line: int, column: str, message: str, remedy: str):
        super().__init__(message)
        self.line, self.column, self.remedy = line, column, remedy


@dataclass(frozen=True)
class MeasuredValue:
    """A line of a file: its number, the quantity, and `at`, `value` ... as a reference in a study has them."""

    line: int
    quantity: str
    entry: dict[str, Any]


def measured_values(content: bytes) -> Iterator[MeasuredValue]:
    """Read the lines of a file of measurements; empty lines and those that begin with # are left out.

    Raises:
        NotAMeasurement: A heading or a line is wrong.
    """
    if len(content) > LARGEST:
        raise NotAMeasurement(1, "", f"the file is larger than {LARGEST / 1e6:g} MB", "split the study or the file")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise NotAMeasurement(line, "", "not text in UTF-8", "save the file as UTF-8") from None
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if not _is_empty(line)]
    if not lines:
        raise NotAMeasurement(1, "", "the file has no line with headings", _EXAMPLE)
    numbers = [number for number, _ in lines]
    try:
        (head, *rows) = csv.reader((line for _, line in lines), strict=True)
    except (csv.Error, ValueError) as error:
        raise NotAMeasurement(numbers[0], "", f"not a CSV file: {error}", "write one line for each value") from None
    if len(rows) + 1 != len(numbers):
        raise NotAMeasurement(numbers[0], "", "a quoted cell goes on over several lines", "write it on one line")
    if len(rows) > LIMIT:
        raise NotAMeasurement(numbers[LIMIT + 1], "", f"more than {LIMIT} values", "split the study or the file")
    if not rows:
        raise NotAMeasurement(numbers[0], "", "there are headings, and no values", "write one line for each value")
    columns = list(_columns(numbers[0], head))
    for number, cells in zip(numbers[1:], rows, strict=True):
        if len(cells) != len(columns):
            message = f"{len(cells)} cells stand below {len(columns)} headings"
            raise NotAMeasurement(number, "", message, "separate cells by commas; write decimals with a point")
        yield _value(number, dict(zip(columns, map(str.strip, cells), strict=True)))


def _columns(line: int, head: list[str]) -> Iterator[tuple[str, str]]:
    """Names and units of the columns."""
    names = list[str]()
    for heading in head:
        match = _HEADING.fullmatch(heading)
        if match is None:
            remedy = "write a name with its unit in brackets, such as container.orifice [mm]"
            raise NotAMeasurement(line, quote(heading), "this is no heading", remedy)
        name, unit = match[1], match[2] or ""
        if name not in COLUMNS and not any(key.sweepable for key in find(name)):
            remedy = f"{nearest(name)}; other columns are {', '.join(COLUMNS)}"
            raise NotAMeasurement(line, quote(heading), "this is neither a key of a study nor a column", remedy)
        if name in names:
            raise NotAMeasurement(line, quote(heading), "a second column of this name", "keep one of the two")
        names.append(name)
        yield name, unit
    if "value" not in names:
        raise NotAMeasurement(line, "", "the column `value` is missing", _EXAMPLE)


def _value(line: int, cells: dict[tuple[str, str], str]) -> MeasuredValue:
    at, entry = dict[str, Any](), dict[str, Any]()
    for (name, unit), cell in cells.items():
        if name in COLUMNS:
            entry |= {name: cell if name in ("quantity", "says") else _with_unit(cell, unit)} if cell else {}
        elif cell:
            at[name] = _with_unit(cell, unit)
    return MeasuredValue(line, entry.pop("quantity", _QUANTITY), {"at": at, **entry})


def _with_unit(cell: str, unit: str) -> str:
    """A cell as a study writes it: with the unit of its heading, if it is a number without one."""
    number = leading_number(cell)
    return f"{cell} {unit}".strip() if number is not None and number[0] == cell else cell


def _is_empty(line: str) -> bool:
    return not line.strip(" \t,") or line.lstrip().startswith("#")


_EXAMPLE = "begin with a line such as container.orifice [mm],value [g/s],error [g/s]"
