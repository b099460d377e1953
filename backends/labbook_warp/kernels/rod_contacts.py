"""Contacts of a rod: with one of its neighbours, and up to PLATE_PARTS contacts with a plate near it."""

from __future__ import annotations

from labbook_dem.chosen import wall_distance
from labbook_dem.rods import has, rod_on_rod, rod_on_wall, spring_source
from labbook_dem.segments import closest_from
from labbook_dem.words import FRICTION, dot, func, narrow, real, rounded, vec3, wide, wide3

from labbook_warp.kernels.parts import spring_from_part, spring_to_part, turning_of
from labbook_warp.kernels.rod_walls import edge_near, edges, part_distance
from labbook_warp.kernels.rods import Grain
from labbook_warp.kernels.shown import motion, position
from labbook_warp.kernels.sums import Contact, Sums, plus, spring_before
from labbook_warp.kernels.system import Material, System, entry
from labbook_warp.kernels.walls import wall_at, wall_velocity
from labbook_warp.kernels.words import MOVING, PLATE_PARTS, POSES, WALL_PARTS, Words, first_bit, uint32, wp


@func
def with_neighbour(a: System, p: Words, m: Material, at: int, j: int, has_spring: bool, g: Grain):
    """Contact with grain j, whose spring is entry `at`; has_spring: it is valid.

    The search for closest points starts from the rod that is farther along x, and finds points in space: both rods get
    the same ones to the last bit.
    """
    c = Contact()
    there = position(p, j)
    # most contacts of the last step persist: their velocities are loaded before the overlap is known
    last, advance = spring_before(a.spring, at, has_spring, real(wide(0.5) * m.dt))
    v = vec3(real(0.0), real(0.0), real(0.0))
    w = vec3(real(0.0), real(0.0), real(0.0))
    u = vec3(real(0.0), real(0.0), real(0.0))
    y = vec3(real(0.0), real(0.0), real(0.0))
    if has_spring:
        v, w, u, y = motion(p, j, there)
    away = g.x - there.x
    along = away[0] if away[0] != wide(0.0) else (away[1] if away[1] != wide(0.0) else away[2])
    s, t = closest_from(away, g.axis, there.axis, m.half, along > wide(0.0))
    branch = (g.x + g.axis * wide(s)) - (there.x + there.axis * wide(t))
    overlap2 = m.reach2 - dot(branch, branch)
    c.touches = overlap2 > wide(0.0)
    if c.touches:
        if not has_spring:
            v, w, u, y = motion(p, j, there)
        b = narrow(there.axis)
        force, torque, _t, spring, delta = rod_on_rod(
            m.c, m.radius, m.mass, narrow(branch), rounded(overlap2), narrow(g.axis) * s, b * t,
            g.u - u, g.v - v, g.predicted_spin, y, g.spin, w, last, advance, m.inertia_rate,
        )  # fmt: skip
        c.overlap = delta
        c.force = force
        c.torque = torque
        c.spring = spring
        c.branch = -away
    return c


@func
def with_wall(
    a: System, m: Material, wall: int, at: int, has_spring: bool, g: Grain, distance: wide, normal: wide3, s: wide
):
    """Contact with a wall at the point s [m] of the segment, whose spring is entry `at`; has_spring: it is valid."""
    c = Contact()
    overlap = rounded(m.reach - distance)
    lever = g.axis * s
    last, advance = spring_before(a.wall_spring, at, has_spring, real(wide(0.5) * m.dt))
    surface = vec3(real(0.0), real(0.0), real(0.0))
    turning = vec3(real(0.0), real(0.0), real(0.0))
    if MOVING:
        surface = narrow(wall_velocity(a, wall, g.x + lever - normal * distance))
        turning = vec3(real(0.0), real(0.0), real(a.wall_motion[wall][3]))
    if POSES:
        turning = turning + turning_of(a, wall)
        last = spring_from_part(a, wall, last)
    f, t, spring = rod_on_wall(
        a.wall_c[wall], m.radius, m.mass, overlap, narrow(normal), narrow(lever), g.u - surface, g.v - surface,
        g.predicted_spin, g.spin, turning, last, advance, m.inertia_rate,
    )  # fmt: skip
    c.touches = True
    c.overlap = overlap
    c.force = f
    c.torque = t
    c.spring = spring
    if POSES:
        c.spring = spring_to_part(a, wall, spring)
    c.branch = lever - normal * distance
    return c


@func
def meet(
    a: System, m: Material, s: int, r: int, q: int, part: int, was: int, now: int, g: Grain, distance: wide,
    normal: wide3, at: wide, keep: bool,
):  # fmt: skip
    """The contact of row r with a part of wall q at the point `at` [m] of the segment, and the spring it goes on with.

    was, now: the parts of that wall that touched a step ago and that touch now, as bits; keep: whether the spring is
    advanced in memory.
    """
    source = spring_source(part, was, now)
    first = entry(a, s, a.seats * WALL_PARTS, q * WALL_PARTS, r)
    c = with_wall(a, m, wall_at(a, s, r, q), first + source * a.cap, source >= 0, g, distance, normal, at)
    if FRICTION:
        if keep:
            a.wall_spring[first + part * a.cap] = c.spring
    return c


@func
def parts_of(mask: uint32, q: int):
    """The bits of wall q."""
    return int((mask >> wp.uint32(q * WALL_PARTS)) & wp.uint32((1 << WALL_PARTS) - 1))


@func
def at_plate(a: System, m: Material, s: int, r: int, k: int, near: uint32, old: uint32, g: Grain):
    """The contact of row r with a plate at k = wall WALL_PARTS + part; old: at which parts springs are held."""
    q = k // WALL_PARTS
    part = k - q * WALL_PARTS
    now = int(0)
    wall = wall_at(a, s, r, q)
    met, on, twin, back = edges(a, wall, g.x, g.axis, m.half, m.reach, parts_of(near, q))
    for candidate in range(WALL_PARTS):
        if has(parts_of(near, q), candidate):
            distance, normal, at = part_distance(
                a, wall, g.x, g.axis, m.half, m.reach, candidate, met, on, twin, back
            )  # fmt: skip
            if distance < m.reach:
                now = now | (1 << candidate)
    c = Contact()
    if has(now, part):
        distance, normal, at = part_distance(a, wall, g.x, g.axis, m.half, m.reach, part, met, on, twin, back)
        c = meet(a, m, s, r, q, part, parts_of(old, q), now, g, distance, normal, at, False)
    return c


@func
def plate_normal(a: System, m: Material, s: int, r: int, k: int, wall: int, near: uint32, g: Grain):
    """Unit normal from a plate to the part k modulo WALL_PARTS of the rod."""
    q = k // WALL_PARTS
    met, on, twin, back = edges(a, wall, g.x, g.axis, m.half, m.reach, parts_of(near, q))
    _distance, normal, _at = part_distance(
        a, wall, g.x, g.axis, m.half, m.reach, k - q * WALL_PARTS, met, on, twin, back
    )  # fmt: skip
    return normal


@func
def without_walls(near: uint32, n: int):
    """The walls that are near, but for the first n of them."""
    for _k in range(n):
        if near != wp.uint32(0):
            near = near & ~(wp.uint32((1 << WALL_PARTS) - 1) << wp.uint32(first_bit(near) // WALL_PARTS * WALL_PARTS))
    return near


@func
def one_by_one(
    a: System, m: Material, s: int, r: int, g: Grain, near: uint32, old: uint32, sums: Sums, keep: bool
):  # fmt: skip
    """One thread takes all parts of all walls."""
    held = wp.uint32(0)
    while near != wp.uint32(0):
        q = first_bit(near) // WALL_PARTS
        left = parts_of(near, q)
        near = without_walls(near, 1)
        # once to see which parts touch, and once more for their forces: who inherits a spring depends on all
        now = int(0)
        looking = bool(True)
        wall = wall_at(a, s, r, q)
        met, on, twin, back = edges(a, wall, g.x, g.axis, m.half, m.reach, left)
        while left != 0:
            part = first_bit(wp.uint32(left))
            left = left & (left - 1)
            distance, normal, at = part_distance(a, wall, g.x, g.axis, m.half, m.reach, part, met, on, twin, back)
            if looking:
                if distance < m.reach:
                    now = now | (1 << part)
                if left == 0:
                    left = now
                    looking = False
            else:
                c = meet(a, m, s, r, q, part, parts_of(old, q), now, g, distance, normal, at, keep)
                sums = plus(sums, c, m)
                held = held | (wp.uint32(1) << wp.uint32(q * WALL_PARTS + part))
    return sums, held


@func
def plate_parts(a: System, m: Material, g: Grain, wall: int):
    """The parts that may touch a plate before the grain's list is built again, as bits.

    An end counts wherever the plate is near.
    """
    near = wp.uint32(0)
    for part in range(PLATE_PARTS):
        if part < 2:
            end = m.half if part == 1 else -m.half
            distance, _normal = wall_distance(a.wall_numbers, wall, a.wall_kind[wall], g.x + g.axis * end)
            if distance < m.reach + m.half_skin:
                near = near | (wp.uint32(1) << wp.uint32(part))
        else:
            if edge_near(a, wall, part, g.x, g.axis, m.half, m.reach + m.half_skin):
                near = near | (wp.uint32(1) << wp.uint32(part))
    return near
