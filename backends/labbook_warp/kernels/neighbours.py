"""Lists of near neighbours and near walls, rebuilt per member when one of its grains has moved too far.

Cells lie on a lattice that is wrapped around to a member's few hundred or thousand; wrapped neighbours drop out by
their distance. A cell holds a fixed number of grains: their order, which is by chance, decides nothing.
"""

from __future__ import annotations

from labbook_dem.words import FRICTION, ROLLING_SPRING, func, wide

from labbook_warp.kernels.bodies import listed2
from labbook_warp.kernels.parts import lists_are_due
from labbook_warp.kernels.shape import Grain, apart2, grain, mark, parts_near, strayed
from labbook_warp.kernels.shown import spot
from labbook_warp.kernels.system import Material, Place, System, entry, has_bit, material
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
def check(a: System, p: Words, every: int):
    """Ask for a rebuild if a grain could have moved by half of the skin before the next check, `every` steps on.

    A grain that has already moved farther (it was hit in between) was checked `late`: the beat is taken again,
    with checks more often. Checked at every step, lists are never older than half of the skin. A member of which a
    grain has failed rests.
    """
    i = wp.tid()
    s = i // a.cap
    if a.fail[s] < wp.int64(1) << wp.int64(61):
        a.rows[s] = 0
    elif i - s * a.cap < a.rows[s]:
        m = material(a, s)
        g = grain(p, m, i)
        if g.x[2] > wide(0.5) * wide(PARKED):
            so_far, speed = strayed(a, m, i, g)
            if every > 1 and not so_far <= m.half_skin:
                a.late[s] = 1
            ahead = wide(1.5) * speed * m.dt * wide(every)
            if POSES:
                if lists_are_due(a, s, every):
                    ahead = ahead + m.half_skin + m.half_skin
            if not so_far + ahead <= m.half_skin:
                a.flag[s] = 1
                a.any_flag[0] = 1


@func
def wrapped(x: wide, cell: wide, cells: int):
    """Cell number of a coordinate, 0 to cells - 1."""
    at = int(wp.floor(x / cell)) % cells
    if at < 0:
        at = at + cells
    return at


@func
def inside(c: int, cells: int):
    """Cell number c on the lattice, from one that may lie less than all of it beyond."""
    if c < 0:
        c = c + cells
    if c >= cells:
        c = c - cells
    return c


@func
def cell_at(b: Place, cx: int, cy: int, cz: int):
    """Number of a cell of one member, from cell numbers that may lie beyond the lattice."""
    return (inside(cz, b.gz) * b.gy + inside(cy, b.gy)) * b.gx + inside(cx, b.gx)


@kernel
def clear(a: System):
    """Empty the cells of the members to be rebuilt."""
    c = wp.tid()
    if a.flag[c // a.cells] == 1:
        a.cell_count[c] = 0


@kernel
def fill(a: System, p: Words):
    """Put grains into cells."""
    i = wp.tid()
    s = i // a.cap
    if a.flag[s] == 1 and i - s * a.cap < a.rows[s]:
        x = spot(p, i).x
        if x[2] > wide(0.5) * wide(PARKED):
            b = a.place[s]
            at = cell_at(b, wrapped(x[0], b.cell, b.gx), wrapped(x[1], b.cell, b.gy), wrapped(x[2], b.cell, b.gz))
            c = s * a.cells + at
            place = wp.atomic_add(a.cell_count, c, 1)
            if place < a.depth:
                a.cell_rows[c * a.depth + place] = i - s * a.cap
            else:
                wp.atomic_max(a.overflow, 3 * s + 1, place + 1)


@func
def look_around(a: System, p: Words, m: Material, s: int, r: int, g: Grain, lane: int):
    """Put the rows near row r into its new list, in any order. How many, where no other threads share the grain."""
    i = s * a.cap + r
    b = a.place[s]
    cx = wrapped(g.x[0], b.cell, b.gx)
    cy = wrapped(g.x[1], b.cell, b.gy)
    cz = wrapped(g.x[2], b.cell, b.gz)
    across = 2 * REACH + 1
    found = int(0)
    for side in range(lane, across * across * across, LANES):
        dx = side % across - REACH
        dy = side // across % across - REACH
        dz = side // (across * across) - REACH
        # a lattice one cell thick is its own neighbour: look there once
        if (b.gx > 1 or dx == 0) and (b.gy > 1 or dy == 0) and (b.gz > 1 or dz == 0):
            c = s * a.cells + cell_at(b, cx + dx, cy + dy, cz + dz)
            for e in range(min(a.cell_count[c], a.depth)):
                o = a.cell_rows[c * a.depth + e]
                d2 = apart2(p, m, g, s * a.cap + o)
                if d2 < listed2(a, m, i, s * a.cap + o) and o != r:
                    if SHARED:
                        found = wp.atomic_add(a.found, i, 1)
                    if found < a.near:
                        to = entry(a, s, a.near, found, r)
                        a.new_key[to] = wp.float32(d2)
                        a.new_nbr[to] = o
                    found = found + 1
    return found


@kernel
def gather(a: System, p: Words):
    """Where threads share a grain: let them look for its neighbours together."""
    thread = wp.tid()
    i = thread // LANES
    s = i // a.cap
    r = i - s * a.cap
    if a.flag[s] == 1 and r < a.rows[s]:
        m = material(a, s)
        g = grain(p, m, i)
        if g.x[2] > wide(0.5) * wide(PARKED):
            look_around(a, p, m, s, r, g, thread - i * LANES)


@kernel
def build(a: System, p: Words):
    """List the neighbours of each grain by distance, so that those that touch come first, and carry springs over."""
    i = wp.tid()
    s = i // a.cap
    r = i - s * a.cap
    if a.flag[s] == 1 and r < a.rows[s]:
        m = material(a, s)
        g = grain(p, m, i)
        mark(a, i, g)
        found = int(0)
        near = wp.uint32(0)
        if g.x[2] > wide(0.5) * wide(PARKED):
            if SHARED:
                found = a.found[i]
                a.found[i] = 0
            else:
                found = look_around(a, p, m, s, r, g, 0)
            # sorted after all are found: threads side by side find theirs one after another, but sort at the same time
            for k in range(1, min(found, a.near)):
                at = entry(a, s, a.near, k, r)
                insert(a, s, r, k, a.new_nbr[at], a.new_key[at])
            if found > a.near:
                wp.atomic_max(a.overflow, 3 * s, found)
                found = a.near
            if ANY_WALLS:
                near = near_walls(a, m, s, r, g)
        if ANY_WALLS:
            a.wall_near[i] = near
            if near == wp.uint32(0):  # nobody will look at its springs again
                a.wall_held[i] = near
        carry(a, s, r, i, found)


@func
def near_walls(a: System, m: Material, s: int, r: int, g: Grain):
    """The entries of row r at walls that it may touch before its list is built again, WALL_PARTS each, as bits."""
    near = wp.uint32(0)
    if LISTED:
        near = seat_walls(a, m, s, r, g)
    else:
        for q in range(a.place[s].walls):
            near = near | (parts_near(a, m, g, s * a.walls + q) << wp.uint32(q * WALL_PARTS))
    return near


@func
def seat_walls(a: System, m: Material, s: int, r: int, g: Grain):
    """`near_walls` where members have more walls than a grain has entries for: one that stays near keeps its own."""
    i = s * a.cap + r
    every = wp.uint32((1 << WALL_PARTS) - 1)
    was = a.wall_near[i]
    held = a.wall_held[i]
    near = wp.uint32(0)
    crowd = int(0)
    for q in range(a.seats):
        if (was >> wp.uint32(q * WALL_PARTS)) & every != wp.uint32(0):
            near = near | (parts_near(a, m, g, wall_at(a, s, r, q)) << wp.uint32(q * WALL_PARTS))
    for w in range(a.place[s].walls):
        mine = int(-1)
        free = int(-1)
        for q in range(a.seats):
            if (near >> wp.uint32(q * WALL_PARTS)) & every == wp.uint32(0):
                free = q
            elif a.wall_seat[entry(a, s, a.seats, q, r)] == w:
                mine = q
        if mine >= 0:
            crowd = crowd + 1
        else:
            parts = parts_near(a, m, g, s * a.walls + w)
            if parts != wp.uint32(0):
                crowd = crowd + 1
                if free >= 0:
                    a.wall_seat[entry(a, s, a.seats, free, r)] = w
                    near = near | (parts << wp.uint32(free * WALL_PARTS))
                    held = held & ~(every << wp.uint32(free * WALL_PARTS))
    a.wall_held[i] = held
    if crowd > a.seats:
        wp.atomic_max(a.overflow, 3 * s + 2, crowd)
    return near


@func
def insert(a: System, s: int, r: int, found: int, o: int, key: float32):
    """Put row o into the new list of row r, which is kept in order of distance."""
    k = int(found)
    while k > 0 and a.new_key[entry(a, s, a.near, wp.max(k - 1, 0), r)] > key:
        to = entry(a, s, a.near, k, r)
        a.new_key[to] = a.new_key[to - a.cap]
        a.new_nbr[to] = a.new_nbr[to - a.cap]
        k = k - 1
    to = entry(a, s, a.near, k, r)
    a.new_key[to] = key
    a.new_nbr[to] = o


@func
def carry(a: System, s: int, r: int, i: int, found: int):
    """Replace the list of row r by the new one, with the springs that are held."""
    old = a.held[i]
    held = wp.uint32(0)
    count = a.count[i]
    if FRICTION:
        for k in range(found):
            to = entry(a, s, a.near, k, r)
            o = a.new_nbr[to]
            for b in range(count):
                if has_bit(old, b):
                    at = entry(a, s, a.near, b, r)
                    if a.nbr[at] == o:
                        a.new_spring[to] = a.spring[at]
                        if ROLLING_SPRING:
                            a.new_rolling[to] = a.rolling[at]
                        held = held | (wp.uint32(1) << wp.uint32(k))
    for k in range(found):
        to = entry(a, s, a.near, k, r)
        a.nbr[to] = a.new_nbr[to]
        if FRICTION:
            if has_bit(held, k):
                a.spring[to] = a.new_spring[to]
                if ROLLING_SPRING:
                    a.rolling[to] = a.new_rolling[to]
    a.count[i] = found
    a.held[i] = held


@kernel
def finish(a: System):
    """Count the rebuild; members whose lists or cells did not fit rest until the host has made room."""
    s = wp.tid()
    if a.flag[s] == 1:
        a.rebuilds[s] = a.rebuilds[s] + 1
        a.flag[s] = 0
        if a.overflow[3 * s] > 0 or a.overflow[3 * s + 1] > 0 or a.overflow[3 * s + 2] > 0:
            a.rows[s] = 0
    a.any_flag[0] = 0
