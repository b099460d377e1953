"""Forces of walls on grains, wall by wall, a block of touching grains at a time."""

from labbook_dem.contact import rolling_rate
from labbook_dem.walls.plane import plane_distance
from labbook_dem.walls.strip import strip_distance
from labbook_dem.words import func, real, wide, wide3

from labbook_numba.kernels.blocks import (
    AX,
    AY,
    AZ,
    BLOCK,
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
    wall_law,
    where_gap,
)
from labbook_numba.kernels.features import (
    FAIL_GRAIN,
    FRICTION,
    LEDGER,
    MAX_OVERLAP,
    MOVING,
    PLANES,
    STRIPS,
    TOUCHING,
    kernel,
    uint64,
)
from labbook_numba.state import Params, State


@func
def load(a, i):
    """Row i of an [n, 3] array as a wide vector."""
    return wide3(a[i, 0], a[i, 1], a[i, 2])


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
def pack_walls(st: State, p: Params, w, k, last, b):
    """Write near grains of wall w that touch it to the block (normal, overlap, surface velocity) and to `slot`."""
    count = uint64(0)
    while k < last and count < BLOCK:
        i = uint64(st.wall_grain[k])
        x = load(st.x, i)
        distance, normal = wall_distance(p, w, x)
        touches = distance < p.radius
        b[NX + count] = normal.x
        b[NY + count] = normal.y
        b[NZ + count] = normal.z
        b[GAP + count] = p.radius - distance
        if MOVING:
            surface = wall_velocity(p, w, x - normal * distance)
            b[UX + count] = surface.x
            b[UY + count] = surface.y
            b[UZ + count] = surface.z
        st.slot[count] = k
        st.wall_held[k] &= touches
        count += uint64(touches)
        k += uint64(1)
    return k, count


@kernel
def gather_walls(st: State, slot, b, count, half_dt):
    """Fill the other columns of the block: velocity, spin, spring."""
    u = st.u
    v = st.v
    o = st.w
    s = st.wall_spring
    for t in range(uint64(count)):
        k = uint64(slot[t])
        i = uint64(st.wall_grain[k])
        if MOVING:
            b[VX + t] = v[i, 0] - b[UX + t]
            b[VY + t] = v[i, 1] - b[UY + t]
            b[VZ + t] = v[i, 2] - b[UZ + t]
            b[UX + t] = u[i, 0] - b[UX + t]
            b[UY + t] = u[i, 1] - b[UY + t]
            b[UZ + t] = u[i, 2] - b[UZ + t]
        else:
            b[VX + t] = v[i, 0]
            b[VY + t] = v[i, 1]
            b[VZ + t] = v[i, 2]
            b[UX + t] = u[i, 0]
            b[UY + t] = u[i, 1]
            b[UZ + t] = u[i, 2]
        if FRICTION:
            b[AX + t] = o[i, 0]
            b[AY + t] = o[i, 1]
            b[AZ + t] = o[i, 2]
            kept = real(st.wall_held[k])
            b[SX + t] = s[0, k] * kept
            b[SY + t] = s[1, k] * kept
            b[SZ + t] = s[2, k] * kept
            b[DT + t] = half_dt * (real(1.0) + kept)
            st.wall_held[k] = 1


@kernel
def scatter_walls(st: State, slot, b, count):
    """Add the block's forces and torques to the grains; keep the springs."""
    f = st.f
    q = st.t
    s = st.wall_spring
    for t in range(uint64(count)):
        k = uint64(slot[t])
        i = uint64(st.wall_grain[k])
        f[i, 0] += b[UX + t]
        f[i, 1] += b[UY + t]
        f[i, 2] += b[UZ + t]
        if FRICTION:
            q[i, 0] += b[AX + t]
            q[i, 1] += b[AY + t]
            q[i, 2] += b[AZ + t]
            s[0, k] = b[SX + t]
            s[1, k] = b[SY + t]
            s[2, k] = b[SZ + t]


@kernel
def wall_forces(st: State, p: Params):
    """Add the forces of walls on grains to f and t; after `pair_forces`, whose totals it goes on with."""
    rate = rolling_rate(real(p.inertia), real(p.dt))
    touching = uint64(0)
    deepest = st.sums[MAX_OVERLAP]
    a = p.wall_c
    for w in range(uint64(len(p.wall_kind))):
        c = (a[w, 0], a[w, 1], a[w, 2], a[w, 3], a[w, 4], a[w, 5], a[w, 6], a[w, 7])
        spin = real(p.wall_motion[w, 3])
        k = uint64(st.wall_first[w])
        last = uint64(st.wall_first[w + uint64(1)])
        while k < last:
            k, count = pack_walls(st, p, w, k, last, st.block)
            gather_walls(st, st.slot, st.block, count, real(wide(0.5) * p.dt))
            wall_law(st.block, count, c, real(p.radius), real(p.mass), rate, spin)
            scatter_walls(st, st.slot, st.block, count)
            touching += count
            overlap = largest_gap(st.block, st.bits, count)
            if not overlap <= deepest:
                deepest = overlap
                if not deepest <= p.overlap_limit:
                    st.count[FAIL_GRAIN] = st.ids[st.wall_grain[st.slot[where_gap(st.block, count, overlap)]]]
    st.sums[MAX_OVERLAP] = deepest
    if LEDGER:
        st.count[TOUCHING] += touching
