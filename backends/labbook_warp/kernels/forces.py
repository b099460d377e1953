"""Forces and torques on one grain, by its neighbours and the walls near it.

Sums are exact, so that they do not depend on order: each contribution is rounded to a multiple of a quantum far below
a grain's weight, and sums of such multiples lose nothing in double precision. (Contributions in double are split in
two: what the rounding leaves over is summed likewise, in quanta finer by 2^48.) Hence neither the order of a list, nor
when it was built, nor how many threads share a grain decides a bit of the result.
"""

from __future__ import annotations

from labbook_dem.words import FRICTION, func, narrow, real, struct, vec3, wide, wide3

from labbook_warp.kernels.bodies import body
from labbook_warp.kernels.contacts import Contact, with_neighbour, with_wall
from labbook_warp.kernels.system import Material, System, entry, has_bit
from labbook_warp.kernels.words import (
    ANY_WALLS,
    FINE,
    LANES,
    SHARED,
    Words,
    add_lanes,
    first_bit,
    load_int,
    most_lanes,
    or_lanes,
    widen,
    without_first,
    wp,
)


@func
def on_grid(v: vec3, magic: wide):
    """v rounded to multiples of a quantum: `magic` is 1.5 * 2^52 of them."""
    m = wide3(magic, magic, magic)
    return (widen(v) + m) - m


@func
def fine(v: vec3, magic: wide):
    """What `on_grid` leaves over, on a grid finer by 2^48."""
    return on_grid(narrow(widen(v) - on_grid(v, magic)), magic * wide(2.0**-48.0))


@func
def all_lanes(v: wide3):
    """Sum over the threads that share a grain."""
    return wide3(add_lanes(v[0], LANES), add_lanes(v[1], LANES), add_lanes(v[2], LANES))


@struct
class Sums:
    """Force [N] and torque [N m] so far, in quanta and in finer ones, and the largest overlap [m]."""

    force: wide3
    torque: wide3
    fine_force: wide3
    fine_torque: wide3
    deepest: real


@func
def plus(sums: Sums, c: Contact, m: Material):
    """Sums with one contact more."""
    new = Sums()
    new.force = sums.force + on_grid(c.force, m.grid_f)
    new.deepest = max(sums.deepest, c.overlap)
    if FINE:
        new.fine_force = sums.fine_force + fine(c.force, m.grid_f)
    if FRICTION:
        new.torque = sums.torque + on_grid(c.torque, m.grid_t)
        if FINE:
            new.fine_torque = sums.fine_torque + fine(c.torque, m.grid_t)
    return new


@func
def over_lanes(sums: Sums):
    """Sums over all threads that share a grain."""
    new = Sums()
    new.force = all_lanes(sums.force)
    new.deepest = most_lanes(sums.deepest, LANES)
    if FINE:
        new.fine_force = all_lanes(sums.fine_force)
    if FRICTION:
        new.torque = all_lanes(sums.torque)
        if FINE:
            new.fine_torque = all_lanes(sums.fine_torque)
    return new


@func
def forces(
    a: System, p: Words, m: Material, s: int, r: int, lane: int, x: wide3, v: vec3, w: vec3, u: vec3, keep: bool
):  # fmt: skip
    """Contact force [N] and torque [N m], which springs are held, at neighbours and at walls, the largest overlap [m].

    keep: whether springs are advanced in memory.
    """
    none = wp.uint32(0)
    i = s * a.cap + r
    one = body(a, m, i)
    sums = Sums()
    held = wp.uint32(0)
    wall_held = wp.uint32(0)
    old = a.held[i]
    count = a.count[i]
    following = int(0)  # neighbours are looked up one ahead: the store of a spring would hold the next load back
    if lane < count:
        following = load_int(a.nbr, entry(a, s, a.near, lane, r))
    for k in range(lane, count, LANES):
        at = entry(a, s, a.near, k, r)
        j = s * a.cap + following
        if k + LANES < count:
            following = load_int(a.nbr, at + LANES * a.cap)
        c = with_neighbour(a, p, m, s, one, at, j, has_bit(old, k), x, v, w, u)
        if c.touches:
            sums = plus(sums, c, m)
            held = held | (wp.uint32(1) << wp.uint32(k))
            if FRICTION:
                if keep:
                    a.spring[at] = c.spring
    if ANY_WALLS:
        # each grain by its own first, second, ... near wall: side by side, whichever walls these are
        near = without_first(a.wall_near[i], lane)
        old = a.wall_held[i]
        while near != none:
            q = first_bit(near)
            near = without_first(near, LANES)
            at = entry(a, s, a.walls, q, r)
            c = with_wall(a, m, one, s * a.walls + q, at, has_bit(old, q), x, v, w, u)
            if c.touches:
                sums = plus(sums, c, m)
                wall_held = wall_held | (wp.uint32(1) << wp.uint32(q))
                if FRICTION:
                    if keep:
                        a.wall_spring[at] = c.spring
    if SHARED:
        sums = over_lanes(sums)
        held = or_lanes(held, LANES)
        wall_held = or_lanes(wall_held, LANES)
    force = sums.force
    torque = sums.torque
    if FINE:
        force = force + sums.fine_force
        torque = torque + sums.fine_torque
    return force, torque, held, wall_held, sums.deepest
