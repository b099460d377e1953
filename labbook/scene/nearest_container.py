"""Openings of a surface of triangles, and the built-in container that it is nearest to."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from pydantic import ValidationError

from labbook.scene.container_shape import ContainerShape
from labbook.scene.geometry import Bounds
from labbook.scene.mesh import TriangleMesh
from labbook.scene.model import once
from labbook.scene.round_silos import ConicalSilo, CylinderSilo
from labbook.scene.triangles import Triangles
from labbook.scene.wedge_hopper import WedgeHopper

CLOSE = 0.05
"""Largest difference from a container, in half widths of the surface, up to which it is named."""
_LEVEL = 1e-6  # of the height: vertices so close in z lie at one height
_RIM = 1e-3  # of the half width: vertices so close to the widest lie on the upright wall
_POINTS = 20_000  # points of the surface that are compared, at most


@dataclass(frozen=True)
class Opening:
    """Hole of an open surface.

    Attributes:
        area: Area [m^2].
        z: Height of its middle [m].
        rim: Vertices along it [m], shape [k, 3].
    """

    area: float
    z: float
    rim: np.ndarray

    @property
    def diameter(self) -> float:
        """Diameter [m] of a circle of the same area."""
        return math.sqrt(4 * self.area / math.pi)


@dataclass(frozen=True)
class NearestContainer:
    """Built-in container that a surface is near to.

    Attributes:
        container: Container in its own frame: the middle of its outlet is the origin.
        origin: Place of that origin [m].
        difference: Largest distance of a point of container or surface from the other [m].
        turned: True if the container is turned by 90 degrees about z.
    """

    container: ContainerShape
    origin: tuple[float, float, float]
    difference: float
    turned: bool = False


def openings(surface: Triangles) -> tuple[Opening, ...]:
    """Find the holes of a surface: loops of edges of one triangle.

    Args:
        surface: Surface.

    Returns:
        Holes from the lowest; areas are those of the loops as seen along their normals.
    """
    beside: dict[int, list[int]] = {}
    for a, b in surface.free_edges.tolist():
        beside.setdefault(a, []).append(b)
        beside.setdefault(b, []).append(a)
    loops, left = list[list[int]](), {vertex for vertex, others in beside.items() if len(others) == 2}
    while left:
        loop = [left.pop()]
        while ahead := [vertex for vertex in beside[loop[-1]] if vertex in left]:
            loop.append(ahead[0])
            left.remove(ahead[0])
        if loop[0] in beside[loop[-1]] and len(loop) > 2:
            loops.append(loop)
    rims = [surface.vertices[loop] for loop in loops]
    areas = [float(np.linalg.norm(np.cross(rim, np.roll(rim, -1, axis=0)).sum(axis=0)) / 2) for rim in rims]
    holes = (Opening(area, float(rim[:, 2].mean()), rim) for area, rim in zip(areas, rims, strict=True))
    return tuple(sorted(holes, key=lambda hole: hole.z))


def outlets(surface: Triangles) -> tuple[Opening, ...]:
    """Openings of a surface below its upper end."""
    top = surface.bounds.high[2] - _LEVEL * surface.bounds.size[2]
    return tuple(hole for hole in openings(surface) if hole.z < top)


@once(16)
def nearest_container(mesh: TriangleMesh) -> NearestContainer | None:
    """Find the built-in container that a mesh with one outlet is nearest to.

    Args:
        mesh: Wall of triangles.

    Returns:
        Container and its difference; None if no container is near.
    """
    surface = mesh.surface
    holes = outlets(surface)
    if len(holes) != 1:
        return None
    half = min(surface.bounds.size[:2]) / 2
    candidates = [candidate for turned in (False, True) for candidate in _candidates(surface, holes[0], turned)]
    nearest = min(candidates, key=lambda candidate: candidate.difference, default=None)
    return nearest if nearest is not None and nearest.difference <= CLOSE * half else None


def _candidates(surface: Triangles, hole: Opening, turned: bool) -> Iterator[NearestContainer]:
    low, high = np.array(surface.bounds.low), np.array(surface.bounds.high)
    origin = np.array([*(low + high)[:2] / 2, low[2]])
    swap = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]] if turned else np.eye(3)
    vertices, rim = (surface.vertices - origin) @ swap, (hole.rim - origin) @ swap
    x, y, z = np.abs(vertices).max(axis=0)
    from_axis = np.hypot(vertices[:, 0], vertices[:, 1])
    hole_radius = float(np.hypot(rim[:, 0], rim[:, 1]).max())
    x_left, x_right = float(rim[:, 0].min()), float(rim[:, 0].max())
    shapes: list[tuple[type[ContainerShape], dict[str, float | None]]] = []
    if not turned:
        radius = float(from_axis.max())
        rise = float(vertices[from_axis >= radius * (1 - _RIM), 2].min())
        round_silo = {"diameter": 2 * radius, "height": max(z, rise * (1 + _RIM)), "orifice": 2 * hole_radius}
        if rise > _LEVEL * z:
            angle = math.atan2(radius - hole_radius, rise)
            shapes.append((ConicalSilo, {**round_silo, "angle": angle}))
        else:
            shapes.append((CylinderSilo, {**round_silo}))
    rise = float(vertices[np.abs(vertices[:, 0]) >= x * (1 - _RIM), 2].min())
    wide = max(-x_left, x_right) if x_left < 0 < x_right else x
    angle = math.pi / 2 if rise <= _LEVEL * z else math.atan2(x - wide, rise)
    gap = None if abs(x_left + x_right) <= _RIM * x else x_left + x
    wedge = {"width": 2 * x, "height": max(z, rise * (1 + _RIM)), "thickness": 2 * y, "orifice": x_right - x_left}
    shapes.append((WedgeHopper, {**wedge, "angle": angle, "gap": gap}))
    for kind, sizes in shapes:
        try:
            container = kind.model_validate(sizes)
        except ValidationError:
            continue
        difference = _difference(container, Triangles(vertices, surface.corners))
        yield NearestContainer(container, (float(origin[0]), float(origin[1]), float(origin[2])), difference, turned)


def _difference(container: ContainerShape, surface: Triangles) -> float:
    """Largest distance [m] of corners and middles of triangles from the walls, and of bounded walls from the
    surface."""
    points = np.concatenate([surface.vertices, surface.corner_positions.mean(axis=1)])
    points = points[:: max(1, len(points) // _POINTS)]
    walls = container.walls()
    largest = np.min([np.abs(wall.shape.distance(points)) for wall in walls], axis=0).max()
    within = Bounds(surface.bounds.low, surface.bounds.high)
    for wall in walls:
        wall_mesh = None if wall.shape.half_space else wall.shape.mesh(within)
        if wall_mesh is not None:
            corners = wall_mesh.vertices[wall_mesh.triangles]
            largest = max(largest, surface.distance(np.concatenate([wall_mesh.vertices, corners.mean(axis=1)])).max())
    return float(largest)
