"""Moving grains by one step; how they turn is in `spheres` and `rods`."""

from labbook_dem.motion import drift, kick, predict
from labbook_dem.words import VARIED, wide

from labbook_numba.kernels.features import FIRST, GRAIN, LAST, LOAD, OUTLET, F, T, U, V, X, kernel, uint64
from labbook_numba.kernels.shape import turn_grain
from labbook_numba.lanes import put_row, row_at
from labbook_numba.state import Params, State


@kernel
def move(st: State, p: Params, kick_dt, dt):
    """Kick, drift, turn and predict the domain's grains; forces become gravity.

    Squares of speeds, of no point of a grain's segment more: zero for leavers.
    """
    g = st.grains
    loads = st.loads
    per_mass = wide(1.0) / p.mass
    per_inertia = wide(1.0) / p.inertia
    far = len(g) - 1  # the ghost that no contact writes to
    loads[far, F + 2] = -p.mass * p.gravity
    weight = row_at(loads, uint64(far) * LOAD + F)
    unit = weight * per_mass
    none = weight * wide(0.0)
    for i in range(uint64(st.domain[FIRST]), uint64(st.domain[LAST])):
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
        turns = row_at(loads, load + T) * per_inertia
        st.speed2[i] = turn_grain(g, i, turns, v, p.slender, p.half, kick_dt, dt)
        put_row(loads, load + F, weight)
        put_row(loads, load + T, none)
        if OUTLET and g[i, X + 2] < p.drop:
            st.speed2[i] = wide(0.0)
