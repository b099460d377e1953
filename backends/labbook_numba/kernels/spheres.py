"""Spheres: rotation, and work of contacts; as `rods`."""

from labbook_dem.motion import kick
from labbook_dem.words import func, wide

from labbook_numba.kernels.bodies import inertia_of, mass_of
from labbook_numba.kernels.features import FIRST, GRAIN, LAST, F, T, V, W, kernel, uint64
from labbook_numba.kernels.transfer import load
from labbook_numba.lanes import put_row, row_at, square
from labbook_numba.state import Params, State


@func
def turn_grain(g, i, turn_acc, v, slender, half, kick_dt, dt):
    """Kick the spin of sphere i by the angular acceleration turn_acc [rad/s^2]; return the square of its speed
    [m^2/s^2]."""
    at = i * GRAIN
    put_row(g, at + W, kick(row_at(g, at + W), turn_acc, kick_dt))
    return square(v)


@kernel
def contact_work(st: State, p: Params, kick_dt):
    """Work [J] of the contact forces in loads during the next kick: force times mean velocity of the kick."""
    g = st.grains
    loads = st.loads
    work = wide(0.0)
    for i in range(uint64(st.domain[FIRST]), uint64(st.domain[LAST])):
        mass = mass_of(st.body, i, p.mass)
        inertia = inertia_of(st.body, i, p.inertia)
        for c in range(3):
            # loads hold the weight too, which is no contact
            gravity = -p.gravity if c == 2 else wide(0.0)
            force = loads[i, F + c]
            torque = loads[i, T + c]
            # with the mean of both velocities the work is the change of kinetic energy by the kick, to rounding
            v = g[i, V + c] + wide(0.5) * kick_dt * force / mass
            w = g[i, W + c] + wide(0.5) * kick_dt * torque / inertia
            work += ((force - mass * gravity) * v + torque * w) * kick_dt
    return work


@func
def spin_after(grains, loads, body, i, duration, p: Params):
    """Spin [rad/s] of grain i, `duration` [s] later under the torque in `loads`."""
    return load(grains, i, W) + load(loads, i, T) * (duration / inertia_of(body, i, p.inertia))
