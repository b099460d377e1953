"""Lists of near neighbours and near walls, rebuilt per member when one of its grains has moved too far.

Cells lie on a lattice that is wrapped around to a member's few hundred or thousand; wrapped neighbours drop out by
their distance. A cell holds a fixed number of grains: their order, which is by chance, decides nothing.
"""

from __future__ import annotations

from labbook_dem.words import FRICTION, dot, func, sqrt, wide

from labbook_warp.kernels.bodies import body, listed2
from labbook_warp.kernels.mixed import position, velocity
from labbook_warp.kernels.system import Place, System, entry, has_bit, material
from labbook_warp.kernels.walls import wall_distance
from labbook_warp.kernels.words import ANY_WALLS, PARKED, Words, float32, kernel, widen, wp


@kernel
def check(a: System, p: Words, every: int):
    """Ask for a rebuild if a grain could have moved by half of the skin before the next check, `every` steps on.

    A grain that has already moved farther (it was hit in between) was checked `late`: the beat is taken again,
    with checks more often. Checked at every step, lists are never older than half of the skin.
    """
    i = wp.tid()
    s = i // a.cap
    if i - s * a.cap < a.rows[s]:
        x = position(p, i)
        if x[2] > wide(0.5) * wide(PARKED):
            m = material(a, s)
            away = x - a.origin[i]
            moved = sqrt(dot(away, away))
            v = widen(velocity(p, i))
            if every > 1 and not moved <= m.half_skin:
                a.late[s] = 1
            ahead = wide(1.5) * sqrt(dot(v, v)) * m.dt * wide(every)
            if not moved + ahead <= m.half_skin:
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
def cell_at(b: Place, cx: int, cy: int, cz: int):
    """Number of a cell of one member, from cell numbers that may lie one beyond the lattice."""
    x = (cx + b.gx) % b.gx
    y = (cy + b.gy) % b.gy
    z = (cz + b.gz) % b.gz
    return (z * b.gy + y) * b.gx + x


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
        x = position(p, i)
        if x[2] > wide(0.5) * wide(PARKED):
            b = a.place[s]
            at = cell_at(b, wrapped(x[0], b.cell, b.gx), wrapped(x[1], b.cell, b.gy), wrapped(x[2], b.cell, b.gz))
            c = s * a.cells + at
            place = wp.atomic_add(a.cell_count, c, 1)
            if place < a.depth:
                a.cell_rows[c * a.depth + place] = i - s * a.cap
            else:
                wp.atomic_max(a.overflow, 2 * s + 1, place + 1)


@kernel
def build(a: System, p: Words):
    """List the neighbours of each grain by distance, so that those that touch come first, and carry springs over."""
    i = wp.tid()
    s = i // a.cap
    r = i - s * a.cap
    if a.flag[s] == 1 and r < a.rows[s]:
        x = position(p, i)
        a.origin[i] = x
        found = int(0)
        near = wp.uint32(0)
        if x[2] > wide(0.5) * wide(PARKED):
            m = material(a, s)
            b = a.place[s]
            cx = wrapped(x[0], b.cell, b.gx)
            cy = wrapped(x[1], b.cell, b.gy)
            cz = wrapped(x[2], b.cell, b.gz)
            for side in range(27):
                dx = side % 3 - 1
                dy = side // 3 % 3 - 1
                dz = side // 9 - 1
                # a lattice one cell thick is its own neighbour: look there once
                if (b.gx > 1 or dx == 0) and (b.gy > 1 or dy == 0) and (b.gz > 1 or dz == 0):
                    c = s * a.cells + cell_at(b, cx + dx, cy + dy, cz + dz)
                    for e in range(min(a.cell_count[c], a.depth)):
                        o = a.cell_rows[c * a.depth + e]
                        away = x - position(p, s * a.cap + o)
                        d2 = dot(away, away)
                        if d2 < listed2(a, m, i, s * a.cap + o) and o != r:
                            if found < a.near:
                                insert(a, s, r, found, o, wp.float32(d2))
                            found = found + 1
            if found > a.near:
                wp.atomic_max(a.overflow, 2 * s, found)
                found = a.near
            if ANY_WALLS:
                for q in range(a.place[s].walls):
                    distance, _normal = wall_distance(a, s * a.walls + q, x)
                    if distance < body(a, m, i).reach + m.half_skin:
                        near = near | (wp.uint32(1) << wp.uint32(q))
        if ANY_WALLS:
            a.wall_near[i] = near
            a.wall_held[i] = a.wall_held[i] & near
        carry(a, s, r, i, found)


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
                at = entry(a, s, a.near, b, r)
                if a.nbr[at] == o and has_bit(old, b):
                    a.new_spring[to] = a.spring[at]
                    held = held | (wp.uint32(1) << wp.uint32(k))
    for k in range(found):
        to = entry(a, s, a.near, k, r)
        a.nbr[to] = a.new_nbr[to]
        if FRICTION:
            if has_bit(held, k):
                a.spring[to] = a.new_spring[to]
    a.count[i] = found
    a.held[i] = held


@kernel
def finish(a: System):
    """Count the rebuild; members whose lists or cells did not fit rest until the host has made room."""
    s = wp.tid()
    if a.flag[s] == 1:
        a.rebuilds[s] = a.rebuilds[s] + 1
        a.flag[s] = 0
        if a.overflow[2 * s] > 0 or a.overflow[2 * s + 1] > 0:
            a.rows[s] = 0
    a.any_flag[0] = 0
