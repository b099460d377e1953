"""Walls in recordings: their meshes around the bed, plates as polygons."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labbook.scene import Scene, Wall
from labbook.scene.geometry import Bounds, Mesh, Point3, Segment
from labbook.scene.part_motion import Poses

WALL_COLOUR = (120, 130, 150, 70)
TRANSPARENT_COLOUR = (120, 130, 150, 14)  # of walls with grains behind them, which must be seen
_SPOKES = 8
_BEYOND = 2.0  # grain radii that spokes reach beyond the edge of their wall

Colour = tuple[int, int, int, int]


@dataclass(frozen=True)
class DrawnWall:
    """Wall in a picture or a recording.

    Attributes:
        name: Name of the wall.
        mesh: Mesh with lines along its edges; of a part, at the opening.
        colour: RGBA.
        spin: Angular velocity about the axis x = y = 0 [rad/s].
        spokes: Lines, each of shape [2, 3], that show the rotation; they end beyond the edge, where no grain is.
        part: Wall itself if it moves as a whole or vanishes at a time; else None.
    """

    name: str
    mesh: Mesh
    colour: Colour
    spin: float
    spokes: tuple[np.ndarray, ...] = ()
    part: Wall | None = None

    def at(self, times: Sequence[float] | np.ndarray) -> Iterator[Mesh]:
        """Mesh the wall at times of the discharge.

        Args:
            times: Times since the opening [s].

        Yields:
            Mesh at each time.
        """
        if self.part is None:
            yield from (self.mesh for _ in times)
            return
        poses = self.poses(times)
        for k in range(len(poses.shift)):
            yield replace(self.mesh, vertices=poses.positions(k, self.mesh.vertices))

    def poses(self, times: Sequence[float] | np.ndarray) -> Poses:
        """Compute the poses of a part.

        Args:
            times: Times since the opening [s], shape [n].

        Returns:
            Poses; a part that has vanished is a point.
        """
        assert self.part is not None
        poses = self.part.poses(np.asarray(times, float))
        removed = np.asarray(times, float) >= (math.inf if self.part.removal is None else self.part.removal)
        point = self.mesh.vertices.mean(axis=0)
        shift = np.where(removed[:, None], point, poses.shift)
        return poses._replace(turn=np.where(removed[:, None, None], 0.0, poses.turn), shift=shift)


def drawn_walls(scene: Scene, positions: np.ndarray) -> Iterator[DrawnWall]:
    """Mesh all walls of a scene around its grains, cut a little above them.

    A transparent wall in front of plates or behind them, as of a quasi-2D hopper, ends where they do, and they at it.

    Args:
        scene: Scene.
        positions: Centres of grains [m], shape [n, 3].

    Yields:
        Walls that lie around the grains.
    """
    r = scene.grains.radius
    low, high = positions.min(axis=0) - r, positions.max(axis=0) + r
    top = high[2] + 4 * r
    walls = [(wall, wall.shape.bounds) for wall in scene.container.walls()]
    y_of_plates = {
        wall.name: box.low[1] for wall, box in walls if wall.shape.is_transparent and box.endless == (True, False, True)
    }
    front, back = (end([y, *y_of_plates.values()]) for end, y in ((min, low[1]), (max, high[1])))
    bed = Bounds((low[0], low[1], low[2]), (high[0], high[1], high[2]))
    around = (low[0], front, low[2]), (high[0], back, top)
    ribs = [wall.shape for wall, box in walls if box.endless == (False, True, False)]
    plates = [_cut(line, top) for shape in ribs for line in shape.section()]
    for wall, box in walls:
        mesh = _bounded_plate(plates, y_of_plates[wall.name]) if wall.name in y_of_plates and len(plates) > 1 else None
        mesh = mesh or wall.shape.mesh(bed if sum(box.endless) > 1 else _up_to(top, box, *around))
        if mesh is None:
            continue
        spin = 0.0 if any(box.endless) else wall.motion.spin
        colour = TRANSPARENT_COLOUR if wall.shape.is_transparent else WALL_COLOUR
        yield DrawnWall(
            wall.name, mesh, colour, spin, _spokes(mesh, r) if spin else (), wall if wall.is_posed else None
        )


def _up_to(top: float, wall: Bounds, low: Point3, high: Point3) -> Bounds:
    """Box that cuts a wall at z = `top` [m], and along axes without an end from `low` to `high` [m]."""
    inf = np.inf
    x, y, z = zip(np.where(wall.endless, low, -inf).tolist(), np.where(wall.endless, high, inf).tolist(), strict=True)
    return Bounds((x[0], y[0], z[0]), (x[1], y[1], top))


def _cut(line: Segment, top: float) -> Segment:
    """Part of a line (x, z) [m] below z = `top`; all of a line that begins above."""
    lower, upper = sorted(line, key=lambda end: end[1])
    if upper[1] > top > lower[1]:
        fraction = (top - lower[1]) / (upper[1] - lower[1])
        upper = lower[0] + fraction * (upper[0] - lower[0]), top
    return lower, upper


def _bounded_plate(plates: list[Segment], y: float) -> Mesh | None:
    """Smallest convex polygon at `y` [m] that all plates fit in; None if they lie on one line."""
    from scipy.spatial import ConvexHull, QhullError

    edges = np.array(plates).reshape(-1, 2)
    try:
        x, z = edges[ConvexHull(edges).vertices].T
    except QhullError:
        return None
    return Mesh.polygon(np.stack([x, np.full_like(x, y), z], axis=1), outlined=False)


def _spokes(mesh: Mesh, radius: float) -> tuple[np.ndarray, ...]:
    """Lines from the inner to the outer edge of a wall about the axis, and beyond; radius: of a grain [m]."""
    if len(mesh.outlines) < 2:
        return ()
    inner, outer = mesh.outlines[0], mesh.outlines[-1]
    beyond = 1 + _BEYOND * radius / outer[0, 0]
    corners = len(outer) - 1
    return tuple(np.stack([inner[k], outer[k] * (beyond, beyond, 1.0)]) for k in range(0, corners, corners // _SPOKES))


def wall_points(scene: Scene, positions: np.ndarray) -> np.ndarray:
    """Find the extent of the walls around grains in a picture.

    Args:
        scene: Scene.
        positions: Centres of grains [m], shape [n, 3].

    Returns:
        Vertices of the walls and ends of their spokes [m], shape [m, 3].
    """
    points = [np.concatenate([wall.mesh.vertices, *wall.spokes]) for wall in drawn_walls(scene, positions)]
    return np.concatenate([np.empty((0, 3)), *points])
