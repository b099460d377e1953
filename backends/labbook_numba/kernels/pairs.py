"""Forces of grains on grains, a block of touching pairs at a time: pack, gather, law, scatter."""

from labbook_dem.words import VARIED, real, wide

from labbook_numba.kernels.blocks import GAP, HELD, NX, NY, NZ, largest_gap, pair_law, where_gap
from labbook_numba.kernels.bodies import eight_reaches, gather_bodies, gather_coefficients
from labbook_numba.kernels.features import (
    BLOCK,
    BORROWED,
    FAIL_GRAIN,
    FIRST_PAIR,
    FRICTION,
    GHOSTS,
    GRAIN,
    KINDS,
    LAST_PAIR,
    LEDGER,
    MAX_OVERLAP,
    TOUCHING,
    X,
    int64,
    kernel,
    uint64,
)
from labbook_numba.kernels.transfer import fill_up, gather_pairs, gather_springs, scatter_forces, scatter_springs
from labbook_numba.rows import columns, rows_at
from labbook_numba.squeeze import both, exchange, first_of, how_many, positive, squeeze, squeeze_numbers, squeeze_places
from labbook_numba.state import Params, State


@kernel
def pack_pairs(grains, pair_i, pair_j, held, b, block_i, block_j, slot, first, last, body, reach2):
    """Bring those of the listed pairs first..last that touch into the block; how many they are.

    Branch and gap ((r_i + r_j)^2 - r^2) go to columns, grains to `block_i` and `block_j`, list entries to `slot`. Gaps
    are small differences: they are taken in double, whatever the block holds.
    """
    count = uint64(0)
    for k in range(first, last, uint64(8)):
        x, y, z, _ = columns(rows_at(grains, pair_i, k, GRAIN, X) - rows_at(grains, pair_j, k, GRAIN, X))
        gap = eight_reaches(body, pair_i, pair_j, k, reach2) - (x * x + y * y + z * z)
        here = first_of(last - k)
        touching = both(positive(gap), here)
        squeeze(b, NX + count, x, touching)
        squeeze(b, NY + count, y, touching)
        squeeze(b, NZ + count, z, touching)
        squeeze(b, GAP + count, gap, touching)
        if FRICTION:
            squeeze(b, HELD + count, exchange(held, k, touching, here), touching)
            squeeze_places(slot, count, k, touching)
        squeeze_numbers(block_i, count, pair_i, k, touching)
        squeeze_numbers(block_j, count, pair_j, k, touching)
        count += how_many(touching)
    return count


@kernel
def pair_forces(st: State, p: Params):
    """Add the forces of grains on grains to f and t; note touching pairs, the largest overlap, and whose it is."""
    part = st.part
    st.sums[MAX_OVERLAP] = wide(0.0)
    if LEDGER:
        st.count[TOUCHING] = 0
    # rows are first of all second in their pairs, and those that stand before this part come first
    listed_forces(st, p, st.borrowed_i, st.borrowed_j, st.borrowed_held, st.borrowed_spring, int64(0), part[BORROWED])
    listed_forces(st, p, st.pair_i, st.pair_j, st.held, st.spring, part[FIRST_PAIR], part[LAST_PAIR])


@kernel
def listed_forces(st: State, p: Params, pair_i, pair_j, held, spring, first, end):
    """What `pair_forces` does, of the listed pairs first..end."""
    last = uint64(end)
    b = st.block
    i = st.block_i
    j = st.block_j
    slot = st.slot
    diameter = wide(2.0) * p.radius
    reach2 = diameter * diameter
    half_dt = wide(0.5) * p.dt
    ghost = len(st.grains) - GHOSTS
    spare = len(spring) - 1
    touching = uint64(0)
    deepest = st.sums[MAX_OVERLAP]
    # kernels of a block take arrays, not the State: its many references would be counted at every call
    for k in range(uint64(first), last, BLOCK):
        end = min(k + BLOCK, last)
        count = pack_pairs(st.grains, pair_i, pair_j, held, b, i, j, slot, k, end, st.body, reach2)
        fill_up(i, j, slot, count, ghost, spare)
        gather_pairs(st.grains, i, j, b, count)
        if FRICTION:
            gather_springs(spring, slot, b, count, half_dt)
        if VARIED:
            gather_bodies(st.body, i, j, b, count, True)
            if KINDS > 1:
                gather_coefficients(p.pair_c, int64(0), st.body, i, j, b, count, True)
        pair_law(b, count, p.c, real(p.radius), real(p.mass), real(p.inertia), real(p.dt))
        scatter_forces(st.loads, i, j, b, count, True)
        if FRICTION:
            scatter_springs(spring, slot, b, count)
        touching += count
        overlap = largest_gap(b, st.bits, count)
        if not overlap <= deepest:
            deepest = overlap
            if not deepest <= p.overlap_limit:
                st.count[FAIL_GRAIN] = st.ids[i[where_gap(b, count, overlap)]]
    st.sums[MAX_OVERLAP] = deepest
    if LEDGER:
        st.count[TOUCHING] += touching
