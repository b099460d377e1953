"""Forces and torques on one grain, by its neighbours and the walls near it."""

from __future__ import annotations

from labbook_dem.words import FRICTION, func, wide

from labbook_warp.kernels.spheres import Grain, at_walls, with_neighbour
from labbook_warp.kernels.sums import Sums, amount, over_lanes, plus, with_walls
from labbook_warp.kernels.system import Material, System, entry, has_bit
from labbook_warp.kernels.words import ANY_WALLS, APART, FINE, LANES, SHARED, Words, load_int, or_lanes, wp


@func
def forces(a: System, p: Words, m: Material, s: int, r: int, lane: int, g: Grain, keep: bool):
    """Contact force [N] and torque [N m], which springs are held, at neighbours and at walls, the largest overlap [m].

    Where walls are met apart, `meet_walls` has summed up what they do, and knows which of their springs are held.
    keep: whether springs are advanced in memory.
    """
    i = s * a.cap + r
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
        c = with_neighbour(a, p, m, at, j, has_bit(old, k), g)
        if c.touches:
            sums = plus(sums, c, m)
            held = held | (wp.uint32(1) << wp.uint32(k))
            if FRICTION:
                if keep:
                    a.spring[at] = c.spring
    if ANY_WALLS:
        if APART:
            if a.wall_near[i] != wp.uint32(0):
                sums = with_walls(a, i, sums)
        else:
            sums, wall_held = at_walls(a, m, s, r, lane, g, sums, keep)
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
