"""Lists of near grains and near walls, rebuilt when a grain may have moved half a skin; springs are copied."""

from labbook_dem.words import VARIED, wide

from labbook_numba.kernels.features import (
    ANY_WALLS,
    BODY,
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
    SPRING_KEPT,
    WALL_PARTS,
    WANT_PAIRS,
    WANT_WALLS,
    X,
    entry,
    int64,
    kernel,
)
from labbook_numba.kernels.near import near_pairs, near_walls
from labbook_numba.state import Grid, Lists, Params, State


@kernel
def pad_pairs(pair_i, pair_j, pairs, rows):
    """Write pairs of ghosts, which do not touch, behind the last pair: lists are read eight at a time."""
    for k in range(pairs, pairs + PAD):
        pair_i[k] = rows - GHOSTS
        pair_j[k] = rows - 1


@kernel
def drop_leavers(st: State, p: Params, new_rows):
    """Remove grains below p.drop, keep the order of the others, and renumber lists; new_rows: scratch for new rows."""
    n = st.count[GRAINS]
    new_row = 0
    for i in range(n):
        new_rows[i] = -1
        if not st.grains[i, X + 2] < p.drop:  # so written that a grain at NaN stays, and a guard reports it
            new_rows[i] = new_row  # rows keep their order, so that lists still ascend
            for c in range(GRAIN):
                st.grains[new_row, c] = st.grains[i, c]
            for c in range(LOAD):
                st.loads[new_row, c] = st.loads[i, c]
            if VARIED:
                for c in range(BODY):
                    st.body[new_row, c] = st.body[i, c]
            st.ids[new_row] = st.ids[i]
            st.gone[new_row] = st.gone[i]
            new_row += 1
    st.count[GRAINS] = new_row
    st.count[LEAVING] = 0
    pairs = 0
    for k in range(st.count[PAIRS]):
        a = new_rows[st.pair_i[k]]
        b = new_rows[st.pair_j[k]]
        if a >= 0 and b >= 0:
            st.pair_i[pairs] = a
            st.pair_j[pairs] = b
            st.held[pairs] = st.held[k]
            for c in range(int64(SPRING_KEPT)):
                st.spring[pairs, c] = st.spring[k, c]
            pairs += 1
    pad_pairs(st.pair_i, st.pair_j, pairs, len(st.grains))
    st.count[PAIRS] = pairs
    walls = 0
    first = 0
    for w in range(len(p.wall_kind)):
        # wall_first[w + 1] is overwritten below: the old beginning of the next wall is kept in `first`
        last = st.wall_first[w + 1]
        for k in range(first, last):
            a = new_rows[st.wall_grain[k]]
            if a >= 0:
                st.wall_grain[walls] = a
                st.wall_held[walls] = st.wall_held[k]
                for part in range(WALL_PARTS):
                    for c in range(int64(SPRING_KEPT)):
                        st.wall_spring[walls * WALL_PARTS + part, c] = st.wall_spring[k * WALL_PARTS + part, c]
                walls += 1
        first = last
        st.wall_first[w + 1] = walls


@kernel
def copy_springs(
    per_entry, old, old_last, old_i, old_j, old_held, old_spring, first, last, new_i, new_j, new_held, new_spring
):
    """Copy springs from the old list to the new one, for entries in both; each list ascends in (i, j).

    New entries have no spring. per_entry: springs of one entry.
    """
    # both lists ascend, so that one pass over each finds all common entries
    for k in range(first, last):
        i, j = new_i[k], new_j[k]
        while old < old_last and (old_i[old] < i or (old_i[old] == i and old_j[old] < j)):
            old += 1
        if old < old_last and old_i[old] == i and old_j[old] == j:
            new_held[k] = old_held[old]
            for part in range(per_entry):
                for c in range(int64(SPRING_KEPT)):
                    new_spring[k * per_entry + part, c] = old_spring[old * per_entry + part, c]


@entry
def rebuild(st: State, p: Params, new: Lists, grid: Grid):
    """Rebuild all lists. Returns False, and the needed lengths in WANT_*, if an array of `new` is too short."""
    if OUTLET and st.count[LEAVING] > 0:
        drop_leavers(st, p, grid.new_rows)
    n = st.count[GRAINS]
    pairs = 0
    if n > 0:
        pairs = near_pairs(st, p, new.pair_i, new.pair_j, grid.cell, grid.head, grid.next_grain)
    walls = 0
    if ANY_WALLS:
        walls = near_walls(st, p, new.wall_first, new.wall_grain)
    if pairs > len(new.pair_j) - PAD or walls > len(new.wall_grain) - PAD:
        st.count[WANT_PAIRS] = pairs
        st.count[WANT_WALLS] = walls
        return False
    if FRICTION:
        copy_springs(
            int64(1), int64(0), st.count[PAIRS], st.pair_i, st.pair_j, st.held, st.spring,
            int64(0), int64(pairs), new.pair_i, new.pair_j, new.held, new.spring,
        )  # fmt: skip
        for w in range(len(p.wall_kind)):
            copy_springs(
                int64(WALL_PARTS), st.wall_first[w], st.wall_first[w + 1], st.wall_grain, st.wall_grain, st.wall_held,
                st.wall_spring, new.wall_first[w], new.wall_first[w + 1], new.wall_grain, new.wall_grain, new.wall_held,
                new.wall_spring,
            )  # fmt: skip
    pad_pairs(new.pair_i, new.pair_j, pairs, len(st.grains))
    st.count[PAIRS] = pairs
    st.sums[MOVED] = wide(0.0)
    st.count[REBUILDS] += 1
    return True
