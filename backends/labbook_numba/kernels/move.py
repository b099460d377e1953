"""Motion of spheres and rods by one step; their rotation is in `spheres` and `rods`."""

from labbook_dem.images import nearest
from labbook_dem.motion import drift, kick, predict
from labbook_dem.words import PERIODIC, VARIED, wide

from labbook_numba.kernels.features import FIRST, GRAIN, LAST, LOAD, OUTLET, F, T, U, V, X, kernel, uint64
from labbook_numba.kernels.spheres import turn_grain  # in a module of rods it is that of `rods`
from labbook_numba.lanes import put_row, row_at
from labbook_numba.state import Params, State


@kernel
def move(st: State, p: Params, kick_dt, dt):
    """Kick, drift, turn and predict the domain's grains; replace forces by gravity.

    Writes squares of speeds [m^2/s^2], upper bounds for the ends of rods, and zero for leavers.
    """
    g = st.grains
    loads = st.loads
    inverse_mass = wide(1.0) / p.mass
    inverse_inertia = wide(1.0) / p.inertia
    ghost = len(g) - 1  # the ghost that no contact writes to
    loads[ghost, F + 2] = -p.mass * p.gravity
    weight = row_at(loads, uint64(ghost) * LOAD + F)
    gravity_row = weight * inverse_mass
    zero = weight * wide(0.0)
    for i in range(uint64(st.domain[FIRST]), uint64(st.domain[LAST])):
        at = i * GRAIN
        load = i * LOAD
        if VARIED:
            inverse_mass = wide(1.0) / st.body[i, 1]
            inverse_inertia = wide(1.0) / st.body[i, 2]
            weight = gravity_row * st.body[i, 1]
        a = row_at(loads, load + F) * inverse_mass
        v = kick(row_at(g, at + V), a, kick_dt)
        put_row(g, at + V, v)
        put_row(g, at + X, drift(row_at(g, at + X), v, dt))
        if PERIODIC:
            g[i, X + 1] = nearest(g[i, X + 1], p.period)
        # the normal dashpot takes velocities at the time of the positions
        put_row(g, at + U, predict(v, a, dt))
        turn_acc = row_at(loads, load + T) * inverse_inertia
        st.speed2[i] = turn_grain(g, i, turn_acc, v, p.slender, p.half, kick_dt, dt)
        put_row(loads, load + F, weight)
        put_row(loads, load + T, zero)
        if OUTLET and g[i, X + 2] < p.drop:
            # a leaver falls freely and fast: it shall not cause rebuilds or meet the guard
            st.speed2[i] = wide(0.0)
