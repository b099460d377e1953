"""What walls look like in recordings: plates and panes as polygons, round walls as fine meshes."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from labbook.scene import Frustum, Plane, Scene, Strip

WALL_COLOUR = (120, 130, 150, 70)
PANE_COLOUR = (120, 130, 150, 14)  # front and back walls: the grains behind them must be seen
_AROUND = 96
_SPOKES = 8
_BEYOND = 2.0  # grain radii that spokes reach beyond the edge of their wall

Colour = tuple[int, int, int, int]


def flat_walls(scene: Scene, positions: np.ndarray) -> Iterator[tuple[str, np.ndarray, Colour]]:
    """Name, corners [n, 3] in m (of a convex polygon) and colour of every flat wall, cut to the box of the grains'
    `positions` [n, 3]. A pane in front of plates or behind them, as of a quasi-2D hopper, ends where they do, and they
    at it."""
    r = scene.grains.radius
    low, high = positions.min(axis=0) - r, positions.max(axis=0) + r
    top = high[2] + 4 * r
    walls = scene.container.walls()
    panes = [wall.shape for wall in walls if isinstance(wall.shape, Plane) and _faces_y(wall.shape)]
    front, back = (end([y, *(pane.point[1] for pane in panes)]) for end, y in ((min, low[1]), (max, high[1])))
    plates = {wall.name: _plate(wall.shape, top) for wall in walls if isinstance(wall.shape, Strip)}
    for wall in walls:
        if isinstance(wall.shape, Strip):
            (x0, z0), (x1, z1) = plates[wall.name]
            quad = [(x0, front, z0), (x1, front, z1), (x1, back, z1), (x0, back, z0)]
            yield wall.name, np.array(quad), WALL_COLOUR
        elif isinstance(wall.shape, Plane):
            point, normal = np.array(wall.shape.point), np.array(wall.shape.normal)
            pane = _pane([*plates.values()], point[1]) if _faces_y(wall.shape) and len(plates) > 1 else None
            yield wall.name, _patch(point, normal, low, high) if pane is None else pane, PANE_COLOUR


def _faces_y(plane: Plane) -> bool:
    """Whether it lies across the plates, in front of them or behind."""
    return plane.normal[0] == plane.normal[2] == 0


def _plate(strip: Strip, top: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """x and z [m] of a strip's two edges; it is cut at the height `top`."""
    lower, upper = sorted((strip.start, strip.end), key=lambda edge: edge[1])
    if upper[1] > top > lower[1]:
        part = (top - lower[1]) / (upper[1] - lower[1])
        upper = lower[0] + part * (upper[0] - lower[0]), top
    return lower, upper


def _pane(plates: Sequence, y: float) -> np.ndarray | None:
    """Corners [n, 3] of the smallest convex pane at `y` [m] that all plates fit in; None if they lie on one line."""
    from scipy.spatial import ConvexHull, QhullError

    edges = np.array(plates).reshape(-1, 2)
    try:
        x, z = edges[ConvexHull(edges).vertices].T
    except QhullError:
        return None
    return np.stack([x, np.full_like(x, y), z], axis=1)


def wall_points(scene: Scene, positions: np.ndarray) -> np.ndarray:
    """Points [n, 3] in m with all between them that is drawn of walls around the grains' `positions` [n, 3]."""
    points = [polygon for _, polygon, _ in flat_walls(scene, positions)]
    for wall in meshed_walls(scene, positions):
        points += [wall.vertices, *wall.spokes]
    return np.concatenate([np.empty((0, 3)), *points])


def _patch(point: np.ndarray, normal: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Square of the plane through `point`, as large as the box from `low` to `high`, about the box's middle."""
    normal = normal / np.linalg.norm(normal)
    middle = (low + high) / 2
    middle = middle - normal * np.dot(middle - point, normal)
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    across /= np.linalg.norm(across)
    up = np.cross(normal, across)
    box = (high - low) / 2
    a, b = across * np.abs(across @ box), up * np.abs(up @ box)
    return np.array([middle - a - b, middle + a - b, middle + a + b, middle - a + b])


@dataclass(frozen=True)
class MeshedWall:
    """A wall as a mesh: vertices [n, 3] in m, triangles [m, 3], the edges [p, 3] of a frustum, and how fast it turns
    [rad/s].

    spokes: of one that turns, lines [2, 3] by which that is seen; they reach beyond its edge, where no grain hides
    them.
    """

    name: str
    vertices: np.ndarray
    triangles: np.ndarray
    edges: list[np.ndarray]
    spokes: list[np.ndarray]
    colour: Colour
    spin: float


def meshed_walls(scene: Scene, positions: np.ndarray) -> Iterator[MeshedWall]:
    """Every frustum of the scene, cut a little above the grains' `positions` [n, 3], and walls that have meshes."""
    top = float(positions[:, 2].max()) + 5 * scene.grains.radius
    angle = np.linspace(0, 2 * math.pi, _AROUND + 1)
    for wall in scene.container.walls():
        shape = wall.shape
        if (mesh := shape.mesh()) is not None:
            yield MeshedWall(wall.name, *mesh, [], [], WALL_COLOUR, wall.motion.spin)
        if not isinstance(shape, Frustum) or shape.lower[1] >= top:
            continue
        (r0, z0), (r1, z1) = shape.lower, shape.upper
        if z1 > top:
            r1, z1 = r0 + (r1 - r0) * (top - z0) / (z1 - z0), top
        rings = [
            np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full_like(angle, z)])
            for r, z in ((r0, z0), (r1, z1))
        ]
        k, n = np.arange(_AROUND), _AROUND + 1
        triangles = np.concatenate([np.stack(t, axis=1) for t in ((k, k + 1, k + n), (k + 1, k + n + 1, k + n))])
        spin = wall.motion.spin
        beyond = 1 + _BEYOND * scene.grains.radius / r1
        ends = [(rings[0][k], rings[1][k] * (beyond, beyond, 1)) for k in range(0, _AROUND, _AROUND // _SPOKES)]
        spokes = [np.stack(pair) for pair in ends] if spin else []
        level = z0 == z1
        colour = WALL_COLOUR if level else PANE_COLOUR  # grains are seen through sides and cones
        yield MeshedWall(wall.name, np.concatenate(rings), triangles, rings, spokes, colour, spin)
