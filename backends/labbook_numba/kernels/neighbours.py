"""Lists of near grains and near walls, rebuilt when a grain may have moved half a skin; springs are carried over."""

import numpy as np

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
    PARTS,
    REBUILDS,
    WANT_PAIRS,
    WANT_WALLS,
    X,
    kernel,
)
from labbook_numba.kernels.near import near_pairs, near_walls
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
                for part in range(PARTS):
                    for c in range(3):
                        st.wall_spring[walls * PARTS + part, c] = st.wall_spring[k * PARTS + part, c]
                walls += 1
        first = last
        st.wall_first[w + 1] = walls


@kernel
def carry(parts, old, old_last, old_i, old_j, old_held, old_spring, first, last, new_i, new_j, held, spring):
    """Springs of entries that are in both lists, each ascending in (i, j); new entries hold none; each has `parts`."""
    for k in range(first, last):
        i, j = new_i[k], new_j[k]
        while old < old_last and (old_i[old] < i or (old_i[old] == i and old_j[old] < j)):
            old += 1
        same = old < old_last and old_i[old] == i and old_j[old] == j
        held[k] = old_held[old] if same else 0
        for part in range(parts):
            for c in range(3):
                spring[k * parts + part, c] = old_spring[old * parts + part, c] if same else 0.0


@kernel
def rebuild(st: State, p: Params):
    """Rebuild all lists. False, and the lengths needed in WANT_*, if an array is too short: lists stay as they were."""
    if OUTLET and st.count[LEAVING] > 0:
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
            1, 0, m, st.pair_i, st.pair_j, st.held[:m].copy(), spring,
            0, pairs, pair_i, pair_j, st.held, st.spring,
        )  # fmt: skip
        m = st.wall_first[len(p.wall_kind)]
        wall_held = st.wall_held[:m].copy()
        wall_spring = st.wall_spring[: m * PARTS].copy()
        for w in range(len(p.wall_kind)):
            carry(
                PARTS, st.wall_first[w], st.wall_first[w + 1], st.wall_grain, st.wall_grain, wall_held, wall_spring,
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
