"""Boxes and meshes of triangles, and all that follows of a surface from its distance function alone.

The distance function of a surface gives the distance [m] of points, shape [n, 3], from it, shape [n]; it may be
negative on one side. Extent, mesh and section of a wall that states no more are found from it by numbers.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

Point2 = tuple[float, float]
Point3 = tuple[float, float, float]
Segment = tuple[Point2, Point2]
Distance = Callable[[np.ndarray], np.ndarray]

AROUND = 96
"""Corners of a circle in meshes."""
CELLS = 48
"""Cells of the longest side of the grid on which a surface is sought."""
_FAR = 1e6  # m: from here a bounded surface is a point, to 1e-8 m for one of 0.1 m
_STEPS = 1000  # beside an upright wall they are short
_TETRAHEDRA = ((0, 1, 3, 7), (0, 1, 5, 7), (0, 2, 3, 7), (0, 2, 6, 7), (0, 4, 5, 7), (0, 4, 6, 7))  # of a cube, by bits
_EDGES = {1: ((0, 1), (0, 2), (0, 3)), 2: ((0, 2), (0, 3), (1, 3), (1, 2)), 3: ((3, 0), (3, 1), (3, 2))}


@dataclass(frozen=True)
class Bounds:
    """Box from `low` to `high` [m] along the axes; infinite where it has no end."""

    low: Point3
    high: Point3

    @property
    def endless(self) -> tuple[bool, bool, bool]:
        """Mask of the axes along which the box has no end, on either side."""
        x, y, z = (math.isinf(a) or math.isinf(b) for a, b in zip(self.low, self.high, strict=True))
        return x, y, z

    @property
    def size(self) -> Point3:
        """Extents [m] along x, y and z."""
        x, y, z = (b - a for a, b in zip(self.low, self.high, strict=True))
        return x, y, z

    def within(self, box: "Bounds | None") -> "Bounds":
        """Intersect two boxes.

        Args:
            box: Other box; None: all space.

        Returns:
            Intersection; where the boxes do not meet, its lower ends are above its upper ones.
        """
        if box is None:
            return self
        return Bounds(_point(map(max, self.low, box.low)), _point(map(min, self.high, box.high)))


def _point(values) -> Point3:
    x, y, z = map(float, values)
    return x, y, z


@dataclass(frozen=True, eq=False)
class Mesh:
    """Surface of triangles.

    Attributes:
        vertices: Places [m], shape [n, 3].
        triangles: Corners as rows of `vertices`, shape [m, 3].
        outlines: Lines along edges of the surface [m], each of shape [p, 3].
    """

    vertices: np.ndarray
    triangles: np.ndarray
    outlines: tuple[np.ndarray, ...] = ()

    @classmethod
    def polygon(cls, corners: np.ndarray, outlined: bool) -> "Mesh":
        """Mesh a convex polygon.

        Args:
            corners: Corners in order [m], shape [n, 3].
            outlined: Add a line along its edge.

        Returns:
            Fan of triangles.
        """
        fan = np.array([[0, k, k + 1] for k in range(1, len(corners) - 1)])
        return cls(corners, fan, (np.array([*corners, corners[0]]),) if outlined else ())

    @classmethod
    def joined(cls, meshes: "Sequence[Mesh]") -> "Mesh":
        """Join meshes to one.

        Args:
            meshes: Meshes, at least one.

        Returns:
            Mesh of all of their triangles and outlines.
        """
        first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
        triangles = [mesh.triangles + k for mesh, k in zip(meshes, first, strict=False)]
        outlines = tuple(line for mesh in meshes for line in mesh.outlines)
        return cls(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(triangles), outlines)

    @classmethod
    def turned(cls, line: Segment, corners: int) -> "Mesh":
        """Turn a line about the z axis.

        Args:
            line: Line (r, z) [m].
            corners: Corners of the polygon in place of a circle; they lie on the circle.

        Returns:
            Frustum of a polygon, outlined by its two edges.
        """
        angle = 2 * np.pi * np.arange(corners) / corners
        rings = [np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(corners, z)]) for r, z in line]
        k = np.arange(corners)
        after = (k + 1) % corners
        triangles = np.stack([[k, after, corners + k], [after, corners + after, corners + k]])
        outlines = tuple(np.concatenate([ring, ring[:1]]) for ring in rings)
        return cls(np.concatenate(rings), np.concatenate(triangles.transpose(0, 2, 1)), outlines)

    def section(self) -> tuple[Segment, ...]:
        """Cut the surface with the plane y = 0.

        Returns:
            Lines (x, z) [m]; none of triangles that lie in that plane.
        """
        corners = self.vertices[self.triangles]
        y = corners[:, :, 1]
        cut = corners[(y.min(axis=1) < 0) & (y.max(axis=1) >= 0)]
        lines = list[Segment]()
        for triangle in cut:
            ends = [
                (float(p[0] - p[1] / (q[1] - p[1]) * (q[0] - p[0])), float(p[2] - p[1] / (q[1] - p[1]) * (q[2] - p[2])))
                for p, q in zip(triangle, np.roll(triangle, 1, axis=0), strict=True)
                if (p[1] < 0) != (q[1] < 0)
            ]
            if ends[0] != ends[1]:
                lines.append((ends[0], ends[1]))
        return tuple(lines)


def from_segment(section: np.ndarray, start: Point2, end: Point2) -> np.ndarray:
    """Compute the distance from a line in a section.

    Args:
        section: Points (u, z) [m], shape [n, 2].
        start: One end of the line [m].
        end: The other end [m].

    Returns:
        Distances from the nearest point of the line [m], shape [n].
    """
    along, at = np.array(end) - start, section - start
    fraction = np.minimum(np.maximum(at @ along / (along @ along), 0), 1)
    # by hand: norm along so short an axis takes most of the time of a filling's start
    return np.sqrt((at[:, 0] - fraction * along[0]) ** 2 + (at[:, 1] - fraction * along[1]) ** 2)


def above_line(start: Point2, end: Point2, u: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Masks of the points (u, z) [m] straight above the line from `start` to `end`, and straight below it, shape [n].

    No point is above or below an upright line.
    """
    run, rise = end[0] - start[0], end[1] - start[1]
    if run == 0:
        return np.zeros(len(u), bool), np.zeros(len(u), bool)
    fraction = (u - start[0]) / run
    beside, above = (fraction >= 0) & (fraction <= 1), z - start[1] > fraction * rise
    return beside & above, beside & ~above


def extent(distance: Distance) -> Bounds:
    """Find the box around a surface.

    Args:
        distance: Distance function.

    Returns:
        Box, to 1e-8 m for a surface of 0.1 m; infinite where the surface has no end.
    """
    sides = []
    for sense in (-1.0, 1.0):
        reach = _FAR - np.abs(distance(sense * _FAR * np.eye(3)))
        farther = 10 * _FAR - np.abs(distance(10 * sense * _FAR * np.eye(3)))
        ends = np.abs(farther - reach) <= 1e-5 * (1 + np.abs(reach))
        sides.append(np.where(ends, sense * reach, sense * math.inf))
    # of what is flat, an end may lie beyond the other by the error
    return Bounds(_point(np.minimum(*sides)), _point(np.maximum(*sides)))


def enclosed(inside: Callable[[np.ndarray], np.ndarray], bounds: Bounds) -> Bounds:
    """Find the box around all points of a wall's inner side.

    Args:
        inside: Mask of points [m], shape [n, 3], on that side.
        bounds: Box around the wall.

    Returns:
        `bounds`, infinite on sides on which points far out are inside too.
    """
    low, high = (
        np.where(inside(sense * _FAR * np.eye(3)), sense * math.inf, ends)
        for sense, ends in ((-1.0, bounds.low), (1.0, bounds.high))
    )
    return Bounds(_point(low), _point(high))


def contour(distance: Distance, bounds: Bounds) -> Mesh | None:
    """Mesh a surface by marching tetrahedra, with vertices moved onto the surface.

    Where the distance has a negative side, the mesh is its border; else the surface is thin, and the mesh has two
    layers that coincide.

    Args:
        distance: Distance function.
        bounds: Box with a grid of CELLS cells along its longest side.

    Returns:
        Mesh; None if there is no surface in the box, or the box has no end.
    """
    if any(bounds.endless) or min(bounds.size) < 0:
        return None
    h = max(bounds.size) / CELLS
    if h == 0:
        return None
    axes = [np.arange(a - 2.5 * h, b + 3 * h, h) for a, b in zip(bounds.low, bounds.high, strict=True)]
    shape = tuple(map(len, axes))
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    value = distance(nodes)
    value = value if (value < 0).any() else value - 0.9 * h
    first = np.arange(len(nodes)).reshape(shape)[:-1, :-1, :-1].ravel()
    step = (shape[1] * shape[2], shape[2], 1)
    corners = np.stack([first + sum(step[k] for k in range(3) if c >> k & 1) for c in range(8)], axis=1)
    corners = corners[np.ptp(np.sign(value[corners]), axis=1) > 0]
    pairs = list[np.ndarray]()  # of nodes, for each corner of each triangle: [n, 3, 2]
    for tetrahedron in _TETRAHEDRA:
        four = corners[:, tetrahedron]
        negative = value[four] < 0
        order = np.argsort(~negative, axis=1, kind="stable")
        four, count = np.take_along_axis(four, order, axis=1), negative.sum(axis=1)
        for number, edges in _EDGES.items():
            edge = four[count == number][:, np.array(edges)]
            pairs += [edge[:, :3]] if len(edges) == 3 else [edge[:, :3], edge[:, [0, 2, 3]]]
    ends = np.sort(np.concatenate(pairs), axis=2)
    if not len(ends):
        return None
    keys, triangles = np.unique(ends[..., 0] * len(nodes) + ends[..., 1], return_inverse=True)
    a, b = keys // len(nodes), keys % len(nodes)
    vertices = nodes[a] + (value[a] / (value[a] - value[b]))[:, None] * (nodes[b] - nodes[a])
    for _ in range(3):
        vertices = vertices - distance(vertices)[:, None] * _gradient(distance, vertices, 1e-4 * h)
    return Mesh(vertices, triangles.reshape(-1, 3))


def _gradient(distance: Distance, x: np.ndarray, step: float) -> np.ndarray:
    """Unit vectors along which the distance of points x, shape [n, 3], grows, shape [n, 3]."""
    slope = np.stack([distance(x + shift) - distance(x - shift) for shift in step * np.eye(3)], axis=1)
    return slope / np.maximum(np.linalg.norm(slope, axis=1), 1e-9 * step)[:, None]


def stands_over(distance: Distance, bounds: Bounds, x: np.ndarray) -> np.ndarray:
    """Select points with a surface straight below them, by steps downwards as long as the distance is.

    Args:
        distance: Distance function.
        bounds: Box around the surface.
        x: Points [m], shape [n, 3].

    Returns:
        Mask, shape [n].
    """
    size = [side for side in bounds.size if math.isfinite(side)]
    near = 1e-6 * max(size, default=1.0)
    above, left, at = np.zeros(len(x), bool), np.arange(len(x)), np.array(x, float)
    for _ in range(_STEPS):
        if not len(left):
            break
        gaps = np.abs(distance(at))
        above[left[gaps <= near]] = True
        at[:, 2] -= gaps
        goes_on = (gaps > near) & (at[:, 2] >= bounds.low[2] - near)
        left, at = left[goes_on], at[goes_on]
    return above
