"""Forces and torques of all contacts."""

from labbook_dem.contact import rolling, slip, trial
from labbook_dem.laws.hertz_mindlin import normal, respond
from labbook_dem.walls.plane import plane_distance
from labbook_dem.walls.strip import strip_distance
from labbook_dem.words import cross, dot, func, narrow, real, sqrt, vec3, wide, wide3
from labbook_numba.kernels.features import (
    ANY_WALLS,
    FAIL_GRAIN,
    FAIL_VALUE,
    FRICTION,
    GRAINS,
    LEDGER,
    MAX_OVERLAP,
    MOVING,
    PLANES,
    ROLLING,
    STRIPS,
    TOUCHING,
    TWIST,
    int64,
    kernel,
    uint64,
)
from labbook_numba.state import Params, State


@func
def load(a, i):
    """Row i of an [n, 3] array as a wide vector."""
    return wide3(a[i, 0], a[i, 1], a[i, 2])


@func
def store(a, i, v):
    """Write a vector to row i."""
    a[i, 0] = v.x
    a[i, 1] = v.y
    a[i, 2] = v.z


@func
def touch(c, rs, ms, lever_i, lever_j, radius, delta, n, v, wi, wj, s, half, inertia_rate):
    """Force on i, torque by friction per unit lever, rolling torque on i, and the spring for the next step."""
    zero = real(0.0)
    if FRICTION:
        vn, vt = slip(n, v, wi * lever_i + wj * lever_j)
        fn, ft, kept = respond(c, rs, ms, delta, vn, trial(s, n, vt, half), vt)
        force = n * fn + ft
        arm = cross(n, ft)
        kept = kept + vt * half
    else:
        fn = normal(c, rs, ms, delta, dot(v, n))
        force = n * fn
        arm = vec3(zero, zero, zero)
        kept = arm
    if ROLLING:
        roll = rolling(wi - wj, n, c[5] * radius * fn, inertia_rate, TWIST)
    else:
        roll = vec3(zero, zero, zero)
    return force, arm, roll, kept


@kernel
def pair_forces(st: State, p: Params):
    """Add the forces of grains on grains to f and t. False, and FAIL_GRAIN, on a contact too deep to be one."""
    n = uint64(st.count[GRAINS])
    reach = wide(2.0) * p.radius
    reach2 = reach * reach
    half = real(0.5 * p.dt)
    rate = real(0.125 * p.inertia / p.dt)
    rs = real(0.5 * p.radius)
    ms = real(0.5 * p.mass)
    radius = real(p.radius)
    deepest = wide(0.0)
    touching = int64(0)
    for i in range(n):
        first = uint64(st.row[i])
        last = uint64(st.row[i + uint64(1)])
        if first == last:
            continue
        xi = load(st.x, i)
        ui = load(st.u, i)
        oi = narrow(load(st.o, i))
        fi = load(st.f, i)
        ti = load(st.t, i)
        for k in range(first, last):
            j = uint64(st.pair_j[k])
            away = xi - load(st.x, j)
            r2 = dot(away, away)
            if r2 >= reach2:
                if FRICTION:
                    st.spring[k, 0] = 0.0
                    st.spring[k, 1] = 0.0
                    st.spring[k, 2] = 0.0
                continue
            r = sqrt(r2)
            gap = reach - r
            if gap > deepest:
                deepest = gap
                st.count[FAIL_GRAIN] = i
            if LEDGER:
                touching += 1
            lever = real(0.5 * r)
            n_ij = narrow(away * (wide(1.0) / r))
            s = narrow(load(st.spring, k))
            v = narrow(ui - load(st.u, j))
            oj = narrow(load(st.o, j))
            force, arm, roll, kept = touch(
                p.c, rs, ms, lever, lever, radius, real(gap), n_ij, v, oi, oj, s, half, rate
            )
            if FRICTION:
                store(st.spring, k, kept)
            fi = fi + wide3(force.x, force.y, force.z)
            st.f[j, 0] -= force.x
            st.f[j, 1] -= force.y
            st.f[j, 2] -= force.z
            if FRICTION:
                both = arm * lever
                ti = ti + wide3(roll.x - both.x, roll.y - both.y, roll.z - both.z)
                st.t[j, 0] -= roll.x + both.x
                st.t[j, 1] -= roll.y + both.y
                st.t[j, 2] -= roll.z + both.z
        store(st.f, i, fi)
        store(st.t, i, ti)
    st.sums[MAX_OVERLAP] = deepest
    if LEDGER:
        st.count[TOUCHING] = touching
    if deepest > p.overlap_limit:
        st.sums[FAIL_VALUE] = deepest
        return False
    return True


@func
def wall_distance(p, w, x):
    """Distance [m] of x from wall w, and the unit normal from the wall to x."""
    a = p.wall_shape
    if STRIPS and (p.wall_kind[w] == 1 or not PLANES):
        zero = wide(0.0)
        return strip_distance(wide3(a[w, 0], zero, a[w, 1]), wide3(a[w, 2], zero, a[w, 3]), a[w, 4], x)
    return plane_distance(wide3(a[w, 0], a[w, 1], a[w, 2]), wide3(a[w, 3], a[w, 4], a[w, 5]), x)


@func
def wall_velocity(p, w, x, n, distance):
    """Velocity [m/s] of the surface of wall w where the grain at x touches it, and its spin about z [rad/s]."""
    m = p.wall_motion
    at = x - n * distance
    return wide3(m[w, 0] - m[w, 3] * at.y, m[w, 1] + m[w, 3] * at.x, m[w, 2]), m[w, 3]


@kernel
def wall_forces(st: State, p: Params):
    """Add the forces of walls on grains to f and t. False, and FAIL_GRAIN, on a contact too deep to be one."""
    n = uint64(st.count[GRAINS])
    half = real(0.5 * p.dt)
    rate = real(0.125 * p.inertia / p.dt)
    rs = real(p.radius)
    ms = real(p.mass)
    zero = real(0.0)
    none = vec3(zero, zero, zero)
    deepest = wide(0.0)
    touching = int64(0)
    if not ANY_WALLS:
        return True
    for i in range(n):
        first = uint64(st.wall_row[i])
        last = uint64(st.wall_row[i + uint64(1)])
        for k in range(first, last):
            w = uint64(st.wall_of[k])
            x = load(st.x, i)
            distance, normal_w = wall_distance(p, w, x)
            gap = p.radius - distance
            if gap <= wide(0.0):
                if FRICTION:
                    st.wall_spring[k, 0] = 0.0
                    st.wall_spring[k, 1] = 0.0
                    st.wall_spring[k, 2] = 0.0
                continue
            if gap > deepest:
                deepest = gap
                st.count[FAIL_GRAIN] = i
            if LEDGER:
                touching += 1
            c = p.wall_c
            row = (c[w, 0], c[w, 1], c[w, 2], c[w, 3], c[w, 4], c[w, 5], c[w, 6], c[w, 7])
            u = load(st.u, i)
            spin = none
            if MOVING:
                surface, turns = wall_velocity(p, w, x, normal_w, distance)
                u = u - surface
                spin = vec3(zero, zero, real(turns))
            lever = real(distance)
            force, arm, roll, kept = touch(
                row, rs, ms, lever, zero, rs, real(gap), narrow(normal_w), narrow(u),
                narrow(load(st.o, i)), spin, narrow(load(st.wall_spring, k)), half, rate,
            )  # fmt: skip
            if FRICTION:
                store(st.wall_spring, k, kept)
                st.t[i, 0] += roll.x - arm.x * lever
                st.t[i, 1] += roll.y - arm.y * lever
                st.t[i, 2] += roll.z - arm.z * lever
            st.f[i, 0] += force.x
            st.f[i, 1] += force.y
            st.f[i, 2] += force.z
    if LEDGER:
        st.count[TOUCHING] += touching
    if deepest > st.sums[MAX_OVERLAP]:
        st.sums[MAX_OVERLAP] = deepest
    if deepest > p.overlap_limit:
        st.sums[FAIL_VALUE] = deepest
        return False
    return True
