"""Surfaces of triangles: welded and put into one order, checked, measured, and where points lie beside them.

The order follows from the places of vertices alone, so that files which list the same triangles in another order, from
another corner or with another sense of rotation give the same surface, to the bit. Which side of a triangle its file
calls the outer one is ignored.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labbook.scene.cells import Cells, ranges
from labbook.scene.geometry import Bounds

WELD = 1e-6
"""Distance, as a fraction of the diagonal of the box around a surface, below which two vertices are one."""
_AT_ONCE = 400_000  # pairs of points and triangles in memory
_POINTS = 20_000  # whose near triangles are in memory together
_SLACK = 1 + 1e-9  # of bounds, against round-off
_BESIDE = 1e-6
"""Distance from a triangle, as a fraction of the longest side of the box, at which its inner side is sought."""
_SHORT = 1 / 32
"""Reach, as a fraction of the diagonal of a surface, below which a grid finds the triangles near points."""
_ACROSS = 256
"""Diagonal of a surface over the smallest cells of the grid of its triangles seen from above."""
_GRIDS = 4  # of a surface that are kept
_BEYOND = 2.0  # distance, in reaches, that stands for all longer ones
_PLANE_SLACK = 1 + 1e-6  # against round-off in normals of needles
_PIECES = 32
"""Diagonal of a surface over the radius of the largest ball around a piece of it."""


@dataclass(frozen=True)
class Flaw:
    """Defect of a surface that is not clean.

    Attributes:
        kind: `non-manifold`, `t-junctions` or `intersections`.
        count: Number of such places.
        at: One of them [m].
    """

    kind: str
    count: int
    at: tuple[float, float, float]


@dataclass(frozen=True)
class Welded:
    """Number of vertices merged, and of triangles dropped because they have no area or repeat another."""

    vertices: int
    flat: int
    repeated: int


@dataclass(frozen=True, eq=False)
class Triangles:
    """A surface of m triangles with n vertices.

    Attributes:
        vertices: Places [m], shape [n, 3], in ascending order of x, then y, then z.
        corners: Vertices of each triangle, shape [m, 3], each row and all rows in ascending order.
    """

    vertices: np.ndarray
    corners: np.ndarray

    @classmethod
    def welded(cls, vertices: np.ndarray, corners: np.ndarray) -> "tuple[Triangles, Welded]":
        """Merge vertices closer than WELD, and drop triangles without area and repeated ones.

        Args:
            vertices: Places [m], shape [n, 3], in any order; the same place may occur often.
            corners: Vertices of each triangle, shape [m, 3].

        Returns:
            The surface, and what was merged and dropped.
        """
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components
        from scipy.spatial import KDTree

        positions, first = np.unique(vertices + 0.0, axis=0, return_inverse=True)
        corners = first.reshape(-1)[corners]
        near = WELD * float(np.linalg.norm(np.ptp(positions, axis=0))) if len(positions) else 0.0
        pairs = KDTree(positions).query_pairs(near, output_type="ndarray") if len(positions) and near > 0 else []
        if len(pairs):
            links = coo_array((np.ones(len(pairs)), np.transpose(pairs)), shape=(len(positions),) * 2)
            _, group = connected_components(links, directed=False)
            keeper = np.full(group.max() + 1, len(positions))
            np.minimum.at(keeper, group, np.arange(len(positions)))  # the first in order stands for its group
            corners = keeper[group][corners]
        corners = np.sort(corners, axis=1)
        a, b, c = (positions[corners[:, k]] for k in range(3))
        longest = np.max([np.linalg.norm(q - p, axis=1) for p, q in ((a, b), (b, c), (a, c))], axis=0, initial=0.0)
        solid = np.linalg.norm(np.cross(b - a, c - a), axis=1) > near * longest  # else flatter than the weld
        unlike = np.unique(corners[solid], axis=0)
        used, corners = np.unique(unlike, return_inverse=True)
        merged = Welded(len(vertices) - len(positions), int(np.sum(~solid)), int(np.sum(solid)) - len(unlike))
        return cls(positions[used], corners.reshape(-1, 3)), merged

    @cached_property
    def corner_positions(self) -> np.ndarray:
        """Corners [m], shape [m, 3, 3]."""
        return self.vertices[self.corners]

    @cached_property
    def normals(self) -> np.ndarray:
        """Unit normals, shape [m, 3], of arbitrary sense."""
        a, b, c = np.moveaxis(self.corner_positions, 1, 0)
        normal = np.cross(b - a, c - a)
        return normal / np.linalg.norm(normal, axis=1)[:, None]

    @property
    def area(self) -> float:
        """Sum of the areas of its triangles [m^2]."""
        a, b, c = np.moveaxis(self.corner_positions, 1, 0)
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)

    @cached_property
    def volume(self) -> float:
        """Volume within the closed surface [m^3], by the divergence theorem; NaN of an open one."""
        if not self.closed:
            return math.nan
        middle, outwards = self.corner_positions.mean(axis=1), self.normals.copy()
        step = _BESIDE * max(self.bounds.size)
        outwards[self.inside(middle + step * outwards)] *= -1  # triangles are of arbitrary sense
        a, b, c = np.moveaxis(self.corner_positions, 1, 0)
        areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        return float((_dot(middle - middle.mean(axis=0), outwards) * areas).sum() / 3)

    @property
    def bounds(self) -> Bounds:
        """Box around the surface [m]."""
        low, high = self.vertices.min(axis=0).tolist(), self.vertices.max(axis=0).tolist()
        return Bounds((low[0], low[1], low[2]), (high[0], high[1], high[2]))

    @cached_property
    def edges(self) -> tuple[np.ndarray, np.ndarray]:
        """Edges as pairs of vertices, shape [e, 2], ascending; and the edges of each triangle, shape [m, 3], of which
        edge k lies opposite to corner k."""
        pairs = self.corners[:, [[1, 2], [0, 2], [0, 1]]].reshape(-1, 2)
        edges, numbers = np.unique(pairs, axis=0, return_inverse=True)
        return edges, numbers.reshape(-1, 3)

    @property
    def free_edges(self) -> np.ndarray:
        """Edges of one triangle, as pairs of vertices, shape [e, 2]."""
        edges, numbers = self.edges
        return edges[np.bincount(numbers.ravel(), minlength=len(edges)) == 1]

    def creases(self, angle: float) -> np.ndarray:
        """Find the edges at which the surface ends or bends.

        Args:
            angle: Angle between two triangles [rad] from which on their edge counts.

        Returns:
            Edges as pairs of vertices, shape [e, 2].
        """
        edges, numbers = self.edges
        order = np.argsort(numbers, axis=None, kind="stable")
        counts = np.bincount(numbers.ravel(), minlength=len(edges))
        first = (np.cumsum(counts) - counts)[counts == 2]
        normals = [self.normals[order[first + k] // 3] for k in range(2)]
        sharp = np.abs(_dot(*normals)) < math.cos(angle)
        return np.concatenate([self.free_edges, edges[counts == 2][sharp]])

    @property
    def closed(self) -> bool:
        """True if every edge belongs to two triangles, so that the surface bounds a volume."""
        edges, numbers = self.edges
        return bool((np.bincount(numbers.ravel(), minlength=len(edges)) == 2).all())

    # whether it is clean

    def flaws(self) -> Iterator[Flaw]:
        """Edges of more than two triangles, vertices within other edges, and triangles that cut one another."""
        for kind, faulty in (
            ("non-manifold", self._crowded()),
            ("t-junctions", self._junctions()),
            ("intersections", self._cuts()),
        ):
            if len(faulty):
                x, y, z = faulty[0].tolist()
                yield Flaw(kind, len(faulty), (x, y, z))

    def _crowded(self) -> np.ndarray:
        edges, numbers = self.edges
        crowded = np.bincount(numbers.ravel(), minlength=len(edges)) > 2
        return self.vertices[edges[crowded]].mean(axis=1)

    def _junctions(self) -> np.ndarray:
        from scipy.spatial import KDTree

        edges, _ = self.edges
        ends = self.vertices[edges]
        near = WELD * float(np.linalg.norm(self.bounds.size))
        middle, half = ends.mean(axis=1), np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / 2
        tree, junctions = KDTree(self.vertices), list[np.ndarray]()
        for e, inside in enumerate(tree.query_ball_point(middle, half)):
            inner = np.setdiff1d(inside, edges[e])
            if len(inner):
                along = (ends[e, 1] - ends[e, 0]) / (2 * half[e])
                r = self.vertices[inner] - ends[e, 0]
                aside = np.linalg.norm(r - np.outer(r @ along, along), axis=1)
                junctions += list(self.vertices[inner[aside < near]])
        return np.array(junctions).reshape(-1, 3)

    def _cuts(self) -> np.ndarray:
        """Places at which an edge of one triangle passes through another, of triangles that share no vertex."""
        near, hits = WELD * float(np.linalg.norm(self.bounds.size)), list[np.ndarray]()
        for i, j in self._overlapping():
            apart = ~(self.corners[i][:, :, None] == self.corners[j][:, None, :]).any(axis=(1, 2))
            for first, second in ((i[apart], j[apart]), (j[apart], i[apart])):
                p, n = self.corner_positions[second], self.normals[second]
                for k in range(3):
                    start, end = self.corner_positions[first][:, k], self.corner_positions[first][:, (k + 1) % 3]
                    at, to = (_dot(x - p[:, 0], n) for x in (start, end))
                    through = (at * to < 0) & (np.minimum(np.abs(at), np.abs(to)) > near)
                    hit = start + (at / np.where(at == to, 1.0, at - to))[:, None] * (end - start)
                    for c in range(3):
                        side = p[:, (c + 1) % 3] - p[:, c]
                        inward = np.cross(n, side)
                        third = p[:, (c + 2) % 3] - p[:, c]
                        inward *= np.sign(_dot(inward, third))[:, None]
                        inward /= np.linalg.norm(inward, axis=1)[:, None]
                        through &= _dot(hit - p[:, c], inward) > near
                    hits += list(hit[through])
        return np.array(hits).reshape(-1, 3)

    def _overlapping(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Pairs of triangles whose boxes overlap, some at a time, each of shape [k]."""
        low, high = self.corner_positions.min(axis=1), self.corner_positions.max(axis=1)
        axis = int(np.argmax(np.ptp(self.vertices, axis=0)))
        order = np.argsort(low[:, axis], kind="stable")
        low, high = low[order], high[order]
        last = np.searchsorted(low[:, axis], high[:, axis], side="right")
        first = np.arange(len(order)) + 1
        begin = 0
        while begin < len(order):
            total = np.cumsum(np.maximum(last[begin:] - first[begin:], 0))
            end = begin + max(1, int(np.searchsorted(total, _AT_ONCE)))
            rows = np.arange(begin, min(end, len(order)))
            counts = np.maximum(last[rows] - first[rows], 0)
            i = np.repeat(rows, counts)
            j = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + np.repeat(first[rows], counts)
            meet = (low[i] <= high[j]).all(axis=1) & (low[j] <= high[i]).all(axis=1)
            yield order[i[meet]], order[j[meet]]
            begin = end

    # where points lie

    def distance(self, x: np.ndarray, reach: float = math.inf) -> np.ndarray:
        """Compute the distance from the nearest triangle.

        Args:
            x: Points [m], shape [n, 3].
            reach: Distance up to which results are exact [m]; a smaller reach takes less time.

        Returns:
            Distances [m], shape [n]; further away any number that exceeds `reach`.
        """
        if 0 < reach < _SHORT * float(np.linalg.norm(self.bounds.size)):
            return self._close(x, reach)
        distances = np.empty(len(x))
        self._nearest(x, np.arange(len(x)), np.arange(len(self._balls[1])), distances, reach)
        return distances

    def _close(self, x: np.ndarray, reach: float) -> np.ndarray:
        """Distances [m] as `distance` gives them, by a grid that lists the triangles near each of its cells."""
        if len(x) > _POINTS:
            return np.concatenate([self._close(x[k : k + _POINTS], reach) for k in range(0, len(x), _POINTS)])
        grid = self._grids.get(reach)
        if grid is None:
            if len(self._grids) == _GRIDS:
                self._grids.clear()
            pieces, owners = self._pieces
            wide = reach * _SLACK
            grid = Cells.over(pieces.min(axis=1) - wide, pieces.max(axis=1) + wide, 2 * reach, owners)
            self._grids[reach] = grid
        point, triangle = grid.near(x)
        # most triangles that a cell lists are far from the point: their planes tell
        above = np.abs(_dot(x[point] - self.corner_positions[triangle, 0], self.normals[triangle]))
        point, triangle = (pairs[above <= reach * _PLANE_SLACK] for pairs in (point, triangle))
        distances = np.full(len(x), _BEYOND * reach)
        if len(point):
            first = np.flatnonzero(np.diff(point, prepend=-1))
            least = np.minimum.reduceat(self.apart(x[point], triangle), first)
            distances[point[first]] = np.where(least <= reach, least, _BEYOND * reach)
        return distances

    @cached_property
    def _grids(self) -> dict[float, Cells]:
        """Grids of `_close`, by reach."""
        return {}

    @cached_property
    def _pieces(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners of pieces of triangles [m], shape [k, 3, 3], and the numbers of the triangles.

        Long triangles are cut into pieces, as the ball around a whole one would have most points near it.
        """
        pieces, owners = self.corner_positions, np.arange(len(self.corner_positions))
        largest = float(np.linalg.norm(self.bounds.size)) / _PIECES
        small: list[tuple[np.ndarray, np.ndarray]] = []
        while len(pieces):
            done = _radii(pieces) <= largest
            small.append((pieces[done], owners[done]))
            pieces, owners = _halves(pieces[~done]), np.tile(owners[~done], 2)
        pieces, owners = (np.concatenate(column) for column in zip(*small, strict=True))
        return pieces, owners

    @cached_property
    def _balls(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Balls that hold pieces of triangles: centroids [m], shape [m, 3], radii [m], and numbers of the triangles."""
        pieces, owners = self._pieces
        return pieces.mean(axis=1), _radii(pieces), owners

    def _nearest(
        self, x: np.ndarray, rows: np.ndarray, candidates: np.ndarray, distances: np.ndarray, reach: float
    ) -> None:  # fmt: skip
        """Fill in the distances of the points `rows`; those of smaller boxes of points have fewer candidates."""
        from scipy.spatial.distance import cdist

        if not len(rows):
            return
        low, high = x[rows].min(axis=0), x[rows].max(axis=0)
        middle, half = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
        centres, radii, owners = self._balls
        gaps = np.linalg.norm(centres[candidates] - middle, axis=1)
        if (least := float((gaps - radii[candidates]).min()) - half) > reach:
            distances[rows] = least
            return
        # a centroid lies on its triangle, so that its distance is a bound from above
        candidates = candidates[gaps - radii[candidates] <= (gaps.min() + 2 * half) * _SLACK]
        if len(rows) * len(candidates) > _AT_ONCE and len(rows) > 1 and half > 0:
            octant = (x[rows] > middle) @ np.array([1, 2, 4])
            for k in range(8):
                self._nearest(x, rows[octant == k], candidates, distances, reach)
            return
        gaps = cdist(x[rows], centres[candidates])
        bounds = (gaps - radii[candidates]).min(axis=1)
        distances[rows] = bounds
        rows, gaps = rows[bounds <= reach], gaps[bounds <= reach]
        if not len(rows):
            return
        close = gaps - radii[candidates] <= gaps.min(axis=1)[:, None] * _SLACK
        point, piece = np.nonzero(close)
        point, triangle = np.divmod(np.unique(point * len(self.corners) + owners[candidates[piece]]), len(self.corners))
        first = np.searchsorted(point, np.arange(len(rows)))
        distances[rows] = np.minimum.reduceat(self.apart(x[rows[point]], triangle), first)

    def apart(self, x: np.ndarray, triangle: np.ndarray) -> np.ndarray:
        """Distance [m] of each point of x, shape [n, 3], from a triangle of its own, shape [n]."""
        corners, normal = self.corner_positions[triangle], self.normals[triangle]
        best, inside = np.full(len(x), np.inf), np.ones(len(x), bool)
        for c in range(3):
            p, side = corners[:, c], corners[:, (c + 1) % 3] - corners[:, c]
            r = x - p
            inward = np.cross(normal, side)
            inside &= _dot(r, inward) * np.sign(_dot(corners[:, (c + 2) % 3] - p, inward)) >= 0
            r = r - np.clip(_dot(r, side) / _dot(side, side), 0, 1)[:, None] * side
            best = np.minimum(best, _dot(r, r))
        return np.where(inside, np.abs(_dot(x - corners[:, 0], normal)), np.sqrt(best))

    def crossings(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Count the triangles straight above and straight below points.

        A vertical line through an edge or a vertex counts as passing on one side of it: which, follows from the same
        numbers for all triangles there, so that a line meets a closed surface an even number of times.

        Args:
            x: Points [m], shape [n, 3].

        Returns:
            Numbers of triangles above and below, each of shape [n].
        """
        # complex numbers are sorted by two coordinates, and faster than rows
        columns, of = np.unique(x[:, 0] + 1j * x[:, 1], return_inverse=True)
        order, points = np.argsort(of, kind="stable"), np.bincount(of)
        column, z = self._pierced(np.column_stack([columns.real, columns.imag]))
        first, count = (np.cumsum(points) - points)[column], points[column]
        row = order[ranges(first, count)]
        gap = np.repeat(z, count) - x[row, 2]
        above, below = (np.bincount(row[part], minlength=len(x)) for part in (gap > 0, gap < 0))
        return above, below

    def _pierced(self, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lines of those that are vertical at `columns`, shape [k, 2], and heights z [m] at which they meet a triangle,
        each of shape [hits]."""
        if len(columns) > _POINTS:
            parts = [(k, *self._pierced(columns[k : k + _POINTS])) for k in range(0, len(columns), _POINTS)]
            return np.concatenate([k + line for k, line, _ in parts]), np.concatenate([z for _, _, z in parts])
        line, triangle = self._from_above.near(columns)
        p, q = columns[line], self.corner_positions[triangle]
        near = ((p >= q[:, :, :2].min(axis=1)) & (p <= q[:, :, :2].max(axis=1))).all(axis=1)
        line, p, q = line[near], p[near], q[near]
        # corners ascend, so that triangles see an edge between them from the same end
        sides = [_left(q[:, a], q[:, b], p) for a, b in ((0, 1), (1, 2), (0, 2))]
        hit = (sides[0] == sides[1]) & (sides[0] != sides[2])
        line, p, q = line[hit], p[hit], q[hit]
        normal = np.cross(q[:, 1] - q[:, 0], q[:, 2] - q[:, 0])
        lean = _dot(p - q[:, 0, :2], normal[:, :2]) / normal[:, 2]
        return line, np.clip(q[:, 0, 2] - lean, q[:, :, 2].min(axis=1), q[:, :, 2].max(axis=1))

    @cached_property
    def _from_above(self) -> Cells:
        """Grid of the boxes around triangles seen from above."""
        places = self.corner_positions[:, :, :2]
        low, high = places.min(axis=1), places.max(axis=1)
        least = float(np.linalg.norm(np.ptp(self.vertices, axis=0))) / _ACROSS
        return Cells.over(low, high, max(least, float((high - low).mean()) / 4))

    def inside(self, x: np.ndarray) -> np.ndarray:
        """Select points within the closed surface: those with an odd number of triangles straight above.

        Args:
            x: Points [m], shape [n, 3].

        Returns:
            Mask, shape [n].
        """
        return self.crossings(x)[0] % 2 == 1

    def moved(self, by: Callable[[np.ndarray], np.ndarray]) -> "Triangles":
        """Map the vertices.

        Args:
            by: Map of places [m], shape [n, 3], that is one to one.

        Returns:
            Surface with the same triangles.
        """
        positions = by(self.vertices) + 0.0
        order = np.lexsort(positions.T[::-1])
        index = np.empty(len(order), np.int64)
        index[order] = np.arange(len(order))
        corners = np.sort(index[self.corners], axis=1)
        return Triangles(positions[order], corners[np.lexsort(corners.T[::-1])])


def _radii(pieces: np.ndarray) -> np.ndarray:
    """Radii [m] of the balls about the centroids of triangles, shape [n, 3, 3], that hold them."""
    return np.linalg.norm(pieces - pieces.mean(axis=1)[:, None], axis=2).max(axis=1)


def _halves(corners: np.ndarray) -> np.ndarray:
    """Cut triangles, shape [n, 3, 3], at the middle of their longest sides: first halves and then second ones."""
    rows = np.arange(len(corners))
    longest = np.argmax(np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2), axis=1)
    p, q, r = (corners[rows, (longest + k) % 3] for k in range(3))
    middle = (p + q) / 2
    return np.concatenate([np.stack([p, middle, r], axis=1), np.stack([middle, q, r], axis=1)])


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("nk,nk->n", a, b)


def _left(a: np.ndarray, b: np.ndarray, p: np.ndarray) -> np.ndarray:
    """True for points p, shape [n, 2], on the left of the line from a to b seen from above, or on it."""
    return (b[:, 0] - a[:, 0]) * (p[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (p[:, 0] - a[:, 0]) >= 0


def turn(angles: tuple[float, float, float]) -> np.ndarray:
    """Compute the matrix [3, 3] of rotations about x, then y, then z, by `angles` [rad]; exact for quarter turns."""
    matrix = np.eye(3)
    for axis, angle in enumerate(angles):
        quarters = angle / (math.pi / 2)
        exact = abs(quarters - round(quarters)) < 1e-12
        cos, sin = (
            ((1, 0), (0, 1), (-1, 0), (0, -1))[round(quarters) % 4] if exact else (math.cos(angle), math.sin(angle))
        )
        about = np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        about[[i, i, j, j], [i, j, i, j]] = cos, -sin, sin, cos
        matrix = about @ matrix
    return matrix
