"""Contacts of spheres with walls of triangles, for all backends.

A sphere touches a surface at every point at which its distance from the centre has a local minimum below the radius.
So each *feature* (a face, an edge, a vertex) decides alone, by conditions on where the centre x lies: with p a point of
a line and d a direction, (x - p) . d is positive or not.

* face: on the inner side of its three edges, by unit vectors t within the face
* edge from p to q along l: between its ends, and on the inner side of none of its triangles
* vertex: not along any of its edges

The conditions of neighbours hold the same numbers, so that they decide from the same bits. Where the foot of the
centre lies on an edge or vertex to round-off, both sides or none would count. So conditions hold within 1e-5 R, and
contacts whose points are less than 1e-3 R apart are one, the deepest. At a needle, whose sides meet at a small angle, a
place beyond the tip is that close to both sides: there conditions hold within a smaller distance.

Springs belong to features: a contact takes over that of the contact of the same grain that ended in this step on a
feature with a vertex in common, as where a grain rolls over the edge of a triangle.

Evaluating each triangle alone would count an edge once for each of its triangles, and skipping neighbours that have
been seen would make forces depend on the order of triangles.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from labbook.scene import TriangleMesh
from labbook.scene.cells import ranges
from labbook.scene.model import once
from labbook.scene.triangles import Triangles
from labbook_dem.words import dot, func, kernel, sqrt, wide, wide3

MESH_CONTACTS = 8
"""Contacts of a grain with one mesh, at most; each has a place for its spring."""
OVER = -1
"""Number of contacts where there are more."""
# columns of a feature: kind, patch, first condition and behind the last, a point and a unit vector, its vertices
# (from the last on), and before these the part of 1e-5 R within which its conditions hold
F_KIND, F_PATCH, F_FIRST, F_LAST, F_POINT, F_UNIT, F_SLACK, F_VERTICES = 0, 1, 2, 3, 4, 7, 10, 11
FEATURE_COLUMNS = 14
FACE, EDGE, VERTEX = 0, 1, 2
# columns of a condition: a point, a direction, and 1 or -1 for positive or not
C_POINT, C_ALONG, C_SENSE = 0, 3, 6
CONDITION_COLUMNS = 7
# columns of a contact: feature, overlap [m], unit normal, index of its spring, and 1 if the spring is an older one;
# of a rod, where on the segment it is [m]
K_FEATURE, K_OVERLAP, K_NORMAL, K_SPRING, K_OLDER, K_ALONG = 0, 1, 2, 5, 6, 7
CONTACT_ROWS, CONTACT_COLUMNS = 3 * MESH_CONTACTS, 8
SPHERE_ROWS = 2 * MESH_CONTACTS
"""Rows of contacts that spheres need."""
SPRING_KEY = 3
"""Column of a row of springs that holds the feature."""
_FLAT = 1e-6  # |t x t'| of two triangles in one plane
_NONE = -1.0
_NEEDLE = 0.01
"""Sine of half the sharpest angle of a triangle, below which it is a needle."""


@func
def mesh_vector(table: np.ndarray, row: int, column: int):
    """The vector that starts at a column of a row."""
    return wide3(table[row, column], table[row, column + 1], table[row, column + 2])


@func
def mesh_away(features: np.ndarray, f: int, x: wide3):
    """Vector [m] to x from the nearest point of the plane, the line or the point of feature f."""
    r = x - mesh_vector(features, f, F_POINT)
    unit = mesh_vector(features, f, F_UNIT)
    along = unit * dot(r, unit)
    kind = int(features[f, F_KIND])
    return along if kind == FACE else r - along


@func
def mesh_beyond(conditions: np.ndarray, c: int, x: wide3):
    """Distance [m] by which condition c holds at x."""
    r = x - mesh_vector(conditions, c, C_POINT)
    return dot(r, mesh_vector(conditions, c, C_ALONG)) * conditions[c, C_SENSE]


@func
def mesh_holds(features: np.ndarray, conditions: np.ndarray, f: int, x: wide3, within: wide):
    """True if the conditions of feature f hold at x, or would within a distance [m]."""
    c = int(features[f, F_FIRST])
    if int(features[f, F_KIND]) == FACE:  # all three, without a branch for each
        least = min(mesh_beyond(conditions, c, x), mesh_beyond(conditions, c + 1, x))
        return min(least, mesh_beyond(conditions, c + 2, x)) > -within
    for k in range(c, int(features[f, F_LAST])):
        if not mesh_beyond(conditions, k, x) > -within:
            return False
    return True


@kernel
def mesh_near(features: np.ndarray, conditions: np.ndarray, f: int, x: wide3, radius: wide, moves: wide):
    """True if a sphere at x may touch feature f before it has moved by a distance [m]."""
    away = mesh_away(features, f, x)
    reach = radius + moves
    return dot(away, away) < reach * reach and mesh_holds(features, conditions, f, x, wide(1e-5) * radius + moves)


@kernel
def mesh_listed(features: np.ndarray, conditions: np.ndarray, f: int, x: wide3, moves: wide):
    """Entry of a list for feature f near a sphere at x: -1 - f if its conditions hold until the sphere has moved by a
    distance [m], so that nobody has to look; else f."""
    return -1 - f if mesh_holds(features, conditions, f, x, -moves) else f


@func
def mesh_within(away: wide3, radius: wide):
    """True if the vector that `mesh_away` gives is shorter than a radius [m]."""
    return dot(away, away) < radius * radius


@func
def mesh_normal(away: wide3):
    """Length [m] and direction of the vector that `mesh_away` gives."""
    distance = sqrt(dot(away, away))
    inverse = wide(1.0) / distance if distance > wide(0.0) else wide(0.0)
    return distance, away * inverse


@func
def mesh_put(contacts: np.ndarray, count: int, f: int, overlap: wide, normal: wide3, radius: wide):
    """Add a contact to the `count` ones, or let the deeper of two at one place stay; how many there are, OVER if there
    is no room."""
    for k in range(count):
        there = mesh_vector(contacts, k, K_NORMAL) * (radius - contacts[k, K_OVERLAP])
        apart = there - normal * (radius - overlap)
        if dot(apart, apart) < wide(1e-6) * radius * radius:
            if not overlap > contacts[k, K_OVERLAP]:
                return count
            mesh_write(contacts, k, f, overlap, normal)
            return count
    if count == MESH_CONTACTS:
        return OVER
    mesh_write(contacts, count, f, overlap, normal)
    return count + 1


@func
def mesh_write(contacts: np.ndarray, k: int, f: int, overlap: wide, normal: wide3):
    """Write contact k."""
    contacts[k, K_FEATURE] = wide(f)
    contacts[k, K_OVERLAP] = overlap
    contacts[k, K_NORMAL] = normal.x
    contacts[k, K_NORMAL + 1] = normal.y
    contacts[k, K_NORMAL + 2] = normal.z


@func
def mesh_contacts(
    features: np.ndarray, conditions: np.ndarray, near: np.ndarray, first: int, last: int, x: wide3, radius: wide,
    contacts: np.ndarray,
):  # fmt: skip
    """Contacts of a sphere at x with the features near[first:last], ascending, as numbers or as `mesh_listed` gives
    them; how many, OVER if there is no room.

    Those of one smooth patch, whose normals differ by less than 45 deg, form one: of the largest overlap, along
    the sum of their normals weighted by overlaps.
    """
    count = int(0)
    smooth = bool(False)
    for k in range(first, last):
        entry = int(near[k])
        f = max(entry, -1 - entry)
        away = mesh_away(features, f, x)
        touches = mesh_within(away, radius)
        if touches and entry >= 0:
            touches = mesh_holds(features, conditions, f, x, wide(1e-5) * radius * features[f, F_SLACK])
        if touches:
            distance, normal = mesh_normal(away)
            count = mesh_put(contacts, count, f, radius - distance, normal, radius)
            if count == OVER:
                return OVER
            smooth = smooth or features[f, F_PATCH] >= wide(0.0)
    if smooth and count > 1:
        return mesh_merged(features, contacts, count)
    return count


@kernel
def mesh_merged(features: np.ndarray, contacts: np.ndarray, count: int):
    """Unite contacts of smooth patches; how many are left, the deepest first."""
    left = int(0)
    for k in range(count):
        contacts[k, K_SPRING] = wide(0.0)
    for _ in range(count):
        deepest = int(-1)
        for k in range(count):
            if contacts[k, K_SPRING] == wide(0.0) and (
                deepest < 0 or contacts[k, K_OVERLAP] > contacts[max(deepest, 0), K_OVERLAP]
            ):
                deepest = k
        if deepest >= 0:
            normal = mesh_vector(contacts, deepest, K_NORMAL)
            total = wide3(wide(0.0), wide(0.0), wide(0.0))
            patch = features[int(contacts[deepest, K_FEATURE]), F_PATCH]
            for k in range(count):
                own = mesh_vector(contacts, k, K_NORMAL)
                unites = patch >= wide(0.0) and features[int(contacts[k, K_FEATURE]), F_PATCH] == patch
                joins = k == deepest or (unites and dot(own, normal) > wide(0.70710678))
                if contacts[k, K_SPRING] == wide(0.0) and joins:
                    total = total + own * contacts[k, K_OVERLAP]
                    contacts[k, K_SPRING] = wide(1.0)
            size = sqrt(dot(total, total))
            mesh_write(
                contacts, MESH_CONTACTS + left, int(contacts[deepest, K_FEATURE]), contacts[deepest, K_OVERLAP],
                total * (wide(1.0) / size),
            )  # fmt: skip
            left += 1
    for k in range(left):
        for column in range(K_SPRING):
            contacts[k, column] = contacts[MESH_CONTACTS + k, column]
    return left


@func
def mesh_meet(features: np.ndarray, f: int, g: int):
    """True for two features with a vertex in common."""
    a, b, c = features[f, F_VERTICES], features[f, F_VERTICES + 1], features[f, F_VERTICES + 2]
    p, q, r = features[g, F_VERTICES], features[g, F_VERTICES + 1], features[g, F_VERTICES + 2]
    meets_a = a == p or a == q or a == r
    meets_b = b == p or b == q or b == r
    return meets_a or meets_b or c == p or c == q or c == r


@func
def mesh_springs(
    features: np.ndarray, contacts: np.ndarray, count: int, held_bits: int, spring: np.ndarray, base: int
):  # fmt: skip
    """Give each contact the index of its spring among the rows of `spring` from `base` on; which are held now.

    held_bits: a bit for each index with a spring, whose feature stands in column SPRING_KEY.
    """
    now = int(0)
    for k in range(count):
        contacts[k, K_SPRING] = wide(-1.0)
        contacts[k, K_OLDER] = wide(0.0)
        index = int(0)
        while held_bits >> index != 0:
            if (held_bits >> index) & 1 != 0 and spring[base + index, SPRING_KEY] == contacts[k, K_FEATURE]:
                contacts[k, K_SPRING] = wide(index)
                contacts[k, K_OLDER] = wide(1.0)
                now = now | (1 << index)
            index += 1
    for k in range(count):
        if contacts[k, K_SPRING] < wide(0.0):
            inherited = int(-1)
            ended = held_bits & ~now
            index = int(0)
            while ended >> index != 0:
                if (ended >> index) & 1 != 0:
                    older = spring[base + index, SPRING_KEY]
                    met = mesh_meet(features, int(contacts[k, K_FEATURE]), int(older))
                    if met and (inherited < 0 or older < spring[base + max(inherited, 0), SPRING_KEY]):
                        inherited = int(index)
                index += 1
            if inherited >= 0:
                contacts[k, K_SPRING] = wide(inherited)
                contacts[k, K_OLDER] = wide(1.0)
                now = now | (1 << inherited)
    for k in range(count):
        if contacts[k, K_SPRING] < wide(0.0):
            free = int(0)
            while (now >> free) & 1 != 0:
                free += 1
            contacts[k, K_SPRING] = wide(free)
            now = now | (1 << free)
    return now


@kernel
def mesh_cell(frame: np.ndarray, w: int, x: wide3):
    """The cell that holds x in the grid of a mesh, whose frame is in row w; -1 outside of it, where nothing is near."""
    a = (x.x - frame[w, 0]) * frame[w, 3]
    b = (x.y - frame[w, 1]) * frame[w, 3]
    c = (x.z - frame[w, 2]) * frame[w, 3]
    zero = wide(0.0)
    if not (a >= zero and b >= zero and c >= zero and a < frame[w, 4] and b < frame[w, 5] and c < frame[w, 6]):
        return -1
    return int(frame[w, 7]) + (int(a) * int(frame[w, 5]) + int(b)) * int(frame[w, 6]) + int(c)


# the host's


class MeshTable(NamedTuple):
    """Features of a surface and their conditions.

    Attributes:
        features: Shape [n, FEATURE_COLUMNS]: all faces, edges that are no part of a plane, vertices of these.
        conditions: Of all features, shape [c, CONDITION_COLUMNS].
        low: Lower corners of boxes around the features [m], shape [n, 3].
        high: Upper corners [m].
    """

    features: np.ndarray
    conditions: np.ndarray
    low: np.ndarray
    high: np.ndarray


@once(16)
def mesh_table(shape: TriangleMesh) -> MeshTable:
    """Features of a mesh and the conditions for contacts with them."""
    surface = shape.surface
    vertices, corners = surface.vertices, surface.corners
    edges, of = surface.edges
    p, q = vertices[edges[:, 0]], vertices[edges[:, 1]]
    along = q - p
    along /= np.linalg.norm(along, axis=1)[:, None]
    inward = _inward(surface, along)
    order = np.argsort(of.ravel(), kind="stable")
    first = np.searchsorted(of.ravel()[order], np.arange(len(edges) + 1))
    triangle, side = np.divmod(order, 3)
    two = np.flatnonzero(np.diff(first) == 2)
    a, b = ((triangle[first[two] + k], side[first[two] + k]) for k in (0, 1))
    first_t, second_t = inward[a], inward[b]
    opposite = np.einsum("nk,nk->n", first_t, second_t) < 0
    flat = opposite & (np.linalg.norm(np.cross(first_t, second_t), axis=1) < _FLAT)
    inward[b[0][flat], b[1][flat]] = -first_t[flat]
    is_flat = np.zeros(len(edges), bool)
    is_flat[two[flat]] = True
    smooth = np.zeros(len(edges), bool)
    bend = np.arctan2(np.linalg.norm(np.cross(first_t, second_t), axis=1), -np.einsum("nk,nk->n", first_t, second_t))
    smooth[two] = bend <= shape.smooth * (1 + 1e-9)
    patch = _patches(len(corners), a[0], b[0], smooth[two]) if shape.smooth else np.full(len(corners), _NONE)

    bent = np.flatnonzero(~is_flat)
    tips = np.unique(edges[bent])
    by_vertex = np.argsort(edges.ravel(), kind="stable")
    begin = np.searchsorted(edges.ravel()[by_vertex], np.arange(len(vertices) + 1))
    degree, triangles = np.diff(begin)[tips], np.diff(first)[bent]
    end = by_vertex[ranges(begin[tips], degree)]  # of an edge at a tip
    edge, heading = end // 2, along[end // 2] * np.where(end % 2 == 0, 1.0, -1.0)[:, None]
    beside = ranges(first[bent], triangles)

    of_faces, of_edges, of_tips = np.split(
        np.arange(len(corners) + len(bent) + len(tips)), [len(corners), len(corners) + len(bent)]
    )
    tests = (
        (np.repeat(of_faces, 3), p[of.ravel()], inward.reshape(-1, 3), 1.0),
        (of_edges, p[bent], along[bent], 1.0),
        (of_edges, q[bent], -along[bent], 1.0),
        (
            np.repeat(of_edges, triangles),
            np.repeat(p[bent], triangles, 0),
            inward[triangle[beside], side[beside]],
            -1.0,
        ),
        (np.repeat(of_tips, degree), np.repeat(vertices[tips], degree, 0), heading, -1.0),
    )
    rows = np.concatenate([row for row, *_ in tests])
    conditions = np.concatenate([np.column_stack([at, d, np.full(len(at), sense)]) for _, at, d, sense in tests])
    count = np.bincount(rows)

    rough = np.bincount(np.repeat(np.arange(len(tips)), degree), ~smooth[edge], len(tips)) > 0
    patches = (
        patch,
        np.where(smooth, patch[triangle[first[:-1]]], _NONE)[bent],
        np.where(rough, _NONE, patch[triangle[first[edge[np.cumsum(degree) - degree]]]]),
    )
    features = np.empty((len(count), FEATURE_COLUMNS))
    features[:, F_KIND] = np.repeat([FACE, EDGE, VERTEX], [len(corners), len(bent), len(tips)])
    features[:, F_PATCH] = np.concatenate(patches)
    features[:, F_LAST] = np.cumsum(count)
    features[:, F_FIRST] = features[:, F_LAST] - count
    features[:, F_POINT:F_UNIT] = np.concatenate([vertices[corners[:, 0]], p[bent], vertices[tips]])
    features[:, F_UNIT:F_SLACK] = np.concatenate([surface.normals, along[bent], np.zeros((len(tips), 3))])
    features[:, F_SLACK] = 1.0
    features[: len(corners), F_SLACK] = _slack(surface)
    names = np.concatenate([corners, edges[bent][:, [0, 1, 1]], np.repeat(tips[:, None], 3, axis=1)])
    features[:, F_VERTICES:] = names
    low, high = vertices[names].min(axis=1), vertices[names].max(axis=1)
    return MeshTable(features, conditions[np.argsort(rows, kind="stable")], low, high)


def _inward(surface: Triangles, along: np.ndarray) -> np.ndarray:
    """Of side s of triangle k, the unit vector within it, perpendicular to that side and into it, shape [m, 3, 3]."""
    edges, of = surface.edges
    opposite = surface.corner_positions - surface.vertices[edges[of, 0]]
    l = along[of]
    t = opposite - np.einsum("msk,msk->ms", opposite, l)[..., None] * l
    return t / np.linalg.norm(t, axis=2)[..., None]


def _slack(surface: Triangles) -> np.ndarray:
    """Part of 1e-5 R within which the conditions of each face hold, shape [m].

    At a corner of angle a, conditions that hold within w reach w / sin(a/2) beyond it: at most 1e-3 R with this part.
    """
    sides = np.roll(surface.corner_positions, -1, axis=1) - surface.corner_positions
    back = -np.roll(sides, 1, axis=1)
    across, along = np.linalg.norm(np.cross(sides, back), axis=2), np.einsum("msk,msk->ms", sides, back)
    sharpest = np.arctan2(across, along).min(axis=1)
    return np.minimum(1.0, np.sin(sharpest / 2) / _NEEDLE)


def _patches(triangles: int, left: np.ndarray, right: np.ndarray, joined: np.ndarray) -> np.ndarray:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(joined.sum()), (left[joined], right[joined])), shape=(triangles,) * 2)
    return connected_components(links, directed=False)[1].astype(float)


def spring_places(entry: np.ndarray) -> np.ndarray:
    """Places of springs of a packing: of each, how many of the same entry of a list come before it, shape as `entry`.
    Raises ValueError where an entry has more than MESH_CONTACTS."""
    order = np.argsort(entry, kind="stable")
    first = np.searchsorted(entry[order], entry[order])
    before = np.empty(len(entry), np.int64)
    before[order] = np.arange(len(entry)) - first
    if before.max(initial=0) >= MESH_CONTACTS:
        raise ValueError(f"the packing has more than {MESH_CONTACTS} springs of a grain at a mesh")
    return before


class TooManyContacts(ArithmeticError):
    """A grain has more than MESH_CONTACTS contacts with a mesh."""


class PlainMesh:
    """A mesh in plain Python, for spheres, or with the table of `labbook_dem.mesh_rods` for rods."""

    def __init__(self, shape: TriangleMesh, table: MeshTable | None = None):
        self.shape, self.table = shape, table or mesh_table(shape)
        self._contacts = np.zeros((CONTACT_ROWS, CONTACT_COLUMNS))

    def distance(self, x: wide3) -> tuple[float, wide3]:
        """Distance [m] of the point x; the normal is of no meaning."""
        surface, at = self.shape.surface, np.array([x.x, x.y, x.z])
        every = np.arange(len(surface.corners))
        return float(surface.apart(np.tile(at, (len(every), 1)), every).min()), wide3(0.0, 0.0, 0.0)

    def contacts(self, x: wide3, radius: float, features: list[int]) -> Iterator[tuple[int, float, wide3, int | None]]:
        """Contacts of a sphere at x: feature, distance [m], unit normal, and the feature whose spring it has, of those
        in `features`; None for a new one. Raises TooManyContacts."""
        near = self.near(x, radius)
        count = mesh_contacts(*self.table[:2], near, 0, len(near), x, radius, self._contacts)
        for feature, distance, normal, _, older in self.with_springs(count, radius, features):
            yield feature, distance, normal, older

    def near(self, x: wide3, reach: float) -> np.ndarray:
        """Features whose plane, line or point is within a reach [m] of x, ascending."""
        table, at = self.table, np.array([x.x, x.y, x.z])
        r = at - table.features[:, F_POINT : F_POINT + 3]
        unit = table.features[:, F_UNIT : F_UNIT + 3]
        along = np.einsum("nk,nk->n", r, unit)
        face = table.features[:, F_KIND] == FACE
        away = np.where(face, np.abs(along), np.linalg.norm(r - along[:, None] * unit, axis=1))
        return np.flatnonzero(away < 1.001 * reach)

    @property
    def rows(self) -> np.ndarray:
        """Room for contacts, which `with_springs` reads."""
        return self._contacts

    def with_springs(
        self, count: int, radius: float, features: list[int]
    ) -> Iterator[tuple[int, float, wide3, float, int | None]]:
        """The first `count` contacts of `rows`, as `contacts` gives them, with the place on the segment [m] of each,
        before the spring. Raises TooManyContacts."""
        if count == OVER:
            raise TooManyContacts(TOO_MANY)
        springs = np.zeros((MESH_CONTACTS, SPRING_KEY + 1))
        springs[: len(features), SPRING_KEY] = features
        mesh_springs(self.table.features, self._contacts, count, (1 << len(features)) - 1, springs, 0)
        for row in self._contacts[:count]:
            older = features[int(row[K_SPRING])] if row[K_OLDER] else None
            normal = wide3(*row[K_NORMAL : K_NORMAL + 3].tolist())
            yield int(row[K_FEATURE]), radius - float(row[K_OVERLAP]), normal, float(row[K_ALONG]), older


TOO_MANY = (
    f"a grain touches a mesh at more than {MESH_CONTACTS} places; state smooth of the part, "
    "or unite triangles much smaller than a grain"
)
