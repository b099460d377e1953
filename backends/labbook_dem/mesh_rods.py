"""Contacts of rods with walls of triangles, for all backends.

The ends of a rod touch faces, edges and vertices as spheres do (`labbook_dem.mesh`). Between them a rod touches edges
and vertices only. There its overlap counts as far as it exceeds the line between the overlaps of the ends along the
same normal, and a contact is a local maximum of this excess. So an end that passes the edge of a plate hands its load
over to the edge, a rod that lies flat on triangles has its two ends as contacts, as on a plane, and the force is
continuous. Without an overlap at the ends the rule is that of spheres: a local minimum of the distance.

Each part of a rod, the end at -h, that at +h and what lies between, has contacts and springs of its own. So rods see a
table in which each feature stands ROD_PARTS times, with vertices of its own, and a contact's feature tells its part.
"""

from collections.abc import Iterator

import numpy as np

from labbook.scene import TriangleMesh
from labbook.scene.model import once
from labbook_dem.mesh import (
    C_ALONG,
    C_POINT,
    C_SENSE,
    CONTACT_ROWS,
    F_FIRST,
    F_KIND,
    F_LAST,
    F_UNIT,
    F_VERTICES,
    FACE,
    K_ALONG,
    K_FEATURE,
    K_NORMAL,
    K_OVERLAP,
    K_SPRING,
    MESH_CONTACTS,
    OVER,
    MeshTable,
    PlainMesh,
    mesh_away,
    mesh_contacts,
    mesh_holds,
    mesh_near,
    mesh_table,
    mesh_vector,
    mesh_write,
)
from labbook_dem.words import dot, kernel, sqrt, wide, wide3

ROD_PARTS = 3
"""Parts of a rod that touch a mesh each for itself."""
BETWEEN = 2
"""The part between the ends."""


@kernel
def mesh_rod_near(
    features: np.ndarray, conditions: np.ndarray, f: int, x: wide3, a: wide3, half: wide, radius: wide, moves: wide
):  # fmt: skip
    """True if a rod at x along the unit vector a may touch feature f before a point of it has moved by a distance [m].

    An edge or a vertex is near if it is so of a point of the segment whose conditions hold, or would within `moves`:
    these points are a stretch of the segment.
    """
    if mesh_near(features, conditions, f, x - a * half, radius, moves):
        return True
    if mesh_near(features, conditions, f, x + a * half, radius, moves):
        return True
    if int(features[f, F_KIND]) == FACE:
        return False
    within = wide(1e-5) * radius + moves
    low = wide(-half)
    high = wide(half)
    for c in range(int(features[f, F_FIRST]), int(features[f, F_LAST])):
        direction = mesh_vector(conditions, c, C_ALONG) * conditions[c, C_SENSE]
        at = dot(x - mesh_vector(conditions, c, C_POINT), direction) + within
        slope = dot(a, direction)
        if slope > wide(0.0):
            low = max(low, -at / slope)
        elif slope < wide(0.0):
            high = min(high, -at / slope)
        elif not at > wide(0.0):
            return False
    if not low <= high:
        return False
    away = mesh_away(features, f, x)
    unit = mesh_vector(features, f, F_UNIT)
    across = a - unit * dot(a, unit)
    sin2 = dot(across, across)
    s = min(max(-dot(away, across) / sin2, low), high) if sin2 > wide(0.0) else low
    away = away + across * s
    reach = radius + moves
    return dot(away, away) < reach * reach


@kernel
def mesh_between(
    features: np.ndarray, conditions: np.ndarray, f: int, x: wide3, a: wide3, half: wide, radius: wide,
    contacts: np.ndarray, ends: int,
):  # fmt: skip
    """Place on the segment at which the edge or vertex f has a contact [m], its overlap beyond what the ends carry [m],
    and the unit normal; the overlap is negative where there is none.

    The first `ends` contacts are those of the ends. With D the distance of the lines, or of the vertex from the line,
    and k the sine of their angle, or 1, the distance is sqrt(D^2 + k^2 t^2) at t from their closest points, and the
    line between the ends has the slope m: the excess is largest at t = -m D/(k sqrt(k^2 - m^2)).
    """
    none = wide(-1.0)
    away = mesh_away(features, f, x)
    unit = mesh_vector(features, f, F_UNIT)
    across = a - unit * dot(a, unit)
    sin2 = dot(across, across)
    if not sin2 > wide(0.0):
        return wide(0.0), none, away
    closest = -dot(away, across) / sin2
    least = away + across * closest
    distance = sqrt(dot(least, least))
    if not distance < radius:
        return wide(0.0), none, away
    low = wide(0.0)
    high = wide(0.0)
    for k in range(ends):
        along = dot(mesh_vector(contacts, k, K_NORMAL), least) / distance if distance > wide(0.0) else wide(0.0)
        carried = contacts[k, K_OVERLAP] * along
        if contacts[k, K_ALONG] > wide(0.0):
            high = max(high, carried)
        else:
            low = max(low, carried)
    slope = (high - low) / (half + half)
    steep = sin2 - slope * slope
    if not steep > wide(0.0):
        return wide(0.0), none, away
    s = closest - slope * distance / sqrt(sin2 * steep)
    if not (s > -half and s < half):
        return wide(0.0), none, away
    if not mesh_holds(features, conditions, f, x + a * s, wide(1e-5) * radius):
        return wide(0.0), none, away
    away = away + across * s
    distance = sqrt(dot(away, away))
    inverse = wide(1.0) / distance if distance > wide(0.0) else wide(0.0)
    return s, radius - distance - (low + slope * (s + half)), away * inverse


@kernel
def mesh_rod_contacts(
    features: np.ndarray, conditions: np.ndarray, near: np.ndarray, first: int, last: int, x: wide3, a: wide3,
    half: wide, radius: wide, contacts: np.ndarray,
):  # fmt: skip
    """Contacts of a rod at x along the unit vector a with the features near[first:last], ascending; how many, OVER if
    there is no room. K_ALONG of each: where on the segment it is [m]."""
    count = int(0)
    for part in range(2):
        s = -half if part == 0 else half
        here = int(0)
        if part == 0 or half > wide(0.0):
            here = mesh_contacts(features, conditions, near, first, last, x + a * s, radius, contacts)
        if here == OVER or count + here > MESH_CONTACTS:
            return OVER
        for k in range(here):
            row = CONTACT_ROWS - MESH_CONTACTS + count
            mesh_write(
                contacts, row, int(contacts[k, K_FEATURE]) + part, contacts[k, K_OVERLAP],
                mesh_vector(contacts, k, K_NORMAL),
            )  # fmt: skip
            contacts[row, K_ALONG] = s
            count += 1
    for k in range(count):
        row = CONTACT_ROWS - MESH_CONTACTS + k
        for column in range(K_SPRING):
            contacts[k, column] = contacts[row, column]
        contacts[k, K_ALONG] = contacts[row, K_ALONG]
    ends = int(count)
    for n in range(first, last):
        f = int(near[n])
        if int(features[f, F_KIND]) != FACE and half > wide(0.0):
            s, overlap, normal = mesh_between(features, conditions, f, x, a, half, radius, contacts, ends)
            target = int(count)
            if overlap > wide(0.0):
                for k in range(ends, count):
                    there = a * contacts[k, K_ALONG] - mesh_vector(contacts, k, K_NORMAL) * (
                        radius - contacts[k, K_OVERLAP]
                    )
                    apart = there - (a * s - normal * (radius - overlap))
                    if dot(apart, apart) < wide(1e-6) * radius * radius:
                        target = k
                if target == MESH_CONTACTS:
                    return OVER
                if target == count or overlap > contacts[target, K_OVERLAP]:
                    mesh_write(contacts, target, f + BETWEEN, overlap, normal)
                    contacts[target, K_ALONG] = s
                count = max(count, target + 1)
    return count


# the host's


@once(16)
def rod_table(shape: TriangleMesh) -> MeshTable:
    """Features of a mesh, each repeated for the parts of a rod with vertices of its own, so that springs stay with a
    part. Conditions are shared."""
    table = mesh_table(shape)
    features = np.repeat(table.features, ROD_PARTS, axis=0)
    part = np.arange(len(features)) % ROD_PARTS
    features[:, F_VERTICES:] = ROD_PARTS * features[:, F_VERTICES:] + part[:, None]
    low, high = (np.repeat(corner, ROD_PARTS, axis=0) for corner in (table.low, table.high))
    return MeshTable(features, table.conditions, low, high)


class PlainRodMesh(PlainMesh):
    """A mesh for rods in plain Python."""

    def __init__(self, shape: TriangleMesh):
        super().__init__(shape, rod_table(shape))

    def rod_contacts(
        self, x: wide3, a: wide3, half: float, radius: float, features: list[int]
    ) -> Iterator[tuple[int, float, wide3, float, int | None]]:
        """Contacts of a rod at x along the unit vector a: feature, distance [m], unit normal, where on the segment
        [m], and the feature whose spring it has, of those in `features`; None for a new one. Raises TooManyContacts."""
        near = self.near(x, radius + half)
        near = near[near % ROD_PARTS == 0]
        count = mesh_rod_contacts(*self.table[:2], near, 0, len(near), x, a, half, radius, self.rows)
        return self.with_springs(count, radius, features)
