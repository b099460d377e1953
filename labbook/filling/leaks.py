"""Search for leaks: ways by which grains reach the plane of the outlet during the filling, and are lost before the
start.

Centres of the smallest grains move on a grid, from the start of the filling to the plane. The grid is a section if
walls have a symmetry (strips along y, frustums round the axis), else it fills the space. On a grid of spacing h,

* nodes that keep h/2 more than a radius from every wall, joined along the grid, are certainly a way: between two of
  them a distance changes by no more than that (from a plane, and from front and back walls, it needs no margin);
* nodes that keep at least a radius less half the diagonal of a cell include every way, in steps to all neighbours,
  while h is below a third of the diameter.

So a gap is certain if it is wider than the grain by h, and a container is certainly tight if all its gaps are narrower
by the diagonal. Gaps in between, or that need a finer grid than MAX_NODES allows, stay undecided. Walls are taken to
continue upwards and sideways: grains that fall over the upper edge of a side wall are not predicted.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from labbook.filling.room import Room
from labbook.scene import Container, Scene
from labbook.scene.model import once
from labbook.scene.walls import WallShape

MAX_NODES = 400_000
"""Largest number of nodes of a grid: less than a second of work."""
_BUDGET = 4_000_000  # nodes times walls
LOOSE = 0.12
"""Solid fraction of grains at the start of the loosest filling."""
_FINE, _COARSE = 12.0, 3.5  # nodes in a diameter: no more are useful, and with fewer a way may pass through a plate


@dataclass(frozen=True)
class Leak:
    """Leak of a container during its filling.

    Args:
        certain: False if the grid cannot decide whether grains fit through.
        at: Centre of a grain on its way through the plane of the outlet [m]; x = y = 0 if the grid is too coarse to
            find a way.
        spacing: Spacing of the grid [m].
    """

    certain: bool
    at: tuple[float, float, float]
    spacing: float

    @property
    def position_text(self) -> str:
        """Coordinates of `at`, in words."""
        x, y, z = (1e3 * value if abs(value) > 1e-6 * self.spacing else 0.0 for value in self.at)
        return f"x, y, z = {x:.3g}, {y:.3g}, {z:.3g} mm"


def leak(closed: Scene, flat: bool = False) -> Leak | None:
    """Find the leak of a closed scene with an outlet plane.

    Args:
        closed: The scene.
        flat: All grains start in the plane y = 0.

    Returns:
        The leak; None if there is none, or no such plane.

    Raises:
        PlacingError: Grains cannot be placed at all.
    """
    if closed.container.outlet_plane is None:
        return None
    grains = closed.grains
    return _leak(closed.container, grains.finest / 2, grains.count * grains.volume / LOOSE, flat)


@once(256)  # points of a study have few containers
def _leak(container: Container, radius: float, volume: float, flat: bool) -> Leak | None:
    plane = container.outlet_plane
    assert plane is not None
    room = Room(container, radius, flat)
    shapes = [wall.shape for wall in container.walls()]
    symmetry = _symmetry(shapes)
    top = room.height_for(volume)
    axes, spacing = _axes(room, plane, radius, symmetry, top)
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    size, points = x.shape[:-1], x.reshape(-1, 3)
    planes = np.full(len(points), np.inf)
    plates = np.full(len(points), np.inf)
    for shape in shapes:
        if shape.half_space:
            planes = np.minimum(planes, shape.distance(points))
        else:
            plates = np.minimum(plates, shape.clearance(points, radius + spacing))
    start = (room.holds(points) & (points[:, 2] > max(plane, room.bottom))).reshape(size)
    diagonal = spacing * math.sqrt(sum(len(axis) > 1 for axis in axes))
    sure = (planes >= radius * (1 - 1e-9)) & (plates >= radius + spacing / 2)
    maybe = (planes >= radius - diagonal / 2) & (plates >= radius - diagonal / 2)
    for certain, clear in ((True, sure), (False, maybe)):
        exits = _reachable(clear.reshape(size), start, x[..., 2] <= plane, all_neighbours=not certain)
        if exits.any():
            highest = exits & (x[..., 2] == x[..., 2][exits].max())
            exit_points = points[highest.ravel()]
            # farther than a grain from plates, `plates` tells no distances
            widths = [shape.distance(exit_points) for shape in shapes if not shape.half_space]
            px, py, _ = exit_points[np.argmax(np.min(widths, axis=0))] if widths else exit_points[0]
            return Leak(certain, (float(px), float(py), plane), spacing)
    if spacing > 2 * radius / _COARSE:  # too coarse a grid may see a way through nothing, and none where there is one
        return Leak(False, (0.0, 0.0, plane), spacing)
    return None


def _symmetry(shapes: list[WallShape]) -> Literal["slice", "round", "none"]:
    """Symmetry of a container: equal sections in every plane y = const, or round the axis, or none."""
    if all("planar" in shape.symmetries for shape in shapes):
        return "slice"
    return "round" if all("axial" in shape.symmetries for shape in shapes) else "none"


def _axes(room: Room, plane: float, radius: float, symmetry: str, top: float) -> tuple[tuple[np.ndarray, ...], float]:
    """Choose x, y and z of the nodes [m], and their spacing, as fine as is useful and MAX_NODES allows."""
    (left, right), (front, back), low = room.x, room.y, plane
    if symmetry == "round":
        left = 0.0
    high = max(room.highest, plane + 4 * radius) + 4 * radius
    if not room.prismatic:  # up to where grains start
        high = max(high, top)
    deep = symmetry == "none" and back - front > 0
    rims = [shape.bounds.high[2] for shape in room.shapes if shape.holds]
    high = min(high, max(rims, default=math.inf))  # above, a way would lead over the rim
    sides = [right - left, back - front if deep else 0.0, high - low]
    spacing = 2 * radius / _FINE
    for _ in range(60):
        counts = [max(1, math.ceil(side / spacing)) + 1 if side > 0 else 1 for side in sides]
        if math.prod(counts) <= min(MAX_NODES, _BUDGET / sum(shape.effort for shape in room.shapes)):
            break
        spacing *= 1.1
    middle = np.array([(front + back) / 2]) if symmetry != "round" else np.zeros(1)
    y = _nodes(front, back, spacing) if deep else middle
    return (_nodes(left, right, spacing), y, _nodes(low, high, spacing)), spacing


def _nodes(low: float, high: float, spacing: float) -> np.ndarray:
    """Nodes no further apart than `spacing` [m], among them both ends and the middle."""
    return np.linspace(low, high, 2 * math.ceil((high - low) / spacing / 2) + 1) if high > low else np.array([low])


def _reachable(clear: np.ndarray, start: np.ndarray, end: np.ndarray, all_neighbours: bool) -> np.ndarray:
    """Mark the nodes of `end` that are connected by clear nodes to a node of `start`."""
    from scipy.ndimage import generate_binary_structure, label

    joined = generate_binary_structure(3, 3 if all_neighbours else 1)
    parts, _ = label(clear, joined)  # pyright: ignore[reportGeneralTypeIssues]
    begun = np.unique(parts[start & clear])
    return np.isin(parts, begun[begun > 0]) & end
