"""Forces and torques on one grain, by its neighbours and the walls near it."""

from __future__ import annotations

from labbook_dem.words import FRICTION, func, wide

from labbook_warp.kernels.spheres import Grain, at_walls, with_neighbour
from labbook_warp.kernels.sums import Sums, amount, of_walls, over_lanes, plus
from labbook_warp.kernels.system import Material, System, entry, has_bit
from labbook_warp.kernels.words import ANY_WALLS, APART, FINE, LANES, SHARED, Words, load_int, or_lanes, uint32, wp


@func
def listed(a: System, s: int, r: int, lane: int):
    """Neighbours of row r, the springs held at them, and the first of them that is this thread's.

    Asked for before anything waits for the state of the grain.
    """
    i = s * a.cap + r
    return a.count[i], a.held[i], load_int(a.nbr, entry(a, s, a.near, lane, r))


@func
def forces(
    a: System, p: Words, m: Material, s: int, r: int, lane: int, g: Grain, count: int, old: uint32, first: int, keep: bool
):
    """Contact force [N] and torque [N m], which springs are held, at neighbours and at walls, the largest overlap [m].

    Where walls are met apart, `meet_walls` has summed up what they do, and knows which of their springs are held.
    count, old, first: what `listed` gave; keep: whether springs are advanced in memory.
    """
    i = s * a.cap + r
    sums = Sums()
    held = wp.uint32(0)
    wall_held = wp.uint32(0)
    if APART:
        if a.wall_near[i] != wp.uint32(0):
            sums = of_walls(a, i)
    following = int(first)  # neighbours are looked up one ahead: the store of a spring would hold the next load back
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
    if ANY_WALLS and not APART:
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
