"""Grains at the positions of a file, checked against their scene."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from labbook.filling.grain_files import GrainFileError, GrainTable, read_grains
from labbook.filling.room import PlacingError, Room
from labbook.scene import Clumps, Container, Grains, Scene, Spheres
from labbook.scene.attached import AttachedError, content, name
from labbook.scene.model import Fault, once
from labbook.scene.orientation import axes, distances, turned_to
from labbook.scene.packing import Packing
from labbook.scene.quantities import value_range
from labbook.scene.sizes import Equal

VERSION = 1
MOST_OVERLAP = 0.05
"""Largest overlap of grains of a file with each other and with walls, in diameters of the smaller grain."""
_ROUNDED = 1e-4
"""Relative difference of a diameter that the digits of a file may cause."""
_SAMPLED, _SCATTER = 0.02, 3.0
"""Relative difference of the mean volume of grains that may be by chance: a constant, and three standard errors if the
standard deviation of the volume equals its mean."""


@dataclass(frozen=True)
class GrainFile:
    """A file of grains beside a study."""

    sha256: str
    """Hash of its content (`labbook.scene.attached`)."""
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Displacement [m] of all grains of the file."""


def start_from(closed: Scene, file: GrainFile) -> Packing:
    """Place the grains of a closed scene at the positions of a file, with its velocities, or at rest.

    Raises:
        PlacingError: The first of `faults`.
    """
    packing = _start(closed.grains, closed.container, file)
    if isinstance(packing, Fault):
        raise PlacingError(f"{packing.key}: {packing.reason}; {packing.remedy}")
    return packing


def faults(closed: Scene, file: GrainFile) -> Iterator[Fault]:
    """Yield the reason why grains of a closed scene cannot start from a file, if there is one.

    The file cannot be read, has another number of grains, or other sizes or kinds; or a grain lies outside the
    container, or overlaps too much.
    """
    packing = _start(closed.grains, closed.container, file)
    if isinstance(packing, Fault):
        yield packing


@once(4)
def _start(grains: Grains, container: Container, file: GrainFile) -> Packing | Fault:
    """Build the packing, or the first fault: a study is checked before its runs begin."""
    here = name(file.sha256)
    try:
        table = _table(file.sha256)
        kind = _kinds(grains, table, here)
        fault = next(_faults(grains, table, kind, here), None)
        if fault is None:
            packing = _packing(grains, table, kind, np.array(file.shift))
            fault = next(_misplaced(grains, container, packing, here), None)
            return packing if fault is None else fault
    except GrainFileError as error:
        return Fault("fill.file", f"{here}: {error}", "use a file as in docs/studies.md")
    except AttachedError as error:
        return Fault("fill.file", error.reason, error.remedy)
    except PlacingError as error:
        return Fault("container", f"{here}: {error}", "use a container that grains can lie in")
    return fault


@once(4)
def _table(sha256: str) -> GrainTable:
    return read_grains(content(sha256))


def _kinds(grains: Grains, table: GrainTable, here: str) -> np.ndarray | Fault:
    """Indices into `grains.kinds`, shape [n]; or the Fault of a file that does not tell them."""
    names = [kind.name for kind in grains.kinds]
    if not names:
        return np.zeros(len(table), np.int64)
    if table.kind is None:
        reason = f"{here} does not tell which grains are {' or '.join(names)}"
        return Fault("grains.kinds", reason, "add a column kind (CSV) or type, or leave kinds out")
    index_of_kind = {label: index for index, kind in enumerate(names) for label in (kind, str(index + 1))}
    if strange := sorted({*table.kind.tolist()} - {*index_of_kind}):
        listed = ", ".join(f"{index + 1} or {kind}" for index, kind in enumerate(names))
        return Fault("grains.kinds", f"{here} has grains of a kind {strange[0]}", f"use {listed}")
    return np.array([index_of_kind[label] for label in table.kind.tolist()], np.int64)


def _faults(grains: Grains, table: GrainTable, kind: np.ndarray | Fault, here: str) -> Iterator[Fault]:
    """Yield reasons why the grains of a file are not those of the scene."""
    n, rods = len(table), grains.oriented
    if isinstance(grains, Clumps):
        reason = "a file gives axes of rods, and no orientations of clumps"
        yield Fault("fill.kind", reason, "use rain or gas")
        return
    if n != grains.count:
        yield Fault("grains.count", f"{here} has {n} grains, and the study {grains.count}", f"use {n}")
    if rods and table.axis is None:
        columns = "add the columns ax, ay and az, the direction of each axis, to a CSV file"
        yield Fault("fill.file", f"the grains are rods, and {here} has no axes", columns)
    if not rods and table.axis is not None:
        yield Fault("fill.file", f"the grains are spheres, and {here} has axes of rods", "leave ax, ay and az out")
    if table.axis is not None and not (lengths := np.linalg.norm(table.axis, axis=1)).all():
        yield Fault("fill.file", f"{here}: the axis of grain {int(np.argmin(lengths)) + 1} has no direction", "mend it")
    if isinstance(kind, Fault):
        yield kind
        return
    yield from _faults_of_sizes(grains, table, kind, here)


def _faults_of_sizes(grains: Grains, table: GrainTable, kind: np.ndarray, here: str) -> Iterator[Fault]:
    diameter = table.diameter
    if diameter is None:
        if any(not isinstance(sort.sizes, Equal) for sort in grains.species):
            yield Fault("grains.sizes", f"{here} has no diameters", "add a column diameter or radius")
        return
    for index, sort in enumerate(grains.species):
        own = diameter[kind == index]
        low, high = sort.sizes.range(grains.diameter)
        if len(own) and (own.min() < low * (1 - _ROUNDED) or own.max() > high * (1 + _ROUNDED)):
            read, expected = (value_range(ends, "mm", 1e3) for ends in ((own.min(), own.max()), (low, high)))
            label = f" of kind {grains.kinds[index].name}" if grains.kinds else ""
            reason = f"diameters{label} in {here} are {read}, and in the study {expected}"
            yield Fault("grains.diameter", reason, "state the sizes of the file, for example by sizes: {kind: table}")
            return
    if isinstance(grains, Spheres) and grains.graded:
        fraction = float(np.mean(diameter**3)) / grains.mean_cube
        if abs(fraction - 1) > _SAMPLED + _SCATTER / math.sqrt(len(table)):
            reason = f"the mean volume of a grain in {here} is {fraction:.3g} times that of the study's sizes"
            yield Fault("grains.sizes", reason, "state the sizes of the file, for example by kind: list or table")


def _packing(grains: Grains, table: GrainTable, kind: np.ndarray | Fault, shift: np.ndarray) -> Packing:
    assert isinstance(kind, np.ndarray)
    diameter, q = None, None
    if isinstance(grains, Spheres) and grains.graded:
        diameter = np.empty(len(table))
        for index, sort in enumerate(grains.species):
            own = kind == index
            low, high = sort.sizes.range(grains.diameter)
            diameter[own] = low if table.diameter is None else np.clip(table.diameter[own], low, high)
    if table.axis is not None:
        q = turned_to(table.axis / np.linalg.norm(table.axis, axis=1)[:, None])
    zero = np.zeros_like(table.x)
    v, omega = (zero if column is None else column for column in (table.v, table.omega))
    sort = kind if grains.kinds else None
    return Packing(x=table.x + shift, v=v, omega=omega, q=q, diameter=diameter, kind=sort)


def _misplaced(grains: Grains, container: Container, packing: Packing, here: str) -> Iterator[Fault]:
    """Yield faults of grains that lie outside the closed container, or overlap a wall or another grain too much."""
    x, half = packing.x, grains.overhang
    diameter = np.full(len(x), grains.diameter) if packing.diameter is None else packing.diameter
    room, axis = Room(container, grains.radius), None if packing.q is None else axes(packing.q)
    ends = [x] if axis is None else [x + half * axis, x - half * axis]
    inside = np.all([room.holds(end, (0.5 - MOST_OVERLAP) * diameter) for end in ends], axis=0)
    if not inside.all():
        first, several = int(np.argmin(inside)), int(np.sum(~inside))
        reason = (
            f"{several} grain{' lies' if several == 1 else 's lie'} outside the closed container, or in a wall by more "
            f"than {MOST_OVERLAP:g} d; the first is grain {first + 1} of {here} at {_position_text(x[first])}"
        )
        yield Fault("fill.file", reason, "move all grains by fill.shift, or use the container of the file")
        return
    pairs = _overlaps(x, diameter, axis, half)
    if pairs is not None:
        (first, second), deepest, several = pairs
        reason = (
            f"grains {first + 1} and {second + 1} of {here} at {_position_text(x[first])} overlap by {deepest:.3g} d, "
            f"more than {MOST_OVERLAP:g} d, as {several} pair{' does' if several == 1 else 's do'}"
        )
        yield Fault("fill.file", reason, "use a bed of stiffer grains")


def _overlaps(
    x: np.ndarray, diameter: np.ndarray, axis: np.ndarray | None, half: float
) -> tuple[tuple[int, int], float, int] | None:
    """Find the largest overlap between grains, if it is above MOST_OVERLAP.

    Returns:
        The pair, its overlap [diameters of the smaller grain], and the number of pairs above MOST_OVERLAP; or None.
    """
    from scipy.spatial import KDTree

    i, j = KDTree(x).query_pairs(diameter.max() + 2 * half, output_type="ndarray").T
    branch = x[i] - x[j]
    apart = np.linalg.norm(branch, axis=1) if axis is None else distances(branch, axis[i], axis[j], half)
    overlap = ((diameter[i] + diameter[j]) / 2 - apart) / np.minimum(diameter[i], diameter[j])
    if not len(overlap) or overlap.max() <= MOST_OVERLAP:
        return None
    deepest = int(np.argmax(overlap))
    return (int(i[deepest]), int(j[deepest])), float(overlap[deepest]), int(np.sum(overlap > MOST_OVERLAP))


def _position_text(x: np.ndarray) -> str:
    return f"({', '.join(f'{1e3 * coordinate:.4g}' for coordinate in x)}) mm"
