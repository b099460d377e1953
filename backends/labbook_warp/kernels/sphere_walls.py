"""Spheres at walls; `mesh_walls` has the same functions for scenes with walls of triangles."""

from __future__ import annotations

from labbook_dem.chosen import wall_distance
from labbook_dem.words import FRICTION, ROLLING_SPRING, func

from labbook_warp.kernels.bodies import body
from labbook_warp.kernels.spheres import Grain, with_wall
from labbook_warp.kernels.sums import Sums, plus
from labbook_warp.kernels.system import Material, System, entry, has_bit
from labbook_warp.kernels.walls import wall_at
from labbook_warp.kernels.words import LANES, first_bit, load_int, uint32, without_first, wp


@func
def at_wall(a: System, m: Material, s: int, r: int, k: int, near: uint32, old: uint32, g: Grain):
    """The contact of row r at entry k of its walls; `old`: at which springs are held."""
    return with_wall(a, m, wall_at(a, s, r, k), entry(a, s, a.seats, k, r), has_bit(old, k), g)


@func
def normal_at(a: System, m: Material, s: int, r: int, k: int, wall: int, near: uint32, g: Grain):
    """Unit normal from a wall to the grain."""
    _distance, normal = wall_distance(a.wall_numbers, wall, load_int(a.wall_kind, wall), g.x)
    return normal


@func
def at_walls(
    a: System, m: Material, s: int, r: int, lane: int, g: Grain, near: uint32, old: uint32, sums: Sums, keep: bool
):  # fmt: skip
    """`sums` with the contacts with all walls that are `near`, and at which springs are held; old: were held."""
    held = wp.uint32(0)
    # each grain by its own first, second, ... near wall: side by side, whichever walls these are
    near = without_first(near, lane)
    while near != wp.uint32(0):
        q = first_bit(near)
        near = without_first(near, LANES)
        at = entry(a, s, a.seats, q, r)
        c = with_wall(a, m, wall_at(a, s, r, q), at, has_bit(old, q), g)
        if c.touches:
            sums = plus(sums, c, m)
            held = held | (wp.uint32(1) << wp.uint32(q))
            if FRICTION:
                if keep:
                    a.wall_spring[at] = c.spring
            if ROLLING_SPRING:
                if keep:
                    a.wall_rolling[at] = c.rolling
    return sums, held


@func
def parts_near(a: System, m: Material, g: Grain, wall: int):
    """1 if the grain may touch a wall before its list is built again, else 0."""
    near = wp.uint32(0)
    distance, _normal = wall_distance(a.wall_numbers, wall, load_int(a.wall_kind, wall), g.x)
    if distance < body(a, m, g.index).reach + m.half_skin:
        near = wp.uint32(1)
    return near
