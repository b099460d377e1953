"""Forces and torques on one grain, by its neighbours and the walls near it."""

from __future__ import annotations

from labbook_dem.words import FRICTION, ROLLING_SPRING, func, struct, wide

from labbook_warp.kernels.shape import Grain, at_walls, with_neighbour
from labbook_warp.kernels.sums import Sums, amount, joined_sums, of_walls, over_lanes, plus
from labbook_warp.kernels.system import Material, System, entry, has_bit
from labbook_warp.kernels.words import (
    ANY_WALLS,
    APART,
    FINE,
    LANES,
    SHARED,
    Words,
    load_bits,
    load_bits_now,
    load_int,
    load_int_now,
    or_lanes,
    uint32,
    wp,
)


@struct
class Listed:
    """What the lists say of a grain."""

    count: int  # neighbours
    held: uint32  # springs held at them, as bits
    first: int  # the row of the first neighbour of this thread, and of the second
    second: int
    walls: uint32  # walls, or parts of them, that are near, as bits; where they are asked for early, as the next
    wall_held: uint32  # springs held there
    touching: uint32  # where walls are met apart: those that are touched now, if any are near


@func
def listed(a: System, s: int, r: int, lane: int):
    """What the lists say of row r. Asked for before anything waits for the state of the grain."""
    i = s * a.cap + r
    first = load_int_now(a.nbr, entry(a, s, a.near, lane, r))
    second = load_int_now(a.nbr, entry(a, s, a.near, lane + LANES, r))
    found = Listed()
    found.count = load_int_now(a.count, i)
    found.held = load_bits_now(a.held, i)
    found.first = first
    found.second = second
    if APART:
        found.walls = load_bits_now(a.wall_near, i)
        found.touching = load_bits_now(a.wall_touching, i)
    if SHARED and ANY_WALLS:
        found.walls = load_bits_now(a.wall_near, i)
        found.wall_held = load_bits_now(a.wall_held, i)
    return found


@func
def forces(
    a: System, p: Words, m: Material, s: int, r: int, lane: int, g: Grain, near: Listed, keep: bool
):  # fmt: skip
    """Contact force [N] and torque [N m], which springs are held, at neighbours and at walls, the largest overlap [m].

    Where walls are met apart, `meet_walls` has summed up what they do, and knows which of their springs are held.
    near: what `listed` gave; keep: whether springs are advanced in memory.
    """
    i = s * a.cap + r
    sums = Sums()
    held = wp.uint32(0)
    wall_held = wp.uint32(0)
    # neighbours are looked up two ahead: the store of a spring would hold the next load back
    following = int(near.first)
    beyond = int(near.second)
    for k in range(lane, near.count, LANES):
        at = entry(a, s, a.near, k, r)
        j = s * a.cap + following
        following = beyond
        if k + 2 * LANES < near.count:
            beyond = load_int(a.nbr, at + 2 * LANES * a.cap)
        c = with_neighbour(a, p, m, at, j, has_bit(near.held, k), g)
        if c.touches:
            sums = plus(sums, c, m)
            held = held | (wp.uint32(1) << wp.uint32(k))
            if FRICTION:
                if keep:
                    a.spring[at] = c.spring
            if ROLLING_SPRING:
                if keep:
                    a.rolling[at] = c.rolling
    if APART:
        if (near.walls & near.touching) != wp.uint32(0):  # the bits of grains that have none near are stale
            sums = joined_sums(sums, of_walls(a, i))
    if ANY_WALLS and not APART:
        walls = near.walls
        old = near.wall_held
        if not SHARED:  # they would have occupied registers until here
            walls = load_bits(a.wall_near, i)
            old = load_bits(a.wall_held, i)
        sums, wall_held = at_walls(a, m, s, r, lane, g, walls, old, sums, keep)
    if SHARED:
        sums = over_lanes(sums)
        held = or_lanes(held, LANES)
        wall_held = or_lanes(wall_held, LANES)
    force = amount(sums.force, m.quantum_f)
    torque = amount(sums.torque, m.quantum_t)
    if FINE:
        force = force + amount(sums.fine_force, m.quantum_f * wide(2.0**-48.0))
        torque = torque + amount(sums.fine_torque, m.quantum_t * wide(2.0**-48.0))
    return force, torque, held, wall_held, sums.deepest
