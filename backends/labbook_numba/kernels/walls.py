"""Forces of walls on grains, wall by wall, a block at a time: measure, pack, gather, law, scatter."""

from labbook_dem.contact import rolling_rate
from labbook_dem.walls.plane import plane_distance
from labbook_dem.walls.strip import strip_distance
from labbook_dem.words import func, real, wide, wide3

from labbook_numba.kernels.blocks import (
    AX,
    AY,
    AZ,
    GAP,
    HELD,
    NX,
    NY,
    NZ,
    UX,
    UY,
    UZ,
    VX,
    VY,
    VZ,
    largest_gap,
    wall_law,
    where_gap,
)
from labbook_numba.kernels.features import (
    BLOCK,
    FAIL_GRAIN,
    FRICTION,
    GRAIN,
    LEDGER,
    MAX_OVERLAP,
    MOVING,
    PLANES,
    STRIPS,
    TOUCHING,
    U,
    V,
    W,
    X,
    kernel,
    uint64,
)
from labbook_numba.kernels.transfer import fill_up, gather_springs, scatter_forces, scatter_springs
from labbook_numba.lanes import eight_at, put
from labbook_numba.rows import columns, rows_at
from labbook_numba.squeeze import both, exchange, first_of, how_many, positive, squeeze, squeeze_numbers, squeeze_places
from labbook_numba.state import Params, State

# columns of State.near: position, which becomes the unit normal; gap; velocity of the surface
PX, PY, PZ, NEAR_GAP = uint64(0), uint64(128), uint64(256), uint64(384)
QX, QY, QZ = uint64(512), uint64(640), uint64(768)


@func
def load(a, i, c):
    """The vector that starts at column c of row i."""
    return wide3(a[i, c], a[i, c + 1], a[i, c + 2])


@func
def wall_distance(p, w, x):
    """Distance [m] of x from wall w, and the unit normal from the wall to x."""
    a = p.wall_shape
    if STRIPS and (p.wall_kind[w] == 1 or not PLANES):
        zero = wide(0.0)
        return strip_distance(wide3(a[w, 0], zero, a[w, 1]), wide3(a[w, 2], zero, a[w, 3]), a[w, 4], x)
    return plane_distance(wide3(a[w, 0], a[w, 1], a[w, 2]), wide3(a[w, 3], a[w, 4], a[w, 5]), x)


@func
def wall_velocity(p, w, at):
    """Velocity [m/s] of the surface of wall w at the point `at`."""
    m = p.wall_motion
    return wide3(m[w, 0] - m[w, 3] * at.y, m[w, 1] + m[w, 3] * at.x, m[w, 2])


@kernel
def measure_walls(st: State, p: Params, w, k, count):
    """Normal, overlap and surface velocity of wall w for its near grains k..k + count, touching or not."""
    near = st.near
    for t in range(uint64(0), count, uint64(8)):
        x, y, z, _ = columns(rows_at(st.grains, st.wall_grain, k + t, GRAIN, X))
        put(near, PX + t, x)
        put(near, PY + t, y)
        put(near, PZ + t, z)
    for t in range(count):
        x = wide3(near[PX + t], near[PY + t], near[PZ + t])
        distance, normal = wall_distance(p, w, x)
        if MOVING:
            surface = wall_velocity(p, w, x - normal * distance)
            near[QX + t] = surface.x
            near[QY + t] = surface.y
            near[QZ + t] = surface.z
        near[PX + t] = normal.x
        near[PY + t] = normal.y
        near[PZ + t] = normal.z
        near[NEAR_GAP + t] = p.radius - distance


@kernel
def pack_walls(st: State, k, near_count):
    """Bring those of the measured near grains that touch into the block; how many they are."""
    b = st.block
    near = st.near
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
            squeeze(b, HELD + count, exchange(st.wall_held, k + t, touching, here), touching)
            squeeze_places(st.slot, count, k + t, touching)
        squeeze_numbers(st.block_i, count, st.wall_grain, k + t, touching)
        count += how_many(touching)
    return count


@kernel
def gather_grains(g, i, b, count):
    """Velocities relative to the wall, predicted and half a step old, and spins."""
    for t in range(uint64(0), count, uint64(8)):
        ux, uy, uz, _ = columns(rows_at(g, i, t, GRAIN, U))
        vx, vy, vz, _ = columns(rows_at(g, i, t, GRAIN, V))
        if MOVING:
            x = eight_at(b, UX + t)
            y = eight_at(b, UY + t)
            z = eight_at(b, UZ + t)
            ux, uy, uz = ux - x, uy - y, uz - z
            vx, vy, vz = vx - x, vy - y, vz - z
        put(b, UX + t, ux)
        put(b, UY + t, uy)
        put(b, UZ + t, uz)
        if FRICTION:
            put(b, VX + t, vx)
            put(b, VY + t, vy)
            put(b, VZ + t, vz)
            x, y, z, _ = columns(rows_at(g, i, t, GRAIN, W))
            put(b, AX + t, x)
            put(b, AY + t, y)
            put(b, AZ + t, z)


@kernel
def wall_forces(st: State, p: Params):
    """Add the forces of walls on grains to f and t; after `pair_forces`, whose totals it goes on with."""
    b = st.block
    half_dt = wide(0.5) * p.dt
    rate = rolling_rate(real(p.inertia), real(p.dt))
    touching = uint64(0)
    deepest = st.sums[MAX_OVERLAP]
    a = p.wall_c
    for w in range(uint64(len(p.wall_kind))):
        c = (a[w, 0], a[w, 1], a[w, 2], a[w, 3], a[w, 4], a[w, 5], a[w, 6], a[w, 7])
        spin = real(p.wall_motion[w, 3])
        last = uint64(st.wall_first[w + uint64(1)])
        for k in range(uint64(st.wall_first[w]), last, BLOCK):
            near = min(last - k, BLOCK)
            measure_walls(st, p, w, k, near)
            count = pack_walls(st, k, near)
            fill_up(st, len(st.wall_spring), count)
            gather_grains(st.grains, st.block_i, b, count)
            if FRICTION:
                gather_springs(st.wall_spring, st.slot, b, count, half_dt)
            wall_law(b, count, c, real(p.radius), real(p.mass), rate, spin)
            scatter_forces(st.loads, st.block_i, st.block_j, b, count, False)
            if FRICTION:
                scatter_springs(st.wall_spring, st.slot, b, count)
            touching += count
            overlap = largest_gap(b, st.bits, count)
            if not overlap <= deepest:
                deepest = overlap
                if not deepest <= p.overlap_limit:
                    st.count[FAIL_GRAIN] = st.ids[st.block_i[where_gap(b, count, overlap)]]
    st.sums[MAX_OVERLAP] = deepest
    if LEDGER:
        st.count[TOUCHING] += touching
