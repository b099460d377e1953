"""Forces and torques on one grain, by its neighbours and the walls near it."""

from __future__ import annotations

from labbook_dem.words import FRICTION, ROLLING_SPRING, func, struct, wide

from labbook_warp.kernels.shape import Grain, at_walls, with_neighbour
from labbook_warp.kernels.sums import Sums, add_sums, from_quanta, load_wall_sums, plus, sum_lanes
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
    """Neighbour list of a grain: masks have a bit for each entry."""

    count: int  # neighbours
    springs: uint32  # mask of the neighbours with a spring
    first: int  # row of this thread's first neighbour
    second: int  # row of its second neighbour
    walls: uint32  # mask of near walls, or parts of them; this and the next only where they are loaded early
    wall_springs: uint32  # mask of the walls with a spring
    touching: uint32  # mask of touched walls, from the kernel of walls; stale if none is near


@func
def listed(a: System, s: int, r: int, lane: int):
    """Load the list of row r, before anything waits for the state of the grain."""
    i = s * a.cap + r
    first = load_int_now(a.nbr, entry(a, s, a.near, lane, r))
    second = load_int_now(a.nbr, entry(a, s, a.near, lane + LANES, r))
    near = Listed()
    near.count = load_int_now(a.count, i)
    near.springs = load_bits_now(a.held, i)
    near.first = first
    near.second = second
    if APART:
        near.walls = load_bits_now(a.wall_near, i)
        near.touching = load_bits_now(a.wall_touching, i)
    if SHARED and ANY_WALLS:
        near.walls = load_bits_now(a.wall_near, i)
        near.wall_springs = load_bits_now(a.wall_held, i)
    return near


@func
def forces(
    a: System, p: Words, m: Material, s: int, r: int, lane: int, g: Grain, near: Listed, keep: bool
):  # fmt: skip
    """Contact force [N] and torque [N m], masks of springs at neighbours and at walls, and largest overlap [m].

    With a separate kernel for walls (APART), `meet_walls` has summed up the contacts with walls and stored their
    springs. near: from `listed`; keep: store the springs of the next step.
    """
    i = s * a.cap + r
    sums = Sums()
    springs = wp.uint32(0)
    wall_springs = wp.uint32(0)
    # rows of neighbours are loaded two entries ahead: a store of a spring would delay a load that comes after it
    j_next = int(near.first)
    j_after = int(near.second)
    for k in range(lane, near.count, LANES):
        at = entry(a, s, a.near, k, r)
        j = s * a.cap + j_next
        j_next = j_after
        if k + 2 * LANES < near.count:
            j_after = load_int(a.nbr, at + 2 * LANES * a.cap)
        c = with_neighbour(a, p, m, at, j, has_bit(near.springs, k), g)
        if c.touches:
            sums = plus(sums, c, m)
            springs = springs | (wp.uint32(1) << wp.uint32(k))
            if FRICTION:
                if keep:
                    a.spring[at] = c.spring
            if ROLLING_SPRING:
                if keep:
                    a.rolling[at] = c.rolling
    if APART:
        if (near.walls & near.touching) != wp.uint32(0):  # the mask of a grain without near walls is stale
            sums = add_sums(sums, load_wall_sums(a, i))
    if ANY_WALLS and not APART:
        walls = near.walls
        old_springs = near.wall_springs
        if not SHARED:  # loaded here and not in `listed`: they would occupy registers during the loop
            walls = load_bits(a.wall_near, i)
            old_springs = load_bits(a.wall_held, i)
        sums, wall_springs = at_walls(a, m, s, r, lane, g, walls, old_springs, sums, keep)
    if SHARED:
        sums = sum_lanes(sums)
        springs = or_lanes(springs, LANES)
        wall_springs = or_lanes(wall_springs, LANES)
    force = from_quanta(sums.force, m.quantum_f)
    torque = from_quanta(sums.torque, m.quantum_t)
    if FINE:
        force = force + from_quanta(sums.fine_force, m.quantum_f * wide(2.0**-48.0))
        torque = torque + from_quanta(sums.fine_torque, m.quantum_t * wide(2.0**-48.0))
    return force, torque, springs, wall_springs, sums.deepest
