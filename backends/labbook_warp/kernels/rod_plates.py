"""Rods at walls of which none is a mesh; `rod_meshes` has the same functions for scenes with one."""

from __future__ import annotations

from labbook_dem.rods import has
from labbook_dem.words import func

from labbook_warp.kernels.rod_contacts import (
    at_plate,
    meet,
    one_by_one,
    parts_of,
    plate_normal,
    plate_parts,
    without_walls,
)
from labbook_warp.kernels.rod_walls import edge_of_two, part_distance
from labbook_warp.kernels.rods import Grain
from labbook_warp.kernels.sums import Sums, plus
from labbook_warp.kernels.system import Material, System
from labbook_warp.kernels.walls import wall_at
from labbook_warp.kernels.words import LANES, SHARED, WALL_PARTS, first_bit, or_lanes, uint32, wp


@func
def at_wall(a: System, m: Material, s: int, r: int, k: int, near: uint32, old: uint32, g: Grain):
    """The contact of row r at k = wall WALL_PARTS + part; old: at which parts springs are held."""
    return at_plate(a, m, s, r, k, near, old, g)


@func
def normal_at(a: System, m: Material, s: int, r: int, k: int, wall: int, near: uint32, g: Grain):
    """Unit normal from a wall to the part k modulo WALL_PARTS of the rod."""
    return plate_normal(a, m, s, r, k, wall, near, g)


@func
def at_walls(
    a: System, m: Material, s: int, r: int, lane: int, g: Grain, near: uint32, old: uint32, sums: Sums, keep: bool
):  # fmt: skip
    """`sums` with the contacts with all walls that are `near`, and at which springs are held; old: were held.

    Of threads that share the grain, each gives its share.
    """
    held = wp.uint32(0)
    if SHARED:
        sums, held = abreast(a, m, s, r, lane, g, near, old, sums, keep)
    else:
        sums, held = one_by_one(a, m, s, r, g, near, old, sums, keep)
    return sums, held


@func
def abreast(
    a: System, m: Material, s: int, r: int, lane: int, g: Grain, near: uint32, old: uint32, sums: Sums, keep: bool
):  # fmt: skip
    """Each thread takes one part of one wall at a time. No spring is read that another writes: see `spring_source`."""
    held = wp.uint32(0)
    part = lane % WALL_PARTS
    near = without_walls(near, lane // WALL_PARTS)
    while near != wp.uint32(0):
        q = first_bit(near) // WALL_PARTS
        parts = parts_of(near, q)
        near = without_walls(near, LANES // WALL_PARTS)
        wall = wall_at(a, s, r, q)
        met, on = edge_of_two(a, wall, g.x, g.axis, m.half, m.reach, parts, part)
        distance, normal, at = part_distance(a, wall, g.x, g.axis, m.half, m.reach, part, met, on, met, on)
        touches = wp.uint32(0)
        if has(parts, part) and distance < m.reach:
            touches = wp.uint32(1) << wp.uint32(part)
        now = int(or_lanes(touches, WALL_PARTS))
        if has(now, part):
            c = meet(a, m, s, r, q, part, parts_of(old, q), now, g, distance, normal, at, keep)
            sums = plus(sums, c, m)
            held = held | (wp.uint32(1) << wp.uint32(q * WALL_PARTS + part))
    return sums, held


@func
def parts_near(a: System, m: Material, g: Grain, wall: int):
    """The parts that may touch a wall before the grain's list is built again, as bits."""
    return plate_parts(a, m, g, wall)
