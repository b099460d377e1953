"""Moving spheres by one step."""

from labbook_dem.motion import drift, kick, predict
from labbook_dem.words import VARIED, wide

from labbook_numba.kernels.bodies import inertia_of, mass_of
from labbook_numba.kernels.features import FIRST, GRAIN, LAST, LOAD, OUTLET, F, T, U, V, W, X, kernel, uint64
from labbook_numba.lanes import put_row, row_at, square
from labbook_numba.state import Params, State


@kernel
def move(st: State, p: Params, kick_dt, dt):
    """Kick, drift and predict the part's grains; forces become gravity. Squares of speeds, zero for leavers."""
    g = st.grains
    loads = st.loads
    per_mass = wide(1.0) / p.mass
    per_inertia = wide(1.0) / p.inertia
    far = len(g) - 1  # the ghost that no contact writes to
    loads[far, F + 2] = -p.mass * p.gravity
    weight = row_at(loads, uint64(far) * LOAD + F)
    unit = weight * per_mass
    none = weight * wide(0.0)
    for i in range(uint64(st.part[FIRST]), uint64(st.part[LAST])):
        at = i * GRAIN
        load = i * LOAD
        if VARIED:
            per_mass = wide(1.0) / st.body[i, 1]
            per_inertia = wide(1.0) / st.body[i, 2]
            weight = unit * st.body[i, 1]
        a = row_at(loads, load + F) * per_mass
        v = kick(row_at(g, at + V), a, kick_dt)
        put_row(g, at + V, v)
        put_row(g, at + X, drift(row_at(g, at + X), v, dt))
        put_row(g, at + U, predict(v, a, dt))
        put_row(g, at + W, kick(row_at(g, at + W), row_at(loads, load + T) * per_inertia, kick_dt))
        put_row(loads, load + F, weight)
        put_row(loads, load + T, none)
        st.speed2[i] = square(v)
        if OUTLET and g[i, X + 2] < p.drop:
            st.speed2[i] = wide(0.0)


@kernel
def contact_work(st: State, p: Params, kick_dt):
    """Work [J] that the contact forces in f and t are about to do: force times mean velocity of the kick."""
    g = st.grains
    loads = st.loads
    work = wide(0.0)
    for i in range(uint64(st.part[FIRST]), uint64(st.part[LAST])):
        mass = mass_of(st.body, i, p.mass)
        inertia = inertia_of(st.body, i, p.inertia)
        for c in range(3):
            gravity = -p.gravity if c == 2 else wide(0.0)
            force = loads[i, F + c]
            torque = loads[i, T + c]
            v = g[i, V + c] + wide(0.5) * kick_dt * force / mass
            w = g[i, W + c] + wide(0.5) * kick_dt * torque / inertia
            work += ((force - mass * gravity) * v + torque * w) * kick_dt
    return work
