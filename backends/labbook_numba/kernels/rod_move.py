"""Moving and turning rods by one step."""

from labbook_dem.motion import drift, kick, predict
from labbook_dem.rotation import axis, spin, turn
from labbook_dem.words import dot, func, sqrt, wide, wide3

from labbook_numba.kernels.features import GRAIN, GRAINS, LOAD, OUTLET, A, F, M, P, Q, T, U, V, W, X, kernel, uint64
from labbook_numba.kernels.single import load
from labbook_numba.lanes import put_row, row_at, square
from labbook_numba.state import Params, State


@func
def store(a, i, c, vector):
    """Write a vector from column c of row i on."""
    a[i, c] = vector.x
    a[i, c + 1] = vector.y
    a[i, c + 2] = vector.z


@kernel
def move(st: State, p: Params, kick_dt, dt):
    """Kick, drift and predict all rods; forces become gravity.

    Squares of speeds, of an end at most |v| + h |m x a|: zero where nothing is touched.
    """
    g = st.grains
    loads = st.loads
    per_mass = wide(1.0) / p.mass
    per_inertia = wide(1.0) / p.inertia
    far = len(g) - 1  # the ghost that no contact writes to
    loads[far, F + 2] = -p.mass * p.gravity
    weight = row_at(loads, uint64(far) * LOAD + F)
    none = weight * wide(0.0)
    for i in range(uint64(st.count[GRAINS])):
        at = i * GRAIN
        force = i * LOAD
        a = row_at(loads, force + F) * per_mass
        v = kick(row_at(g, at + V), a, kick_dt)
        put_row(g, at + V, v)
        put_row(g, at + X, drift(row_at(g, at + X), v, dt))
        put_row(g, at + U, predict(v, a, dt))
        turns = row_at(loads, force + T) * per_inertia
        put_row(g, at + M, kick(row_at(g, at + M), turns, kick_dt))
        m = load(g, i, M)
        qw, qx, qy, qz = turn(g[i, Q], g[i, Q + 1], g[i, Q + 2], g[i, Q + 3], m, p.slender, dt)
        g[i, Q] = qw
        g[i, Q + 1] = qx
        g[i, Q + 2] = qy
        g[i, Q + 3] = qz
        along = axis(qw, qx, qy, qz)
        store(g, i, A, along)
        store(g, i, W, spin(m, along, p.slender))
        put_row(g, at + P, predict(row_at(g, at + M), turns, dt))
        store(g, i, P, spin(load(g, i, P), along, p.slender))
        put_row(loads, force + F, weight)
        put_row(loads, force + T, none)
        end = wide3(m.y * along.z - m.z * along.y, m.z * along.x - m.x * along.z, m.x * along.y - m.y * along.x)
        speed = sqrt(square(v)) + p.half * sqrt(dot(end, end))
        st.speed2[i] = speed * speed
        if OUTLET and g[i, X + 2] < p.drop:
            st.speed2[i] = wide(0.0)


@kernel
def contact_work(st: State, p: Params, kick_dt):
    """Work [J] that the contact forces in f and t are about to do: force times mean velocity of the kick."""
    work = wide(0.0)
    half = wide(0.5) * kick_dt
    for i in range(uint64(st.count[GRAINS])):
        force = load(st.loads, i, F)
        torque = load(st.loads, i, T)
        v = load(st.grains, i, V) + force * (half / p.mass)
        m = load(st.grains, i, M) + torque * (half / p.inertia)
        work += dot(force, v) + p.mass * p.gravity * v.z + dot(torque, spin(m, load(st.grains, i, A), p.slender))
    return work * kick_dt
