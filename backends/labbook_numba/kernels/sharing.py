"""One scene stepped by several threads at once: which grains are whose, and how threads wait for each other.

A *part* is a range of rows. Its thread moves these grains and adds up all forces on them, also those of pairs whose
other grain is another part's: such a pair is computed by both. A part keeps its own copy of the springs of those pairs
whose first grain is another's (`borrowed`); as both compute the same, both stay the same. Sums so have the order that
they have in one thread, and no bit depends on the number of parts.
"""

from labbook_dem.words import wide

from labbook_numba.kernels.bodies import mass_of
from labbook_numba.kernels.features import (
    BORROWED,
    FIRST,
    FIRST_PAIR,
    FRICTION,
    GRAINS,
    LAST,
    LAST_PAIR,
    LOAD,
    NUMBER,
    PAIRS,
    PARTS,
    F,
    int64,
    kernel,
)
from labbook_numba.kernels.neighbours import pad_pairs
from labbook_numba.kernels.search import first_at_least
from labbook_numba.meeting import arrive, arrived, give_way
from labbook_numba.state import Params, State

NEAR_WORK = 2  # work of a near pair, in grains; so that parts take equally long


@kernel
def meet(meetings, parts):
    """Wait until all parts are here."""
    goal = (arrive(meetings) // parts + 1) * parts
    while arrived(meetings) < goal:
        give_way()


@kernel
def agree(st: State, column, value):
    """The largest of the values of all parts, or a NaN if one is among them. Columns take turns."""
    parts = st.part[PARTS]
    if parts > 1:
        st.told[st.part[NUMBER], column] = value
        meet(st.meetings, parts)
        for k in range(parts):
            other = st.told[k, column]
            if other != other:
                return other
            value = max(value, other)
    return value


@kernel
def row_after(st: State, work):
    """The first row before which, with its pairs, there is so much work."""
    first = int64(0)
    last = st.count[GRAINS]
    while first < last:
        middle = (first + last) // 2
        if middle + NEAR_WORK * first_at_least(st.pair_i, int64(0), st.count[PAIRS], middle) < work:
            first = middle + 1
        else:
            last = middle
    return first


@kernel
def take_part(st: State, p: Params):
    """Set which rows and pairs are this part's, and borrow the pairs that it shares with parts before it."""
    part = st.part
    pairs = st.count[PAIRS]
    work = st.count[GRAINS] + NEAR_WORK * pairs
    part[FIRST] = row_after(st, work * part[NUMBER] // part[PARTS])
    part[LAST] = row_after(st, work * (part[NUMBER] + 1) // part[PARTS])
    if part[NUMBER] + 1 == part[PARTS]:
        part[LAST] = st.count[GRAINS]
    part[FIRST_PAIR] = first_at_least(st.pair_i, int64(0), pairs, part[FIRST])
    part[LAST_PAIR] = first_at_least(st.pair_i, int64(0), pairs, part[LAST])
    part[BORROWED] = 0
    if part[PARTS] > 1:
        for i in range(part[FIRST], part[LAST]):
            for c in range(LOAD):
                st.loads[i, c] = wide(0.0)
            st.loads[i, F + 2] = -mass_of(st.body, i, p.mass) * p.gravity
        borrow(st)
        meet(st.meetings, part[PARTS])


@kernel
def borrow(st: State):
    """Copy the pairs of other parts' grains with those of this part that stand behind them."""
    first = st.part[FIRST]
    last = st.part[LAST]
    found = 0
    for k in range(st.part[FIRST_PAIR]):
        j = st.pair_j[k]
        if first <= j < last:
            st.borrowed_i[found] = st.pair_i[k]
            st.borrowed_j[found] = j
            st.borrowed_held[found] = st.held[k]
            if FRICTION:
                for c in range(3):
                    st.borrowed_spring[found, c] = st.spring[k, c]
            found += 1
    pad_pairs(st.borrowed_i, st.borrowed_j, found, len(st.grains))
    st.part[BORROWED] = found
