"""Files of grains of other codes: positions, velocities, sizes and kinds, in SI units.

| file | begins with | has |
|---|---|---|
| CSV (whatever is no other) | headings with units, such as `x [mm]` | `x`, `y`, `z`; also `diameter` or `radius`, `vx` to `vz`, `omegax` to `omegaz`, `kind`, and of rods `ax` to `az`, the direction of the axis |
| text dump of LAMMPS or LIGGGHTS | `ITEM: TIMESTEP` | the columns of `ITEM: ATOMS`; the last of several steps counts |
| data file of LAMMPS | a title, then a line `N atoms` | `Atoms` of `atom_style sphere`, and `Velocities` |

Files of LAMMPS and LIGGGHTS name no units: they are read as those of `units si`.
"""  # noqa: E501

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import StringIO

import numpy as np

from labbook.scene.quantities import parse

_HEADING = re.compile(r"\s*([A-Za-z_]+)\s*(?:\[([^\]]*)\]|\(([^)]*)\))?\s*")
_UNITS = {"x": "m", "y": "m", "z": "m", "diameter": "m", "radius": "m"}
_UNITS |= {f"v{axis}": "m/s" for axis in "xyz"} | {f"omega{axis}": "rad/s" for axis in "xyz"}
_UNITS |= {f"a{axis}": "" for axis in "xyz"}
_DUMPED = {"id", "type", *_UNITS} | {f"{axis}{suffix}" for axis in "xyz" for suffix in "su"}
_HEADINGS = "as of a CSV file, the headings x [mm], y [mm] and z [mm]"
_SPHERE = ("id", "type", "diameter", "density", "x", "y", "z")
_MOVING = ("id", "vx", "vy", "vz", "omegax", "omegay", "omegaz")


class GrainFileError(Exception):
    """A file of grains cannot be read; the message gives the line and the expected content."""


@dataclass(frozen=True, eq=False)
class GrainTable:
    """Grains of a file, in SI units.

    `x`, `v`, `omega`, `axis`: shape [n, 3]; `diameter`: shape [n]; `kind`: n names, or numbers from 1 as text. None
    for columns that the file lacks.
    """

    x: np.ndarray
    v: np.ndarray | None = None
    omega: np.ndarray | None = None
    diameter: np.ndarray | None = None
    kind: np.ndarray | None = None
    axis: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.x)


def read_grains(content: bytes) -> GrainTable:
    """Read a file of grains.

    Args:
        content: Content of the file.

    Returns:
        Its grains; those of LAMMPS and LIGGGHTS in the order of their ids.

    Raises:
        GrainFileError: The file has none of the formats, lacks positions, or has a column without a unit.
    """
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise GrainFileError(
            "it is not text; write a text dump (dump custom), a data file (write_data) or a CSV file"
        ) from None
    if text.lstrip().startswith("ITEM:"):
        return _dump(text)
    if re.search(r"^\s*\d+\s+atoms\s*$", text[:100_000], re.MULTILINE):
        return _data(text)
    return _csv(text)


def _csv(text: str) -> GrainTable:
    rows = _csv_rows(text)
    if not rows:
        raise GrainFileError("it is empty")
    line, headings = rows.pop(0)
    names, factors = zip(*map(_column, headings), strict=True)
    for name in (*_UNITS, "kind"):
        if names.count(name) > 1:
            raise GrainFileError(f"line {line}: two columns are called {name}")
    if not {*"xyz"} <= {*names}:
        raise GrainFileError(f"{_HEADINGS} are needed")
    for number, row in rows:
        if len(row) != len(names):
            raise GrainFileError(f"line {number}: {len(row)} entries below {len(names)} headings")
    columns = dict[str, np.ndarray]()
    for column, name in enumerate(names):
        if name in _UNITS:
            columns[name] = factors[column] * np.array([_number(number, name, row[column]) for number, row in rows])
    kind = np.array([row[names.index("kind")].strip() for _, row in rows]) if "kind" in names else None
    return _table(columns, kind, _HEADINGS)


def _csv_rows(text: str) -> list[tuple[int, list[str]]]:
    """Rows of a CSV file that are neither empty nor comments, with the numbers of their lines."""
    import csv

    reader = csv.reader((line for line in StringIO(text)), skipinitialspace=True)
    try:
        rows = [(reader.line_num, row) for row in reader]
    except csv.Error as error:
        raise GrainFileError(f"line {reader.line_num}: {error}") from None
    return [(line, row) for line, row in rows if any(map(str.strip, row)) and not row[0].startswith("#")]


def _number(line: int, name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise GrainFileError(f"line {line}: {name}: {text.strip()[:40]!r} is not a number") from None


def _column(heading: str) -> tuple[str, float]:
    """Name of a column and the SI value of its unit; for columns that are not read only the name counts."""
    match = _HEADING.fullmatch(heading)
    if match is None:
        return heading.strip(), 1.0
    name, unit = match[1].lower().replace("_", ""), (match[2] or match[3] or "").strip()
    if name not in _UNITS:
        return name, 1.0
    if _UNITS[name] and not unit:
        raise GrainFileError(f"the column {name} has no unit; write it as {name} [{_EXAMPLES[_UNITS[name]]}]")
    try:
        return name, parse(f"1 {unit}".strip(), _UNITS[name])
    except ValueError as error:
        raise GrainFileError(f"the column {name}: {error}") from None


_EXAMPLES = {"m": "mm", "m/s": "m/s", "rad/s": "rad/s"}


def _dump(text: str) -> GrainTable:
    lines = text.splitlines()
    heads = [number for number, line in enumerate(lines) if line.startswith("ITEM:")]
    atoms = [number for number in heads if lines[number].startswith("ITEM: ATOMS")]
    if not atoms:
        raise GrainFileError("the dump has no ITEM: ATOMS")
    start = atoms[-1]
    end = next((number for number in heads if number > start), len(lines))
    _check_units(next(iter(_item(lines, heads, start, "ITEM: UNITS")), ""))
    names = lines[start].split()[2:]
    column_of = {name: column for column, name in enumerate(names) if name in _DUMPED}  # others may be text
    body = [line for line in lines[start + 1 : end] if line.strip()]
    rows = _numbers(body, start + 2, tuple(column_of.values()), None)
    columns = dict(zip(column_of, rows.T, strict=True))
    count_text = "".join(_item(lines, heads, start, "ITEM: NUMBER OF ATOMS")).strip()
    if count_text and str(len(rows)) != count_text:
        raise GrainFileError(f"line {start + 1}: {len(rows)} of {count_text[:20]} atoms follow; the dump is cut off")
    for axis, bounds in zip("xyz", _item(lines, heads, start, "ITEM: BOX BOUNDS"), strict=False):
        low, high = _box(bounds)
        if axis not in columns and f"{axis}s" in columns:
            columns[axis] = low + (high - low) * columns[f"{axis}s"]
        elif axis not in columns and f"{axis}u" in columns:
            columns[axis] = columns[f"{axis}u"]
    if any(name.startswith(("quat", "shape")) for name in names):
        raise GrainFileError(_RODS)
    return _sorted(columns, "the columns x, y and z (or xs, ys, zs) in ITEM: ATOMS")


def _box(bounds: str) -> tuple[float, float]:
    """Parse the ends of a box [m] along an axis."""
    ends = bounds.split()
    try:
        low, high = map(float, ends)
    except ValueError:
        raise GrainFileError(
            f"ITEM: BOX BOUNDS: {bounds.strip()[:40]!r} are not two numbers; the box must be orthogonal"
        ) from None
    return low, high


def _check_units(units: str) -> None:
    """Raise GrainFileError if a file of LAMMPS names other units than SI."""
    if units.strip() not in ("", "si"):
        raise GrainFileError(
            f"it is in units {units.strip()}, and files of LAMMPS are read in units si; write a CSV file"
        )


def _item(lines: Sequence[str], heads: Sequence[int], before: int, title: str) -> list[str]:
    """Return the lines of the last item titled `title` that begins before line `before`; empty if there is none."""
    start = max((number for number in heads if number < before and lines[number].startswith(title)), default=None)
    if start is None:
        return []
    return list(lines[start + 1 : min(number for number in heads if number > start)])


_RODS = (
    "it has orientations of ellipsoids, which are not spherocylinders; write a CSV file with the columns ax, ay and "
    "az, the direction of each rod's axis"
)


def _data(text: str) -> GrainTable:
    lines = text.splitlines()
    if (units := re.search(r"\bunits = (\w+)", lines[0])) is not None:
        _check_units(units[1])
    title = re.compile(r"\s*(Atoms|Velocities|Ellipsoids|[A-Z][A-Za-z ]*)\s*(?:#\s*(\S+))?\s*")
    heads = {match[1].strip(): (n, match[2]) for n, line in enumerate(lines) if n and (match := title.fullmatch(line))}
    if "Ellipsoids" in heads:
        raise GrainFileError(_RODS)
    if "Atoms" not in heads:
        raise GrainFileError("the data file has no section Atoms")
    style = heads["Atoms"][1]
    if style not in (None, "sphere"):
        raise GrainFileError(f"line {heads['Atoms'][0] + 1}: atom style {style}; only sphere is read")
    starts = sorted(number for number, _ in heads.values())

    def section(name: str, columns: Sequence[str]) -> dict[str, np.ndarray]:
        start = heads[name][0]
        end = next((number for number in starts if number > start), len(lines))
        body = [line for line in lines[start + 1 : end] if line.strip()]
        rows = _numbers(body, start + 2, range(len(columns)), None)
        order = np.argsort(rows[:, 0], kind="stable")
        return dict(zip(columns, rows[order].T, strict=True))

    columns = section("Atoms", _SPHERE)
    if "Velocities" in heads:
        moving = section("Velocities", _MOVING)
        if not np.array_equal(moving["id"], columns["id"]):
            raise GrainFileError("the sections Atoms and Velocities have different ids")
        columns |= moving
    return _sorted(columns, "a section Atoms of atom_style sphere")


def _numbers(rows: Sequence[str], line: int, columns: Sequence[int], delimiter: str | None) -> np.ndarray:
    """Parse some columns of rows as numbers, shape [n, columns]. `line`: number of the first row, for messages."""
    if not rows:
        return np.empty((0, len(columns)))
    try:
        return np.loadtxt(
            StringIO("\n".join(rows)), ndmin=2, usecols=tuple(columns), delimiter=delimiter, comments=None
        )
    except (ValueError, IndexError) as error:
        raise GrainFileError(f"from line {line} on: {error}") from None


def _sorted(columns: Mapping[str, np.ndarray], needed: str) -> GrainTable:
    """Build the grains of LAMMPS or LIGGGHTS in the order of their ids, with their types as kinds."""
    if "id" in columns:
        order = np.argsort(columns["id"], kind="stable")
        columns = {name: column[order] for name, column in columns.items()}
    kind = columns.get("type")
    if kind is not None and not (np.isfinite(kind) & (kind == np.round(kind)) & (np.abs(kind) < 1e9)).all():
        raise GrainFileError("types are not whole numbers")
    return _table(columns, None if kind is None else kind.astype(int).astype(str), needed)


def _table(columns: Mapping[str, np.ndarray], kind: np.ndarray | None, needed: str) -> GrainTable:
    for name in ("v", "omega", "a"):
        present = [axis for axis in "xyz" if f"{name}{axis}" in columns]
        if 0 < len(present) < 3:
            raise GrainFileError(f"of {name}x, {name}y and {name}z it has {' and '.join(present)} alone")
    if any(axis not in columns for axis in "xyz"):
        raise GrainFileError(f"{needed} are needed")
    finite = {name: column for name, column in columns.items() if name in _UNITS}
    for name, column in finite.items():
        if not np.isfinite(column).all():
            raise GrainFileError(f"grain {int(np.argmin(np.isfinite(column))) + 1}: {name} is not finite")

    def vector(name: str) -> np.ndarray | None:
        return np.stack([columns[f"{name}{axis}"] for axis in "xyz"], axis=1) if f"{name}x" in columns else None

    diameter = columns.get("diameter")
    if diameter is None and "radius" in columns:
        diameter = 2 * columns["radius"]
    if diameter is not None and not (diameter > 0).all():
        raise GrainFileError(f"grain {int(np.argmin(diameter > 0)) + 1}: its diameter is not above 0")
    x = vector("")
    assert x is not None
    return GrainTable(x, vector("v"), vector("omega"), diameter, kind, vector("a"))
