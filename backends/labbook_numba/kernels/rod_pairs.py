"""Forces of rods on rods, a block of near pairs at a time: closest points, pack, gather, law, scatter."""

from labbook_dem.contact import rolling_rate
from labbook_dem.words import real, wide

from labbook_numba.kernels.blocks import AX, BX, GAP, HELD, NX, NY, NZ, UX, VX, largest_gap, where_gap
from labbook_numba.kernels.features import (
    BLOCK,
    FAIL_GRAIN,
    FRICTION,
    GHOSTS,
    GRAIN,
    LEDGER,
    MAX_OVERLAP,
    PAIRS,
    TOUCHING,
    A,
    P,
    U,
    V,
    W,
    X,
    kernel,
    uint64,
)
from labbook_numba.kernels.rod_blocks import (
    CLOSE,
    CX,
    CY,
    CZ,
    IX,
    IY,
    IZ,
    JX,
    JY,
    JZ,
    KX,
    KY,
    KZ,
    LX,
    LY,
    LZ,
    OX,
    PX,
    closest_points,
    rod_law,
    rolling_inertia,
)
from labbook_numba.kernels.transfer import fill_up, gather_springs, put_vectors, scatter_forces, scatter_springs
from labbook_numba.lanes import eight_at
from labbook_numba.rows import columns, rows_at
from labbook_numba.squeeze import both, exchange, first_of, how_many, positive, squeeze, squeeze_numbers, squeeze_places
from labbook_numba.state import Params, State


@kernel
def gather_rods(grains, pair_i, pair_j, near, first, count):
    """Branches between centres and axes of the listed pairs first..first + count; behind them, those of ghosts."""
    for t in range(uint64(0), count, uint64(8)):
        k = first + t
        x, y, z, _ = columns(rows_at(grains, pair_i, k, GRAIN, X) - rows_at(grains, pair_j, k, GRAIN, X))
        put_vectors(near, CX + t, x, y, z)
        x, y, z, _ = columns(rows_at(grains, pair_i, k, GRAIN, A))
        put_vectors(near, KX + t, x, y, z)
        x, y, z, _ = columns(rows_at(grains, pair_j, k, GRAIN, A))
        put_vectors(near, LX + t, x, y, z)


@kernel
def pack_rods(near, pair_i, pair_j, held, b, block_i, block_j, slot, first, near_count):
    """Bring those of the measured near pairs that touch into the block; how many they are."""
    count = uint64(0)
    for t in range(uint64(0), near_count, uint64(8)):
        k = first + t
        gap = eight_at(near, CLOSE + t)
        here = first_of(near_count - t)
        touching = both(positive(gap), here)
        squeeze(b, NX + count, eight_at(near, CX + t), touching)
        squeeze(b, NY + count, eight_at(near, CY + t), touching)
        squeeze(b, NZ + count, eight_at(near, CZ + t), touching)
        squeeze(b, GAP + count, gap, touching)
        squeeze(b, IX + count, eight_at(near, KX + t), touching)
        squeeze(b, IY + count, eight_at(near, KY + t), touching)
        squeeze(b, IZ + count, eight_at(near, KZ + t), touching)
        squeeze(b, JX + count, eight_at(near, LX + t), touching)
        squeeze(b, JY + count, eight_at(near, LY + t), touching)
        squeeze(b, JZ + count, eight_at(near, LZ + t), touching)
        if FRICTION:
            squeeze(b, HELD + count, exchange(held, k, touching, here), touching)
            squeeze_places(slot, count, k, touching)
        squeeze_numbers(block_i, count, pair_i, k, touching)
        squeeze_numbers(block_j, count, pair_j, k, touching)
        count += how_many(touching)
    return count


@kernel
def gather_motion(g, i, j, b, count):
    """Velocities of i relative to j, predicted and half a step old, and both spins likewise."""
    for t in range(uint64(0), count, uint64(8)):
        ux, uy, uz, _ = columns(rows_at(g, i, t, GRAIN, U) - rows_at(g, j, t, GRAIN, U))
        px, py, pz, _ = columns(rows_at(g, i, t, GRAIN, P))
        ox, oy, oz, _ = columns(rows_at(g, j, t, GRAIN, P))
        if FRICTION:
            vx, vy, vz, _ = columns(rows_at(g, i, t, GRAIN, V) - rows_at(g, j, t, GRAIN, V))
            ax, ay, az, _ = columns(rows_at(g, i, t, GRAIN, W))
            bx, by, bz, _ = columns(rows_at(g, j, t, GRAIN, W))
            put_vectors(b, VX + t, vx, vy, vz)
            put_vectors(b, AX + t, ax, ay, az)
            put_vectors(b, BX + t, bx, by, bz)
        put_vectors(b, UX + t, ux, uy, uz)
        put_vectors(b, PX + t, px, py, pz)
        put_vectors(b, OX + t, ox, oy, oz)


@kernel
def pair_forces(st: State, p: Params):
    """Add the forces of rods on rods to f and t; note touching pairs, the largest overlap, and whose it is."""
    last = uint64(st.count[PAIRS])
    b = st.block
    i = st.block_i
    j = st.block_j
    slot = st.slot
    diameter = wide(2.0) * p.radius
    reach2 = diameter * diameter
    half_dt = wide(0.5) * p.dt
    rate = rolling_rate(rolling_inertia(p.inertia, p.slender), real(p.dt))
    ghost = len(st.grains) - GHOSTS
    spare = len(st.spring) - 1
    touching = uint64(0)
    deepest = wide(0.0)
    for k in range(uint64(0), last, BLOCK):
        near = min(last - k, BLOCK)
        gather_rods(st.grains, st.pair_i, st.pair_j, st.near, k, near)
        closest_points(st.near, near, p.half, reach2)
        count = pack_rods(st.near, st.pair_i, st.pair_j, st.held, b, i, j, slot, k, near)
        fill_up(i, j, slot, count, ghost, spare)
        gather_motion(st.grains, i, j, b, count)
        if FRICTION:
            gather_springs(st.spring, slot, b, count, half_dt)
        rod_law(b, count, p.c, real(p.radius), real(p.mass), rate)
        scatter_forces(st.loads, i, j, b, count, True)
        if FRICTION:
            scatter_springs(st.spring, slot, b, count)
        touching += count
        overlap = largest_gap(b, st.bits, count)
        if not overlap <= deepest:
            deepest = overlap
            if not deepest <= p.overlap_limit:
                st.count[FAIL_GRAIN] = st.ids[i[where_gap(b, count, overlap)]]
    st.sums[MAX_OVERLAP] = deepest
    if LEDGER:
        st.count[TOUCHING] = touching
