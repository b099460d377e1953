"""Forces of walls on grains, wall by wall, a block at a time: measure, pack, gather, law, scatter."""

from labbook_dem.words import VARIED, real, wide, wide3

from labbook_numba.kernels.blocks import (
    GAP,
    HELD,
    NX,
    NY,
    NZ,
    UX,
    UY,
    UZ,
    largest_gap,
    row_of,
    wall_law,
    where_gap,
)
from labbook_numba.kernels.bodies import gather_bodies, gather_coefficients, radius_of
from labbook_numba.kernels.features import (
    BLOCK,
    FAIL_GRAIN,
    FIRST,
    FRICTION,
    GHOSTS,
    GRAIN,
    KINDS,
    LAST,
    LEDGER,
    MAX_OVERLAP,
    MOVING,
    STRIDE,
    TOUCHING,
    X,
    int64,
    kernel,
    uint64,
)
from labbook_numba.kernels.search import first_at_least
from labbook_numba.kernels.surfaces import wall_distance, wall_velocity
from labbook_numba.kernels.transfer import fill_up, gather_grains, gather_springs, scatter_forces, scatter_springs
from labbook_numba.lanes import eight_at, put
from labbook_numba.rows import columns, rows_at
from labbook_numba.squeeze import both, exchange, first_of, how_many, positive, squeeze, squeeze_numbers, squeeze_places
from labbook_numba.state import SPHERES, Params, State

# columns of State.near: position, which becomes the unit normal; gap; velocity of the surface
PX, PY, PZ, NEAR_GAP, QX, QY, QZ = (uint64(column * STRIDE) for column in range(SPHERES.NEAR_COLUMNS))


@kernel
def measure_walls(grains, body, wall_grain, near, shape, kind, motion, w, k, count, radius):
    """Normal, overlap and surface velocity of wall w for its near grains k..k + count, touching or not."""
    for t in range(uint64(0), count, uint64(8)):
        x, y, z, _ = columns(rows_at(grains, wall_grain, k + t, GRAIN, X))
        put(near, PX + t, x)
        put(near, PY + t, y)
        put(near, PZ + t, z)
    for t in range(count):
        x = wide3(near[PX + t], near[PY + t], near[PZ + t])
        distance, normal = wall_distance(shape, kind, w, x)
        if MOVING:
            surface = wall_velocity(motion, w, x - normal * distance)
            near[QX + t] = surface.x
            near[QY + t] = surface.y
            near[QZ + t] = surface.z
        near[PX + t] = normal.x
        near[PY + t] = normal.y
        near[PZ + t] = normal.z
        near[NEAR_GAP + t] = radius_of(body, wall_grain[k + t], radius) - distance


@kernel
def pack_walls(near, wall_grain, held, b, i, slot, k, near_count):
    """Bring those of the measured near grains that touch into the block; how many they are."""
    count = uint64(0)
    for t in range(uint64(0), near_count, uint64(8)):
        gap = eight_at(near, NEAR_GAP + t)
        here = first_of(near_count - t)
        touching = both(positive(gap), here)
        squeeze(b, NX + count, eight_at(near, PX + t), touching)
        squeeze(b, NY + count, eight_at(near, PY + t), touching)
        squeeze(b, NZ + count, eight_at(near, PZ + t), touching)
        squeeze(b, GAP + count, gap, touching)
        if MOVING:
            squeeze(b, UX + count, eight_at(near, QX + t), touching)
            squeeze(b, UY + count, eight_at(near, QY + t), touching)
            squeeze(b, UZ + count, eight_at(near, QZ + t), touching)
        if FRICTION:
            squeeze(b, HELD + count, exchange(held, k + t, touching, here), touching)
            squeeze_places(slot, count, k + t, touching)
        squeeze_numbers(i, count, wall_grain, k + t, touching)
        count += how_many(touching)
    return count


@kernel
def wall_forces(st: State, p: Params):
    """Add the forces of walls on grains to f and t; after `pair_forces`, whose totals it goes on with."""
    b = st.block
    i = st.block_i
    slot = st.slot
    half_dt = wide(0.5) * p.dt
    ghost = len(st.grains) - GHOSTS
    spare = len(st.wall_spring) - 1
    touching = uint64(0)
    deepest = st.sums[MAX_OVERLAP]
    a = p.wall_c
    for w in range(uint64(len(p.wall_kind))):
        c = row_of(a, w)
        spin = real(p.wall_motion[w, 3])
        start = st.wall_first[w]
        end = st.wall_first[w + uint64(1)]
        start = first_at_least(st.wall_grain, start, end, st.part[FIRST])
        last = uint64(first_at_least(st.wall_grain, start, end, st.part[LAST]))
        for k in range(uint64(start), last, BLOCK):
            near = min(last - k, BLOCK)
            measure_walls(
                st.grains, st.body, st.wall_grain, st.near, p.wall_shape, p.wall_kind, p.wall_motion, w, k, near,
                p.radius,
            )  # fmt: skip
            count = pack_walls(st.near, st.wall_grain, st.wall_held, b, i, slot, k, near)
            fill_up(i, st.block_j, slot, count, ghost, spare)
            gather_grains(st.grains, i, b, count)
            if FRICTION:
                gather_springs(st.wall_spring, slot, b, count, half_dt)
            if VARIED:
                gather_bodies(st.body, i, i, b, count, False)
                if KINDS > 1:
                    gather_coefficients(a, int64(w) * int64(KINDS), st.body, i, i, b, count, False)
            wall_law(b, count, c, real(p.radius), real(p.mass), real(p.inertia), real(p.dt), spin)
            scatter_forces(st.loads, i, st.block_j, b, count, False)
            if FRICTION:
                scatter_springs(st.wall_spring, slot, b, count)
            touching += count
            overlap = largest_gap(b, st.bits, count)
            if not overlap <= deepest:
                deepest = overlap
                if not deepest <= p.overlap_limit:
                    st.count[FAIL_GRAIN] = st.ids[i[where_gap(b, count, overlap)]]
    st.sums[MAX_OVERLAP] = deepest
    if LEDGER:
        st.count[TOUCHING] += touching
