"""Forces between grains, a block of touching pairs at a time: pack, gather, law, scatter.

The shape of the grains decides which pairs touch and the forces on one: see `sphere_pairs` and `rod_pairs`.
"""

from labbook_dem.contact import rolling_rate
from labbook_dem.words import VARIED, real, wide

from labbook_numba.kernels.blocks import BX, DEPTH, largest_depth, put_forces, put_vector, reals, where_depth, whole
from labbook_numba.kernels.bodies import gather_bodies, gather_coefficients, rolling_inertia
from labbook_numba.kernels.features import (
    BLOCK,
    BORROWED,
    FAIL_GRAIN,
    FIRST_PAIR,
    FRICTION,
    GHOSTS,
    KINDS,
    LAST_PAIR,
    LEDGER,
    MAX_OVERLAP,
    ORIENTED,
    TOUCHING,
    int64,
    kernel,
    uint64,
)
from labbook_numba.kernels.shape import pack_pairs, pair_contact
from labbook_numba.kernels.transfer import fill_up, gather_pairs, gather_springs, scatter_forces, scatter_springs
from labbook_numba.state import Params, State


@kernel
def pair_law(b, count, coefficients, radius, mass, inertia, dt, stiffness, damping):
    """Law stage of two grains: branch in NX.., overlap2 in DEPTH, which becomes the overlap; relative velocities.

    radius, mass, inertia: of all grains, if they are the same; dt: step [s]; stiffness, damping: of rolling springs.
    """
    c = reals(coefficients)
    rate = rolling_rate(inertia, dt)
    for t in range(whole(count)):
        force, torque, torque_j, spring, delta = pair_contact(b, t, c, radius, mass, rate, dt, stiffness, damping)
        put_forces(b, t, force, torque, spring)
        if FRICTION or ORIENTED:
            put_vector(b, BX + t, torque_j)
        b[DEPTH + t] = delta


@kernel
def pair_forces(st: State, p: Params):
    """Add the forces between grains to loads; count touching pairs, record the largest overlap and its grain."""
    domain = st.domain
    st.sums[MAX_OVERLAP] = wide(0.0)
    if LEDGER:
        st.count[TOUCHING] = 0
    # borrowed pairs first: their first grains are in earlier domains, so the order of each sum is that of one thread
    listed_forces(st, p, st.borrowed_i, st.borrowed_j, st.borrowed_held, st.borrowed_spring, int64(0), domain[BORROWED])
    listed_forces(st, p, st.pair_i, st.pair_j, st.held, st.spring, domain[FIRST_PAIR], domain[LAST_PAIR])


@kernel
def listed_forces(st: State, p: Params, pair_i, pair_j, valid, spring, first, end):
    """Add the forces of the listed pairs first..end; see `pair_forces`."""
    last = uint64(end)
    b = st.block
    i = st.block_i
    j = st.block_j
    slot = st.slot
    diameter = wide(2.0) * p.radius
    reach2 = diameter * diameter
    half_dt = wide(0.5) * p.dt
    inertia = rolling_inertia(p.inertia, p.slender)
    ghost = len(st.grains) - GHOSTS
    spare = len(spring) - 1
    touching = uint64(0)
    largest_overlap = st.sums[MAX_OVERLAP]
    # kernels of a block take arrays, not the State, whose many references would be counted at every call; therefore
    # `sphere_walls` repeats the last lines of the loop
    for k in range(uint64(first), last, BLOCK):
        end = min(k + BLOCK, last)
        count = pack_pairs(
            st.grains, st.body, st.near, pair_i, pair_j, valid, b, i, j, slot, k, end, p.half, reach2, p.period
        )
        fill_up(i, j, slot, count, ghost, spare)
        gather_pairs(st.grains, i, j, b, count)
        if FRICTION:
            gather_springs(spring, slot, b, count, half_dt)
        if VARIED:
            gather_bodies(st.body, i, j, b, count, True)
            if KINDS > 1:
                gather_coefficients(p.pair_c, int64(0), st.body, i, j, b, count, True)
        pair_law(
            b, count, p.c, real(p.radius), real(p.mass), inertia, real(p.dt), real(p.rolling_stiffness),
            real(p.rolling_damping),
        )  # fmt: skip
        scatter_forces(st.loads, i, j, b, count, True)
        if FRICTION:
            scatter_springs(spring, slot, b, count)
        touching += count
        overlap = largest_depth(b, st.bits, count)
        # so written that NaN counts as the largest overlap, and reaches the guard
        if not overlap <= largest_overlap:
            largest_overlap = overlap
            if not largest_overlap <= p.overlap_limit:
                st.count[FAIL_GRAIN] = st.ids[i[where_depth(b, count, overlap)]]
    st.sums[MAX_OVERLAP] = largest_overlap
    if LEDGER:
        st.count[TOUCHING] += touching
