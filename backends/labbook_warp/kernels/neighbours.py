"""Lists of near neighbours and near walls, rebuilt for a member when one of its grains has moved too far.

Cells form a periodic lattice of a few hundred or thousand a member; grains that are neighbours only by periodicity are
rejected by their distance. A cell holds a fixed number of grains, in random order, which decides nothing.
"""

from __future__ import annotations

from labbook_dem.words import FRICTION, ROLLING_SPRING, func, wide

from labbook_warp.kernels.bodies import listed2
from labbook_warp.kernels.parts import lists_are_due
from labbook_warp.kernels.shape import Grain, displacement_and_speed, distance2, grain, parts_near, store_origin
from labbook_warp.kernels.shown import position
from labbook_warp.kernels.system import Material, MemberDomain, System, entry, has_bit, material
from labbook_warp.kernels.walls import wall_at
from labbook_warp.kernels.words import (
    ANY_WALLS,
    LANES,
    LISTED,
    PARKED,
    POSES,
    REACH,
    SHARED,
    WALL_PARTS,
    Words,
    float32,
    kernel,
    wp,
)


@kernel
def check_displacements(a: System, p: Words, interval: int):
    """Flag a member for a rebuild if a grain could move by half of the skin before the next check, after `interval`
    steps.

    A grain that has already moved farther (after a collision since the last check) sets `late`: the host repeats the
    beat with more frequent checks. With a check at every step no list is older than half of the skin. Members with a
    failed grain stop.
    """
    i = wp.tid()
    s = i // a.cap
    if a.fail[s] < wp.int64(1) << wp.int64(61):
        a.rows[s] = 0
    elif i - s * a.cap < a.rows[s]:
        m = material(a, s)
        g = grain(p, m, i)
        if g.x[2] > wide(0.5) * wide(PARKED):
            so_far, speed = displacement_and_speed(a, m, i, g)
            if interval > 1 and not so_far <= m.half_skin:
                a.late[s] = 1
            ahead = wide(1.5) * speed * m.dt * wide(interval)  # grains may gain speed before the next check
            if POSES:
                if lists_are_due(a, s, interval):
                    ahead = ahead + m.half_skin + m.half_skin
            if not so_far + ahead <= m.half_skin:  # so written that NaN asks for a rebuild too
                a.flag[s] = 1
                a.any_flag[0] = 1


@func
def cell_number(x: wide, cell: wide, cells: int):
    """Number of the cell of a coordinate, 0 to cells - 1."""
    n = int(wp.floor(x / cell)) % cells
    if n < 0:  # the remainder has the sign of the dividend, as in C
        n = n + cells
    return n


@func
def wrap(n: int, cells: int):
    """Wrap a cell number that is at most one period outside of the lattice."""
    if n < 0:
        n = n + cells
    if n >= cells:
        n = n - cells
    return n


@func
def cell_index(b: MemberDomain, cx: int, cy: int, cz: int):
    """Index of a cell within its member, from cell numbers that may lie outside of the lattice."""
    return (wrap(cz, b.gz) * b.gy + wrap(cy, b.gy)) * b.gx + wrap(cx, b.gx)


@kernel
def clear_cells(a: System):
    """Empty the cells of flagged members."""
    c = wp.tid()
    if a.flag[c // a.cells] == 1:
        a.cell_count[c] = 0


@kernel
def fill_cells(a: System, p: Words):
    """Sort the grains of flagged members into cells."""
    i = wp.tid()
    s = i // a.cap
    if a.flag[s] == 1 and i - s * a.cap < a.rows[s]:
        x = position(p, i).x
        if x[2] > wide(0.5) * wide(PARKED):
            b = a.domain[s]
            index = cell_index(
                b,
                cell_number(x[0], b.cell, b.gx),
                cell_number(x[1], b.cell, b.gy),
                cell_number(x[2], b.cell, b.gz),
            )
            c = s * a.cells + index
            # in any order: lists are sorted by distance later, and bits do not depend on it
            count_before = wp.atomic_add(a.cell_count, c, 1)
            if count_before < a.depth:
                a.cell_rows[c * a.depth + count_before] = i - s * a.cap
            else:
                wp.atomic_max(a.overflow, 3 * s + 1, count_before + 1)


@func
def collect_neighbours(a: System, p: Words, m: Material, s: int, r: int, g: Grain, lane: int):
    """Write the rows near row r into its new list, in any order; return their number if no other thread shares the
    grain."""
    i = s * a.cap + r
    b = a.domain[s]
    cx = cell_number(g.x[0], b.cell, b.gx)
    cy = cell_number(g.x[1], b.cell, b.gy)
    cz = cell_number(g.x[2], b.cell, b.gz)
    width = 2 * REACH + 1
    count = int(0)
    for offset in range(lane, width * width * width, LANES):
        dx = offset % width - REACH
        dy = offset // width % width - REACH
        dz = offset // (width * width) - REACH
        # a lattice one cell thick is its own periodic neighbour: visit it once
        if (b.gx > 1 or dx == 0) and (b.gy > 1 or dy == 0) and (b.gz > 1 or dz == 0):
            c = s * a.cells + cell_index(b, cx + dx, cy + dy, cz + dz)
            for e in range(min(a.cell_count[c], a.depth)):
                row = a.cell_rows[c * a.depth + e]
                d2 = distance2(p, m, g, s * a.cap + row)
                if d2 < listed2(a, m, i, s * a.cap + row) and row != r:
                    if SHARED:
                        count = wp.atomic_add(a.new_count, i, 1)
                    if count < a.near:
                        at = entry(a, s, a.near, count, r)
                        a.new_key[at] = wp.float32(d2)
                        a.new_nbr[at] = row
                    count = count + 1
    return count


@kernel
def collect_shared(a: System, p: Words):
    """Collect the neighbours of each grain with all threads that share it."""
    thread = wp.tid()
    i = thread // LANES
    s = i // a.cap
    r = i - s * a.cap
    if a.flag[s] == 1 and r < a.rows[s]:
        m = material(a, s)
        g = grain(p, m, i)
        if g.x[2] > wide(0.5) * wide(PARKED):
            collect_neighbours(a, p, m, s, r, g, thread - i * LANES)


@kernel
def build_lists(a: System, p: Words):
    """Sort the neighbours of each grain by distance, so that touching ones come first, and copy springs to the new
    list."""
    i = wp.tid()
    s = i // a.cap
    r = i - s * a.cap
    if a.flag[s] == 1 and r < a.rows[s]:
        m = material(a, s)
        g = grain(p, m, i)
        store_origin(a, i, g)
        count = int(0)
        near = wp.uint32(0)
        if g.x[2] > wide(0.5) * wide(PARKED):
            if SHARED:
                count = a.new_count[i]
                a.new_count[i] = 0
            else:
                count = collect_neighbours(a, p, m, s, r, g, 0)
            # sorted only now: threads of a warp find neighbours at different times, but sort in step
            for k in range(1, min(count, a.near)):
                at = entry(a, s, a.near, k, r)
                insert_sorted(a, s, r, k, a.new_nbr[at], a.new_key[at])
            if count > a.near:
                wp.atomic_max(a.overflow, 3 * s, count)
                count = a.near
            if ANY_WALLS:
                near = near_walls(a, m, s, r, g)
        if ANY_WALLS:
            a.wall_near[i] = near
            if near == wp.uint32(0):  # nobody will look at its springs again
                a.wall_held[i] = near
        replace_list(a, s, r, i, count)


@func
def near_walls(a: System, m: Material, s: int, r: int, g: Grain):
    """Mask of the walls, WALL_PARTS bits each, that row r may touch before its list is rebuilt."""
    near = wp.uint32(0)
    if LISTED:
        near = assign_wall_entries(a, m, s, r, g)
    else:
        for q in range(a.domain[s].walls):
            near = near | (parts_near(a, m, g, s * a.walls + q) << wp.uint32(q * WALL_PARTS))
    return near


@func
def assign_wall_entries(a: System, m: Material, s: int, r: int, g: Grain):
    """`near_walls` for members with more walls than a grain has entries for.

    A wall that stays near keeps its entry, and with it its spring.
    """
    i = s * a.cap + r
    all_parts = wp.uint32((1 << WALL_PARTS) - 1)
    near_before = a.wall_near[i]
    springs = a.wall_held[i]
    near = wp.uint32(0)
    needed = int(0)
    for q in range(a.seats):
        if (near_before >> wp.uint32(q * WALL_PARTS)) & all_parts != wp.uint32(0):
            near = near | (parts_near(a, m, g, wall_at(a, s, r, q)) << wp.uint32(q * WALL_PARTS))
    for w in range(a.domain[s].walls):
        own_entry = int(-1)
        free_entry = int(-1)
        for q in range(a.seats):
            # an entry without near parts is free, also that of a wall which was near before
            if (near >> wp.uint32(q * WALL_PARTS)) & all_parts == wp.uint32(0):
                free_entry = q
            elif a.wall_seat[entry(a, s, a.seats, q, r)] == w:
                own_entry = q
        if own_entry >= 0:
            needed = needed + 1
        else:
            parts = parts_near(a, m, g, s * a.walls + w)
            if parts != wp.uint32(0):
                needed = needed + 1
                if free_entry >= 0:
                    a.wall_seat[entry(a, s, a.seats, free_entry, r)] = w
                    near = near | (parts << wp.uint32(free_entry * WALL_PARTS))
                    # its springs were those of the wall that had the entry before
                    springs = springs & ~(all_parts << wp.uint32(free_entry * WALL_PARTS))
    a.wall_held[i] = springs
    if needed > a.seats:
        wp.atomic_max(a.overflow, 3 * s + 2, needed)
    return near


@func
def insert_sorted(a: System, s: int, r: int, count: int, neighbour: int, key: float32):
    """Insert a row into the new list of row r, which is sorted by distance and has `count` entries."""
    k = int(count)
    while k > 0 and a.new_key[entry(a, s, a.near, wp.max(k - 1, 0), r)] > key:
        at = entry(a, s, a.near, k, r)
        a.new_key[at] = a.new_key[at - a.cap]
        a.new_nbr[at] = a.new_nbr[at - a.cap]
        k = k - 1
    at = entry(a, s, a.near, k, r)
    a.new_key[at] = key
    a.new_nbr[at] = neighbour


@func
def replace_list(a: System, s: int, r: int, i: int, new_count: int):
    """Copy friction springs from the old neighbour list of row r to the new one, and replace the list."""
    old_springs = a.held[i]
    springs = wp.uint32(0)
    old_count = a.count[i]
    if FRICTION:
        for k in range(new_count):
            at = entry(a, s, a.near, k, r)
            neighbour = a.new_nbr[at]
            # a search, since lists are sorted by distance; only touching neighbours have a spring
            for old_k in range(old_count):
                if has_bit(old_springs, old_k):
                    old_at = entry(a, s, a.near, old_k, r)
                    if a.nbr[old_at] == neighbour:
                        a.new_spring[at] = a.spring[old_at]
                        if ROLLING_SPRING:
                            a.new_rolling[at] = a.rolling[old_at]
                        springs = springs | (wp.uint32(1) << wp.uint32(k))
    # in a second pass: the first still reads the old list
    for k in range(new_count):
        at = entry(a, s, a.near, k, r)
        a.nbr[at] = a.new_nbr[at]
        if FRICTION:
            if has_bit(springs, k):
                a.spring[at] = a.new_spring[at]
                if ROLLING_SPRING:
                    a.rolling[at] = a.new_rolling[at]
    a.count[i] = new_count
    a.held[i] = springs


@kernel
def finish_rebuild(a: System):
    """Count the rebuild. Members whose lists or cells overflowed stop until the host has enlarged the arrays."""
    s = wp.tid()
    if a.flag[s] == 1:
        a.rebuilds[s] = a.rebuilds[s] + 1
        a.flag[s] = 0
        if a.overflow[3 * s] > 0 or a.overflow[3 * s + 1] > 0 or a.overflow[3 * s + 2] > 0:
            a.rows[s] = 0
    a.any_flag[0] = 0
