"""Reading forces and velocities without changing the motion."""

from labbook_dem.words import real

from labbook_numba.kernels.bodies import mass_of
from labbook_numba.kernels.features import ANY_WALLS, PAIRS, F, V, entry
from labbook_numba.kernels.shape import pair_now, spin_later, walls_now
from labbook_numba.kernels.transfer import write_row
from labbook_numba.state import Params, State


@entry
def contact_rows(st: State, p: Params, out):
    """Rows i, j, wall, force on i [N], branch vector from i [m] of all touching contacts; how many there are."""
    found = 0
    dt = real(p.dt)
    for k in range(st.count[PAIRS]):
        i = st.pair_i[k]
        j = st.pair_j[k]
        touches, force, branch = pair_now(st, p, i, j, k, dt)
        if touches:
            write_row(out, found, st.ids[i], st.ids[j], -1, force, branch)
            found += 1
    if not ANY_WALLS:
        return found
    for w in range(len(p.wall_kind)):
        for k in range(st.wall_first[w], st.wall_first[w + 1]):
            found = walls_now(st, p, w, k, dt, out, found)
    return found


@entry
def whole_step(grains, loads, body, later, p: Params, v, w):
    """Velocities [m/s] and spins [rad/s] into v and w: those of `grains`, `later` [s] later by `loads`."""
    for i in range(len(v)):
        for c in range(3):
            v[i, c] = grains[i, V + c] + loads[i, F + c] * (later / mass_of(body, i, p.mass))
        spin = spin_later(grains, loads, body, i, later, p)
        w[i, 0] = spin.x
        w[i, 1] = spin.y
        w[i, 2] = spin.z
