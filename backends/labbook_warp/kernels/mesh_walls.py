"""Spheres at walls of which some are triangles: in place of `sphere_walls`, for scenes that have a mesh (`meshes`)."""

from __future__ import annotations

from labbook_dem.chosen import wall_distance
from labbook_dem.mesh import (
    K_FEATURE,
    K_NORMAL,
    K_OLDER,
    K_OVERLAP,
    K_SPRING,
    OVER,
    mesh_away,
    mesh_normal,
    mesh_vector,
    mesh_within,
)
from labbook_dem.words import FRICTION, ROLLING_SPRING, func, real, rounded, wide, wide3

from labbook_warp.kernels.bodies import body
from labbook_warp.kernels.meshes import contact_of_spring, is_mesh, mesh_parts_near, position_at, scratch, touched
from labbook_warp.kernels.parts import direction_in_space, velocity_before, velocity_of
from labbook_warp.kernels.spheres import Grain, at_surface, with_wall
from labbook_warp.kernels.sums import Contact, Sums, plus
from labbook_warp.kernels.system import Material, System, entry, has_bit
from labbook_warp.kernels.walls import wall_at
from labbook_warp.kernels.words import (
    CROWDED,
    FIRST_PARTS,
    LANES,
    MESH_LISTED,
    POSES,
    WALL_PARTS,
    first_bit,
    load_int,
    uint32,
    without_first,
    wp,
)


@func
def at_features(
    a: System, m: Material, wall: int, at: int, older: bool, g: Grain, overlap: wide, normal: wide3
):  # fmt: skip
    """The contact with a mesh at an overlap [m] along a unit normal in its frame; older: whether it has a spring at
    `at`."""
    distance = body(a, m, g.index).reach - overlap
    if POSES:
        normal = direction_in_space(a, wall, normal)
        g = relative(a, m, wall, g, g.x - normal * distance)
    return at_surface(a, m, wall, at, older, g, rounded(overlap), distance, normal)


@func
def relative(a: System, m: Material, wall: int, g: Grain, at: wide3):
    """The grain with velocities relative to a part that moves, at a point in space."""
    new = Grain()
    new.x = g.x
    new.v = g.v - velocity_before(a, m, wall, at)
    new.w = g.w
    new.u = g.u - velocity_of(a, wall, at)
    new.spin = g.spin
    new.index = g.index
    return new


@func
def alone(a: System, s: int, r: int, k: int, begin: int, held_springs: int):
    """The feature that is the only one near row r of a mesh, whose first entry is k, if its conditions hold and no
    spring but its own is held; else -1. begin: first feature of the mesh; held_springs: a bit for each held spring."""
    at = entry(a, s, a.seats, k // WALL_PARTS, r)
    feature = int(-1)
    if a.mesh_count[at] == 1:
        feature = -1 - a.mesh_near[at * MESH_LISTED]
        if held_springs > 1:
            feature = -1
        elif held_springs == 1:
            if begin + a.wall_feature[entry(a, s, a.seats * WALL_PARTS, k, r)] != feature:
                feature = -1
    return feature


@func
def at_mesh(
    a: System, m: Material, s: int, r: int, k: int, wall: int, g: Grain, old: uint32, sums: Sums, keep: bool
):  # fmt: skip
    """`sums` with the contacts with a mesh, whose first entry is k, and at which springs are held; old: were held."""
    bits = wp.uint32(0)
    begin = load_int(a.mesh_begin, load_int(a.mesh_of, wall))
    reach = body(a, m, g.index).reach
    contacts = a.mesh_contacts[scratch(a, s, r, k)]
    held_springs = int((old >> wp.uint32(k)) & wp.uint32((1 << WALL_PARTS) - 1))
    feature = alone(a, s, r, k, begin, held_springs)
    single = feature >= 0
    q = int(k)
    count = int(0)
    older = held_springs == 1
    overlap = wide(0.0)
    normal = wide3(wide(0.0), wide(0.0), wide(0.0))
    if single:  # most grains
        away = mesh_away(a.mesh_features, feature, position_at(a, wall, g.x))
        if mesh_within(away, reach):
            distance, direction = mesh_normal(away)
            overlap = reach - distance
            normal = direction
            count = 1
    else:
        count = touched(a, m, s, r, k, wall, old, g, contacts)
        if count == OVER:
            sums.deepest = real(CROWDED)
            bits = wp.uint32(1) << wp.uint32(k)
    for n in range(count):
        if not single:
            q = k + int(contacts[n, K_SPRING])
            feature = int(contacts[n, K_FEATURE])
            older = contacts[n, K_OLDER] > wide(0.0)
            overlap = contacts[n, K_OVERLAP]
            normal = mesh_vector(contacts, n, K_NORMAL)
        at = entry(a, s, a.seats * WALL_PARTS, q, r)
        c = at_features(a, m, wall, at, older, g, overlap, normal)
        if c.touches:
            sums = plus(sums, c, m)
            bits = bits | (wp.uint32(1) << wp.uint32(q))
            if keep:
                a.wall_feature[at] = feature - begin
            if FRICTION:
                if keep:
                    a.wall_spring[at] = c.spring
            if ROLLING_SPRING:
                if keep:
                    a.wall_rolling[at] = c.rolling
    return sums, bits


@func
def at_walls(
    a: System, m: Material, s: int, r: int, lane: int, g: Grain, near: uint32, old: uint32, sums: Sums, keep: bool
):  # fmt: skip
    """`sums` with the contacts with all walls that are `near`, and at which springs are held; old: were held."""
    bits = wp.uint32(0)
    near = without_first(near & wp.uint32(FIRST_PARTS), lane)
    while near != wp.uint32(0):
        k = first_bit(near)
        near = without_first(near, LANES)
        wall = wall_at(a, s, r, k // WALL_PARTS)
        if is_mesh(a, wall):
            sums, held_springs = at_mesh(a, m, s, r, k, wall, g, old, sums, keep)
            bits = bits | held_springs
        else:
            at = entry(a, s, a.seats * WALL_PARTS, k, r)
            c = with_wall(a, m, wall, at, has_bit(old, k), g)
            if c.touches:
                sums = plus(sums, c, m)
                bits = bits | (wp.uint32(1) << wp.uint32(k))
                if FRICTION:
                    if keep:
                        a.wall_spring[at] = c.spring
                if ROLLING_SPRING:
                    if keep:
                        a.wall_rolling[at] = c.rolling
    return sums, bits


@func
def at_wall(a: System, m: Material, s: int, r: int, k: int, near: uint32, old: uint32, g: Grain):
    """The contact of row r at entry k of its walls; `old`: at which springs are held."""
    wall = wall_at(a, s, r, k // WALL_PARTS)
    at = entry(a, s, a.seats * WALL_PARTS, k, r)
    c = Contact()
    if is_mesh(a, wall):
        contacts = a.mesh_contacts[scratch(a, s, r, k)]
        n = contact_of_spring(a, m, s, r, k, wall, old, g, contacts)
        if n >= 0:
            older = contacts[n, K_OLDER] > wide(0.0)
            normal = mesh_vector(contacts, n, K_NORMAL)
            c = at_features(a, m, wall, at, older, g, contacts[n, K_OVERLAP], normal)
    else:
        c = with_wall(a, m, wall, at, has_bit(old, k), g)
    return c


@func
def normal_at(a: System, m: Material, s: int, r: int, k: int, wall: int, near: uint32, g: Grain):
    """Unit normal from a wall to the grain, which touches it at entry k."""
    _distance, normal = wall_distance(a.wall_numbers, wall, load_int(a.wall_kind, wall), g.x)
    if is_mesh(a, wall):
        contacts = a.mesh_contacts[scratch(a, s, r, k)]
        n = contact_of_spring(a, m, s, r, k, wall, a.wall_held[g.index], g, contacts)
        normal = mesh_vector(contacts, max(n, 0), K_NORMAL)
        if POSES:
            normal = direction_in_space(a, wall, normal)
    return normal


@func
def parts_near(a: System, m: Material, g: Grain, wall: int):
    """The first entry of a wall, or all of a mesh, as bits, if the grain may touch it before its list is built again;
    else 0."""
    near = wp.uint32(0)
    if is_mesh(a, wall):
        near = mesh_parts_near(a, m, g.index, wall, g.x, g.x)
    else:
        distance, _normal = wall_distance(a.wall_numbers, wall, load_int(a.wall_kind, wall), g.x)
        if distance < body(a, m, g.index).reach + m.half_skin:
            near = wp.uint32(1)
    return near
