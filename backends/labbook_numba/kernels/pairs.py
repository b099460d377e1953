"""Forces of grains on grains, a block of touching pairs at a time: pack, gather, law, scatter."""

from labbook_dem.contact import rolling_rate
from labbook_dem.words import real, wide

from labbook_numba.kernels.blocks import (
    AX,
    AY,
    AZ,
    BLOCK,
    BX,
    BY,
    BZ,
    DT,
    GAP,
    NX,
    NY,
    NZ,
    SX,
    SY,
    SZ,
    UX,
    UY,
    UZ,
    VX,
    VY,
    VZ,
    largest_gap,
    pair_law,
    where_gap,
)
from labbook_numba.kernels.features import (
    FAIL_GRAIN,
    FRICTION,
    LEDGER,
    MAX_OVERLAP,
    PAIRS,
    TOUCHING,
    kernel,
    uint64,
)
from labbook_numba.state import Params, State


@kernel
def pack_pairs(x, pair_i, pair_j, held, slot, k, last, reach2):
    """Write the numbers of touching pairs from k on to `slot` until it is full; the pair to go on with, and how many.

    A pair that does not touch lets go of its spring (`held`). There is no branch that could be mispredicted.
    """
    count = uint64(0)
    while k < last and count < BLOCK:
        i = uint64(pair_i[k])
        j = uint64(pair_j[k])
        dx = x[i, 0] - x[j, 0]
        dy = x[i, 1] - x[j, 1]
        dz = x[i, 2] - x[j, 2]
        touches = dx * dx + dy * dy + dz * dz < reach2
        slot[count] = k
        held[k] &= touches
        count += uint64(touches)
        k += uint64(1)
    return k, count


@kernel
def gather_pairs(st: State, slot, b, count, reach2, half_dt):
    """Fill the block's columns: branch, gap, relative velocity, both spins, spring and its advance."""
    x = st.x
    u = st.u
    v = st.v
    w = st.w
    s = st.spring
    for t in range(uint64(count)):
        k = uint64(slot[t])
        i = uint64(st.pair_i[k])
        j = uint64(st.pair_j[k])
        dx = x[i, 0] - x[j, 0]
        dy = x[i, 1] - x[j, 1]
        dz = x[i, 2] - x[j, 2]
        b[NX + t] = dx
        b[NY + t] = dy
        b[NZ + t] = dz
        b[GAP + t] = reach2 - (dx * dx + dy * dy + dz * dz)
        b[UX + t] = u[i, 0] - u[j, 0]
        b[UY + t] = u[i, 1] - u[j, 1]
        b[UZ + t] = u[i, 2] - u[j, 2]
        if FRICTION:
            b[VX + t] = v[i, 0] - v[j, 0]
            b[VY + t] = v[i, 1] - v[j, 1]
            b[VZ + t] = v[i, 2] - v[j, 2]
            b[AX + t] = w[i, 0]
            b[AY + t] = w[i, 1]
            b[AZ + t] = w[i, 2]
            b[BX + t] = w[j, 0]
            b[BY + t] = w[j, 1]
            b[BZ + t] = w[j, 2]
            kept = real(st.held[k])
            b[SX + t] = s[0, k] * kept
            b[SY + t] = s[1, k] * kept
            b[SZ + t] = s[2, k] * kept
            b[DT + t] = half_dt * (real(1.0) + kept)
            st.held[k] = 1


@kernel
def scatter_pairs(st: State, slot, b, count):
    """Add the block's forces and torques to the grains; keep the springs."""
    f = st.f
    q = st.t
    s = st.spring
    for t in range(uint64(count)):
        k = uint64(slot[t])
        i = uint64(st.pair_i[k])
        j = uint64(st.pair_j[k])
        fx = b[UX + t]
        fy = b[UY + t]
        fz = b[UZ + t]
        f[i, 0] += fx
        f[i, 1] += fy
        f[i, 2] += fz
        f[j, 0] -= fx
        f[j, 1] -= fy
        f[j, 2] -= fz
        if FRICTION:
            q[i, 0] += b[AX + t]
            q[i, 1] += b[AY + t]
            q[i, 2] += b[AZ + t]
            q[j, 0] += b[BX + t]
            q[j, 1] += b[BY + t]
            q[j, 2] += b[BZ + t]
            s[0, k] = b[SX + t]
            s[1, k] = b[SY + t]
            s[2, k] = b[SZ + t]


@kernel
def pair_forces(st: State, p: Params):
    """Add the forces of grains on grains to f and t; note touching pairs, the largest overlap, and whose it is."""
    last = uint64(st.count[PAIRS])
    diameter = wide(2.0) * p.radius
    reach2 = diameter * diameter
    rate = rolling_rate(real(p.inertia), real(p.dt))
    touching = uint64(0)
    deepest = wide(0.0)
    k = uint64(0)
    while k < last:
        k, count = pack_pairs(st.x, st.pair_i, st.pair_j, st.held, st.slot, k, last, reach2)
        gather_pairs(st, st.slot, st.block, count, reach2, real(wide(0.5) * p.dt))
        pair_law(st.block, count, p.c, real(p.radius), real(p.mass), rate)
        scatter_pairs(st, st.slot, st.block, count)
        touching += count
        overlap = largest_gap(st.block, st.bits, count)
        if not overlap <= deepest:
            deepest = overlap
            if not deepest <= p.overlap_limit:
                st.count[FAIL_GRAIN] = st.ids[st.pair_i[st.slot[where_gap(st.block, count, overlap)]]]
    st.sums[MAX_OVERLAP] = deepest
    if LEDGER:
        st.count[TOUCHING] = touching
