"""Lists of near grains and near walls, rebuilt when a grain may have moved half a skin; springs are carried over."""

import numpy as np
from labbook_dem.words import VARIED, func, wide

from labbook_numba.kernels.bodies import radius_of
from labbook_numba.kernels.features import (
    ANY_WALLS,
    BODY,
    CELLS,
    FRICTION,
    GHOSTS,
    GRAIN,
    GRAINS,
    LEAVING,
    LOAD,
    MOVED,
    OUTLET,
    PAD,
    PAIRS,
    REBUILDS,
    SPARE_CELLS,
    WANT_PAIRS,
    WANT_WALLS,
    X,
    entry,
    int64,
    kernel,
)
from labbook_numba.kernels.walls import load, wall_distance
from labbook_numba.state import Grid, Lists, Params, State


@kernel
def pad_pairs(pair_i, pair_j, pairs, rows):
    """Put pairs of ghosts, which do not touch, behind the last."""
    for k in range(pairs, pairs + PAD):
        pair_i[k] = rows - GHOSTS
        pair_j[k] = rows - 1


@kernel
def drop_leavers(st: State, p: Params, place):
    """Take out grains below p.drop, keeping the order of the others, and renumber lists; `place`: their new rows."""
    n = st.count[GRAINS]
    kept = 0
    for i in range(n):
        place[i] = -1
        if not st.grains[i, X + 2] < p.drop:
            place[i] = kept
            for c in range(GRAIN):
                st.grains[kept, c] = st.grains[i, c]
            for c in range(LOAD):
                st.loads[kept, c] = st.loads[i, c]
            if VARIED:
                for c in range(BODY):
                    st.body[kept, c] = st.body[i, c]
            st.ids[kept] = st.ids[i]
            st.gone[kept] = st.gone[i]
            kept += 1
    st.count[GRAINS] = kept
    st.count[LEAVING] = 0
    pairs = 0
    for k in range(st.count[PAIRS]):
        a = place[st.pair_i[k]]
        b = place[st.pair_j[k]]
        if a >= 0 and b >= 0:
            st.pair_i[pairs] = a
            st.pair_j[pairs] = b
            st.held[pairs] = st.held[k]
            for c in range(3):
                st.spring[pairs, c] = st.spring[k, c]
            pairs += 1
    pad_pairs(st.pair_i, st.pair_j, pairs, len(st.grains))
    st.count[PAIRS] = pairs
    walls = 0
    first = 0
    for w in range(len(p.wall_kind)):
        last = st.wall_first[w + 1]
        for k in range(first, last):
            a = place[st.wall_grain[k]]
            if a >= 0:
                st.wall_grain[walls] = a
                st.wall_held[walls] = st.wall_held[k]
                for c in range(3):
                    st.wall_spring[walls, c] = st.wall_spring[k, c]
                walls += 1
        first = last
        st.wall_first[w + 1] = walls


@kernel
def extent(grains, n, column):
    """Lowest coordinate [m] of n grains in a column, and how far the highest is from it."""
    low = grains[0, column]
    high = low
    for i in range(1, n):
        low = min(low, grains[i, column])
        high = max(high, grains[i, column])
    return low, high - low


@func
def cells(length, size):
    """How many cells of a size a length reaches into."""
    return np.floor(length / size) + wide(1.0)


@kernel
def cells_of(grains, n, size, cell):
    """Set the cell of each of n grains, in a grid no finer than `size` [m]; the grid's three sizes."""
    x, dx = extent(grains, n, X + 0)
    y, dy = extent(grains, n, X + 1)
    z, dz = extent(grains, n, X + 2)
    while cells(dx, size) * cells(dy, size) * cells(dz, size) > CELLS * n + SPARE_CELLS:
        size *= wide(1.26)  # doubles the volume of a cell
    nx, ny, nz = int64(cells(dx, size)), int64(cells(dy, size)), int64(cells(dz, size))
    for i in range(n):
        # no more than the last, however divisions are rounded
        cell[i, 0] = min(int64((grains[i, X + 0] - x) / size), nx - 1)
        cell[i, 1] = min(int64((grains[i, X + 1] - y) / size), ny - 1)
        cell[i, 2] = min(int64((grains[i, X + 2] - z) / size), nz - 1)
    return nx, ny, nz


@kernel
def near_pairs(grains, body, n, reach, skin, pair_i, pair_j, cell, head, following):
    """Fill the list of pairs i < j of n grains closer than `reach` [m], i then j ascending; its length.

    Where grains differ, `reach` is that of the largest, and pairs are listed within their radii and `skin` [m].
    """
    nx, ny, nz = cells_of(grains, n, reach, cell)
    for k in range(nx * ny * nz):
        head[k] = -1
    for i in range(n):
        at = (cell[i, 0] * ny + cell[i, 1]) * nz + cell[i, 2]
        following[i] = head[at]
        head[at] = i
    room = len(pair_j) - PAD
    found = 0
    for i in range(n):
        start = found
        x, y, z = grains[i, X + 0], grains[i, X + 1], grains[i, X + 2]
        for a in range(max(cell[i, 0] - 1, 0), min(cell[i, 0] + 2, nx)):
            for b in range(max(cell[i, 1] - 1, 0), min(cell[i, 1] + 2, ny)):
                for c in range(max(cell[i, 2] - 1, 0), min(cell[i, 2] + 2, nz)):
                    j = head[(a * ny + b) * nz + c]
                    while j > i:  # a cell's grains come in falling order
                        dx, dy, dz = x - grains[j, X + 0], y - grains[j, X + 1], z - grains[j, X + 2]
                        far = body[i, 0] + body[j, 0] + skin if VARIED else reach
                        if dx * dx + dy * dy + dz * dz < far * far:
                            if found < room:
                                k = found
                                while k > start and pair_j[k - 1] > j:
                                    pair_j[k] = pair_j[k - 1]
                                    k -= 1
                                pair_j[k] = j
                                pair_i[found] = i
                            found += 1
                        j = following[j]
    return found


@kernel
def near_walls(grains, body, n, radius, skin, shape, kind, first, grain):
    """Fill the list of those of n grains that are within radius and half a skin [m] of a wall, wall by wall; its
    length."""
    found = 0
    first[0] = 0
    for w in range(len(kind)):
        for i in range(n):
            distance, _ = wall_distance(shape, kind, w, load(grains, i, X))
            if distance < radius_of(body, i, radius) + wide(0.5) * skin:
                if found < len(grain) - PAD:
                    grain[found] = i
                found += 1
        first[w + 1] = found
    return found


@kernel
def carry(old, old_last, old_i, old_j, old_held, old_spring, first, last, new_i, new_j, held, spring):
    """Springs of entries that are in both lists, each ascending in (i, j); new entries hold none."""
    for k in range(first, last):
        i, j = new_i[k], new_j[k]
        while old < old_last and (old_i[old] < i or (old_i[old] == i and old_j[old] < j)):
            old += 1
        if old < old_last and old_i[old] == i and old_j[old] == j:
            held[k] = old_held[old]
            for c in range(3):
                spring[k, c] = old_spring[old, c]


@entry
def rebuild(st: State, p: Params, new: Lists, grid: Grid):
    """Make all lists new. False, and the lengths needed in WANT_*, if an array of `new` is too short."""
    if OUTLET and st.count[LEAVING] > 0:
        drop_leavers(st, p, grid.place)
    n = st.count[GRAINS]
    skin = p.skin
    pairs = 0
    if n > 0:
        reach = wide(2.0) * p.radius + skin
        pairs = near_pairs(
            st.grains, st.body, n, reach, skin, new.pair_i, new.pair_j, grid.cell, grid.head, grid.following
        )
    walls = 0
    if ANY_WALLS:
        walls = near_walls(
            st.grains, st.body, n, p.radius, skin, p.wall_shape, p.wall_kind, new.wall_first, new.wall_grain
        )
    if pairs > len(new.pair_j) - PAD or walls > len(new.wall_grain) - PAD:
        st.count[WANT_PAIRS] = pairs
        st.count[WANT_WALLS] = walls
        return False
    if FRICTION:
        carry(
            int64(0), st.count[PAIRS], st.pair_i, st.pair_j, st.held, st.spring,
            int64(0), int64(pairs), new.pair_i, new.pair_j, new.held, new.spring,
        )  # fmt: skip
        for w in range(len(p.wall_kind)):
            carry(
                st.wall_first[w], st.wall_first[w + 1], st.wall_grain, st.wall_grain, st.wall_held, st.wall_spring,
                new.wall_first[w], new.wall_first[w + 1], new.wall_grain, new.wall_grain, new.wall_held,
                new.wall_spring,
            )  # fmt: skip
    pad_pairs(new.pair_i, new.pair_j, pairs, len(st.grains))
    st.count[PAIRS] = pairs
    st.sums[MOVED] = wide(0.0)
    st.count[REBUILDS] += 1
    return True
