"""Lists of near grains and near walls, rebuilt when a grain may have moved half a skin; springs are carried over."""

import numpy as np
from labbook_dem.words import wide

from labbook_numba.kernels.features import (
    ANY_WALLS,
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
    WANT_PAIRS,
    WANT_WALLS,
    X,
    kernel,
)
from labbook_numba.kernels.walls import load, wall_distance
from labbook_numba.state import Params, State


@kernel
def pad_pairs(pair_i, pair_j, pairs, rows):
    """Put pairs of ghosts, which do not touch, behind the last."""
    for k in range(pairs, pairs + PAD):
        pair_i[k] = rows - GHOSTS
        pair_j[k] = rows - 1


@kernel
def drop_leavers(st: State, p: Params):
    """Take out grains below p.drop, keeping the order of the others, and renumber lists."""
    n = st.count[GRAINS]
    low = 0
    for i in range(n):
        low += st.grains[i, X + 2] < p.drop
    if low == 0:
        return
    place = np.full(n, -1, np.int64)
    kept = 0
    for i in range(n):
        if not st.grains[i, X + 2] < p.drop:
            place[i] = kept
            for c in range(GRAIN):
                st.grains[kept, c] = st.grains[i, c]
            for c in range(LOAD):
                st.loads[kept, c] = st.loads[i, c]
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
def cells_of(st: State, reach):
    """Cell of each grain in a grid no finer than `reach` [m], and the grid's three sizes; at most 4 cells a grain."""
    n = st.count[GRAINS]
    low = np.empty(3)
    span = np.empty(3)
    for c in range(3):
        a = st.grains[0, X + c]
        b = a
        for i in range(1, n):
            a = min(a, st.grains[i, X + c])
            b = max(b, st.grains[i, X + c])
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
            cell[i, c] = min(np.int64((st.grains[i, X + c] - low[c]) / reach), size[c] - 1)
    return cell, size


@kernel
def near_pairs(st: State, p: Params, pair_i, pair_j):
    """Fill the list of pairs i < j closer than a diameter and a skin, i then j ascending; its length."""
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
    for i in range(n):
        start = found
        for a in range(max(cell[i, 0] - 1, 0), min(cell[i, 0] + 2, size[0])):
            for b in range(max(cell[i, 1] - 1, 0), min(cell[i, 1] + 2, size[1])):
                for c in range(max(cell[i, 2] - 1, 0), min(cell[i, 2] + 2, size[2])):
                    j = head[a, b, c]
                    while j > i:  # a cell's grains come in falling order
                        dx = st.grains[i, X + 0] - st.grains[j, X + 0]
                        dy = st.grains[i, X + 1] - st.grains[j, X + 1]
                        dz = st.grains[i, X + 2] - st.grains[j, X + 2]
                        if dx * dx + dy * dy + dz * dz < reach2:
                            if found < len(pair_j) - PAD:
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
def near_walls(st: State, p: Params, first, grain):
    """Fill the list of grains that could touch a wall before the next rebuild, wall by wall; its length."""
    found = 0
    first[0] = 0
    reach = p.radius + wide(0.5) * p.skin
    for w in range(len(p.wall_kind)):
        for i in range(st.count[GRAINS]):
            distance, _ = wall_distance(p.wall_shape, p.wall_kind, w, load(st.grains, i, X))
            if distance < reach:
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
        same = old < old_last and old_i[old] == i and old_j[old] == j
        held[k] = old_held[old] if same else 0
        for c in range(3):
            spring[k, c] = old_spring[old, c] if same else 0.0


@kernel
def rebuild(st: State, p: Params):
    """Rebuild all lists. False, and the lengths needed in WANT_*, if an array is too short: lists stay as they were."""
    if OUTLET:
        drop_leavers(st, p)
    n = st.count[GRAINS]
    if n == 0:
        return True
    pair_i = np.empty(len(st.pair_i), np.int32)
    pair_j = np.empty(len(st.pair_j), np.int32)
    pairs = near_pairs(st, p, pair_i, pair_j)
    wall_first = np.zeros(len(st.wall_first), np.int64)
    wall_grain = np.empty(len(st.wall_grain), np.int32)
    walls = near_walls(st, p, wall_first, wall_grain) if ANY_WALLS else 0
    if pairs > len(pair_j) - PAD or walls > len(wall_grain) - PAD:
        st.count[WANT_PAIRS] = pairs
        st.count[WANT_WALLS] = walls
        return False
    if FRICTION:
        m = st.count[PAIRS]
        spring = st.spring[:m].copy()
        carry(
            0, m, st.pair_i, st.pair_j, st.held[:m].copy(), spring,
            0, pairs, pair_i, pair_j, st.held, st.spring,
        )  # fmt: skip
        m = st.wall_first[len(p.wall_kind)]
        wall_held = st.wall_held[:m].copy()
        wall_spring = st.wall_spring[:m].copy()
        for w in range(len(p.wall_kind)):
            carry(
                st.wall_first[w], st.wall_first[w + 1], st.wall_grain, st.wall_grain, wall_held, wall_spring,
                wall_first[w], wall_first[w + 1], wall_grain, wall_grain, st.wall_held, st.wall_spring,
            )  # fmt: skip
    st.pair_i[:pairs] = pair_i[:pairs]
    st.pair_j[:pairs] = pair_j[:pairs]
    pad_pairs(st.pair_i, st.pair_j, pairs, len(st.grains))
    st.wall_first[:] = wall_first
    st.wall_grain[:walls] = wall_grain[:walls]
    st.count[PAIRS] = pairs
    st.sums[MOVED] = 0.0
    st.count[REBUILDS] += 1
    return True
