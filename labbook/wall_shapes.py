"""What walls look like in recordings: plates as quads, round walls as fine meshes."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from labbook.scene import Frustum, Plane, Scene, Strip

WALL_COLOUR = (120, 130, 150, 70)
PANE_COLOUR = (120, 130, 150, 14)  # front and back walls: the grains behind them must be seen
_AROUND = 96
_SPOKES = 8

Colour = tuple[int, int, int, int]


def wall_quads(scene: Scene, positions: np.ndarray) -> Iterator[tuple[str, np.ndarray, tuple[int, int, int, int]]]:
    """Name, corners [4, 3] in m and colour of every wall, cut to the box of the grains' `positions` [n, 3]."""
    r = scene.grains.radius
    low, high = positions.min(axis=0) - r, positions.max(axis=0) + r
    for wall in scene.container.walls():
        shape = wall.shape
        if isinstance(shape, Strip):
            (x0, z0), (x1, z1) = shape.start, shape.end
            z0, z1 = min(z0, high[2] + 4 * r), min(z1, high[2] + 4 * r)
            corners = [(x0, low[1], z0), (x1, low[1], z1), (x1, high[1], z1), (x0, high[1], z0)]
            yield wall.name, np.array(corners), WALL_COLOUR
        elif isinstance(shape, Plane):
            yield wall.name, _patch(np.array(shape.point), np.array(shape.normal), low, high), PANE_COLOUR


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
class RoundWall:
    """A frustum as a mesh: vertices [n, 3] in m, triangles [m, 3], its lines [k, p, 3], and how fast it turns [rad/s].

    Lines are its two edges and, of one that turns, spokes by which that is seen.
    """

    name: str
    vertices: np.ndarray
    triangles: np.ndarray
    lines: list[np.ndarray]
    colour: Colour
    spin: float


def round_walls(scene: Scene, positions: np.ndarray) -> Iterator[RoundWall]:
    """Every frustum of the scene, cut a little above the grains' `positions` [n, 3]."""
    top = float(positions[:, 2].max()) + 5 * scene.grains.radius
    angle = np.linspace(0, 2 * math.pi, _AROUND + 1)
    for wall in scene.container.walls():
        shape = wall.shape
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
        spokes = [np.stack([ring[k] for ring in rings]) for k in range(0, _AROUND, _AROUND // _SPOKES)] if spin else []
        upright = r0 == r1
        colour = PANE_COLOUR if upright else WALL_COLOUR  # grains are seen through the side of a silo
        yield RoundWall(wall.name, np.concatenate(rings), triangles, [*rings, *spokes], colour, spin)
