"""Lists of near grains and near walls, rebuilt when a grain may have moved half a skin; springs are carried over."""

import numpy as np

from labbook_dem.words import wide
from labbook_numba.kernels.features import (
    ANY_WALLS,
    FRICTION,
    GRAINS,
    LEAVING,
    MOVED,
    OUTLET,
    PAIRS,
    REBUILDS,
    WALLS,
    kernel,
)
from labbook_numba.kernels.forces import load, wall_distance
from labbook_numba.state import Params, State


@kernel
def drop_leavers(st: State, p: Params):
    """Take out grains below p.drop, keeping the order of the others, and renumber lists."""
    n = st.count[GRAINS]
    place = np.full(n, -1, np.int64)
    kept = 0
    for i in range(n):
        if not st.x[i, 2] < p.drop:
            place[i] = kept
            kept += 1
    pairs = 0
    walls = 0
    first = st.row[0]
    wall_first = st.wall_row[0]
    for i in range(n):
        last = st.row[i + 1]
        wall_last = st.wall_row[i + 1]
        a = place[i]
        if a >= 0:
            for c in range(3):
                st.x[a, c] = st.x[i, c]
                st.v[a, c] = st.v[i, c]
                st.w[a, c] = st.w[i, c]
                st.u[a, c] = st.u[i, c]
                st.o[a, c] = st.o[i, c]
            st.ids[a] = st.ids[i]
            st.gone[a] = st.gone[i]
            for k in range(first, last):
                b = place[st.pair_j[k]]
                if b >= 0:
                    st.pair_j[pairs] = b
                    for c in range(3):
                        st.spring[pairs, c] = st.spring[k, c]
                    pairs += 1
            for k in range(wall_first, wall_last):
                st.wall_of[walls] = st.wall_of[k]
                for c in range(3):
                    st.wall_spring[walls, c] = st.wall_spring[k, c]
                walls += 1
            st.row[a + 1] = pairs
            st.wall_row[a + 1] = walls
        first = last
        wall_first = wall_last
    st.count[GRAINS] = kept
    st.count[PAIRS] = pairs
    st.count[WALLS] = walls
    st.count[LEAVING] = 0


@kernel
def cells_of(st: State, reach):
    """Cell of each grain in a grid no finer than `reach` [m], and the grid's three sizes; at most 4 cells a grain."""
    n = st.count[GRAINS]
    low = np.empty(3)
    span = np.empty(3)
    for c in range(3):
        a = st.x[0, c]
        b = a
        for i in range(1, n):
            a = min(a, st.x[i, c])
            b = max(b, st.x[i, c])
        low[c] = a
        span[c] = b - a
    size = np.ones(3, np.int64)
    while True:
        cells = wide(1.0)
        for c in range(3):
            cells *= np.floor(span[c] / reach) + wide(1.0)
        if cells <= wide(4.0) * n + wide(64.0):
            break
        reach *= wide(1.26)  # doubles the volume of a cell
    for c in range(3):
        size[c] = np.int64(span[c] / reach) + 1
    cell = np.empty((n, 3), np.int32)
    for i in range(n):
        for c in range(3):
            cell[i, c] = min(np.int64((st.x[i, c] - low[c]) / reach), size[c] - 1)
    return cell, size


@kernel
def near_pairs(st: State, p: Params, row, pair_j):
    """Fill the half list (i < j, j ascending) of grains closer than a diameter and a skin; its length."""
    n = st.count[GRAINS]
    reach = wide(2.0) * p.radius + p.skin
    reach2 = reach * reach
    cell, size = cells_of(st, reach)
    head = np.full((size[0], size[1], size[2]), -1, np.int32)
    following = np.empty(n, np.int32)
    for i in range(n):
        a, b, c = cell[i, 0], cell[i, 1], cell[i, 2]
        following[i] = head[a, b, c]
        head[a, b, c] = i
    found = 0
    row[0] = 0
    for i in range(n):
        start = found
        for a in range(max(cell[i, 0] - 1, 0), min(cell[i, 0] + 2, size[0])):
            for b in range(max(cell[i, 1] - 1, 0), min(cell[i, 1] + 2, size[1])):
                for c in range(max(cell[i, 2] - 1, 0), min(cell[i, 2] + 2, size[2])):
                    j = head[a, b, c]
                    while j > i:  # a cell's grains come in falling order
                        dx = st.x[i, 0] - st.x[j, 0]
                        dy = st.x[i, 1] - st.x[j, 1]
                        dz = st.x[i, 2] - st.x[j, 2]
                        if dx * dx + dy * dy + dz * dz < reach2:
                            if found < len(pair_j):
                                k = found
                                while k > start and pair_j[k - 1] > j:
                                    pair_j[k] = pair_j[k - 1]
                                    k -= 1
                                pair_j[k] = j
                            found += 1
                        j = following[j]
        row[i + 1] = found
    return found


@kernel
def near_walls(st: State, p: Params, row, wall_of):
    """Fill the list of walls that a grain could touch before the next rebuild; its length."""
    found = 0
    row[0] = 0
    reach = p.radius + wide(0.5) * p.skin
    for i in range(st.count[GRAINS]):
        x = load(st.x, i)
        for w in range(len(p.wall_kind)):
            distance, _ = wall_distance(p, w, x)
            if distance < reach:
                if found < len(wall_of):
                    wall_of[found] = w
                found += 1
        row[i + 1] = found
    return found


@kernel
def carry(n, old_row, old_key, old_spring, row, key, spring):
    """Springs of entries that are in both lists (rows ascending in key); zero for the new ones."""
    for i in range(n):
        old = old_row[i]
        end = old_row[i + 1]
        for k in range(row[i], row[i + 1]):
            while old < end and old_key[old] < key[k]:
                old += 1
            if old < end and old_key[old] == key[k]:
                for c in range(3):
                    spring[k, c] = old_spring[old, c]
            else:
                for c in range(3):
                    spring[k, c] = 0.0


@kernel
def rebuild(st: State, p: Params):
    """Rebuild all lists. False, and the lengths needed in count, if an array is too short: nothing has changed then."""
    if OUTLET and st.count[LEAVING] > 0:
        drop_leavers(st, p)
    n = st.count[GRAINS]
    if n == 0:
        return True
    row = np.empty(n + 1, np.int64)
    pair_j = np.empty(len(st.pair_j), np.int32)
    pairs = near_pairs(st, p, row, pair_j)
    wall_row = np.zeros(n + 1, np.int64)
    wall_of = np.empty(len(st.wall_of), np.int32)
    walls = near_walls(st, p, wall_row, wall_of) if ANY_WALLS else 0
    if pairs > len(pair_j) or walls > len(wall_of):
        st.count[PAIRS] = max(pairs, st.row[n])
        st.count[WALLS] = max(walls, st.wall_row[n])
        return False
    if FRICTION:
        old = st.spring[: st.row[n]].copy()
        carry(n, st.row, st.pair_j, old, row, pair_j, st.spring)
        wall_old = st.wall_spring[: st.wall_row[n]].copy()
        carry(n, st.wall_row, st.wall_of, wall_old, wall_row, wall_of, st.wall_spring)
    st.row[: n + 1] = row
    st.pair_j[:pairs] = pair_j[:pairs]
    st.wall_row[: n + 1] = wall_row
    st.wall_of[:walls] = wall_of[:walls]
    st.count[PAIRS] = pairs
    st.count[WALLS] = walls
    st.sums[MOVED] = 0.0
    st.count[REBUILDS] += 1
    return True
