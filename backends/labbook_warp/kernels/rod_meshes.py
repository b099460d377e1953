"""Rods at walls of which some are triangles: in place of `rod_plates`, for scenes that have a mesh (`meshes`).

Threads that share a rod take whole walls: the contacts of a rod with a mesh follow from those of its ends.
"""

from __future__ import annotations

from labbook_dem.mesh import K_ALONG, K_FEATURE, K_NORMAL, K_OLDER, K_OVERLAP, K_SPRING, OVER, mesh_vector
from labbook_dem.words import FRICTION, func, real, wide, wide3

from labbook_warp.kernels.meshes import contact_of_spring, is_mesh, mesh_parts_near, scratch, touched
from labbook_warp.kernels.parts import direction_in_space, velocity_before, velocity_of
from labbook_warp.kernels.rod_contacts import at_plate, one_by_one, plate_normal, plate_parts, with_wall, without_walls
from labbook_warp.kernels.rods import Grain
from labbook_warp.kernels.sums import Contact, Sums, plus
from labbook_warp.kernels.system import Material, System, entry
from labbook_warp.kernels.walls import wall_at
from labbook_warp.kernels.words import (
    CROWDED,
    LANES,
    POSES,
    WALL_PARTS,
    Table,
    first_bit,
    load_int,
    uint32,
    wp,
)


@func
def relative(a: System, m: Material, wall: int, g: Grain, at: wide3):
    """The grain with velocities relative to a part that moves, at a point in space."""
    new = Grain()
    new.x = g.x
    new.axis = g.axis
    new.v = g.v - velocity_before(a, m, wall, at)
    new.spin = g.spin
    new.u = g.u - velocity_of(a, wall, at)
    new.predicted_spin = g.predicted_spin
    return new


@func
def normal_of(a: System, wall: int, contacts: Table, n: int):
    """Unit normal of contact n with a mesh, in space."""
    normal = mesh_vector(contacts, n, K_NORMAL)
    if POSES:
        normal = direction_in_space(a, wall, normal)
    return normal


@func
def at_features(a: System, m: Material, wall: int, at: int, g: Grain, contacts: Table, n: int):
    """Contact n of `contacts` with a mesh, whose spring stands at `at`."""
    distance = m.reach - contacts[n, K_OVERLAP]
    normal = normal_of(a, wall, contacts, n)
    s = contacts[n, K_ALONG]
    if POSES:
        g = relative(a, m, wall, g, g.x + g.axis * s - normal * distance)
    return with_wall(a, m, wall, at, contacts[n, K_OLDER] > wide(0.0), g, distance, normal, s)


@func
def at_mesh(
    a: System, m: Material, s: int, r: int, k: int, wall: int, g: Grain, old: uint32, sums: Sums, keep: bool
):  # fmt: skip
    """`sums` with the contacts with a mesh, whose first entry is k, and at which springs are held; old: were held."""
    bits = wp.uint32(0)
    begin = load_int(a.mesh_begin, load_int(a.mesh_of, wall))
    contacts = a.mesh_contacts[scratch(a, s, r, k)]
    count = touched(a, m, s, r, k, wall, old, g, contacts)
    if count == OVER:
        sums.deepest = real(CROWDED)
        bits = wp.uint32(1) << wp.uint32(k)
    for n in range(count):
        q = k + int(contacts[n, K_SPRING])
        at = entry(a, s, a.seats * WALL_PARTS, q, r)
        c = at_features(a, m, wall, at, g, contacts, n)
        sums = plus(sums, c, m)
        bits = bits | (wp.uint32(1) << wp.uint32(q))
        if keep:
            a.wall_feature[at] = int(contacts[n, K_FEATURE]) - begin
        if FRICTION:
            if keep:
                a.wall_spring[at] = c.spring
    return sums, bits


@func
def at_walls(
    a: System, m: Material, s: int, r: int, lane: int, g: Grain, near: uint32, old: uint32, sums: Sums, keep: bool
):  # fmt: skip
    """`sums` with the contacts with all walls that are `near`, and at which springs are held; old: were held.

    Of threads that share the grain, each gives its share.
    """
    springs = wp.uint32(0)
    near = without_walls(near, lane)
    while near != wp.uint32(0):
        q = first_bit(near) // WALL_PARTS
        mine = near & (wp.uint32((1 << WALL_PARTS) - 1) << wp.uint32(q * WALL_PARTS))
        near = without_walls(near, LANES)
        wall = wall_at(a, s, r, q)
        bits = wp.uint32(0)
        if is_mesh(a, wall):
            sums, bits = at_mesh(a, m, s, r, q * WALL_PARTS, wall, g, old, sums, keep)
        else:
            sums, bits = one_by_one(a, m, s, r, g, mine, old, sums, keep)
        springs = springs | bits
    return sums, springs


@func
def at_wall(a: System, m: Material, s: int, r: int, k: int, near: uint32, old: uint32, g: Grain):
    """The contact of row r at entry k of its walls; `old`: at which springs are held."""
    wall = wall_at(a, s, r, k // WALL_PARTS)
    c = Contact()
    if is_mesh(a, wall):
        contacts = a.mesh_contacts[scratch(a, s, r, k)]
        n = contact_of_spring(a, m, s, r, k, wall, old, g, contacts)
        if n >= 0:
            c = at_features(a, m, wall, entry(a, s, a.seats * WALL_PARTS, k, r), g, contacts, n)
    else:
        c = at_plate(a, m, s, r, k, near, old, g)
    return c


@func
def normal_at(a: System, m: Material, s: int, r: int, k: int, wall: int, near: uint32, g: Grain):
    """Unit normal from a wall to the rod, which touches it at entry k."""
    normal = wide3(wide(0.0), wide(0.0), wide(0.0))
    if is_mesh(a, wall):
        contacts = a.mesh_contacts[scratch(a, s, r, k)]
        n = contact_of_spring(a, m, s, r, k, wall, a.wall_held[s * a.cap + r], g, contacts)
        normal = normal_of(a, wall, contacts, max(n, 0))
    else:
        normal = plate_normal(a, m, s, r, k, wall, near, g)
    return normal


@func
def parts_near(a: System, m: Material, g: Grain, wall: int):
    """The parts that may touch a plate before the rod's list is built again, or all entries of a mesh, as bits."""
    near = wp.uint32(0)
    if is_mesh(a, wall):
        near = mesh_parts_near(a, m, 0, wall, g.x, g.axis)
    else:
        near = plate_parts(a, m, g, wall)
    return near
