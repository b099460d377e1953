"""Readings of forces and velocities without a change of the motion."""

from labbook_dem.words import real

from labbook_numba.kernels.bodies import mass_of
from labbook_numba.kernels.clumps import centre_of_clump
from labbook_numba.kernels.features import ANY_WALLS, CLUMPS, PAIRS, F, V, X, entry
from labbook_numba.kernels.shape import pair_now, spin_after, walls_now
from labbook_numba.kernels.transfer import load, write_row
from labbook_numba.state import Params, State


@entry
def contact_rows(st: State, p: Params, out):
    """Write rows i, j, wall, force on i [N], branch vector from i [m] of all touching contacts; return their number."""
    count = 0
    dt = real(p.dt)
    for k in range(st.count[PAIRS]):
        i = st.pair_i[k]
        j = st.pair_j[k]
        touches, force, branch = pair_now(st, p, i, j, k, dt)
        if touches:
            if CLUMPS:
                branch = centre_of_clump(st, p, j) - centre_of_clump(st, p, i)
            write_row(out, count, st.ids[i], st.ids[j], -1, force, branch)
            count += 1
    if not ANY_WALLS:
        return count
    for w in range(len(p.wall_kind)):
        for k in range(st.wall_first[w], st.wall_first[w + 1]):
            first = count
            count = walls_now(st, p, w, k, dt, out, count)
            if CLUMPS:
                i = st.wall_grain[k]
                lever = load(st.grains, i, X) - centre_of_clump(st, p, i)
                for row in range(first, count):
                    out[row, 6] += lever.x
                    out[row, 7] += lever.y
                    out[row, 8] += lever.z
    return count


@entry
def whole_step(grains, loads, body, duration, p: Params, v, w):
    """Write velocities [m/s] and spins [rad/s] to v and w: those of `grains`, `duration` [s] later under `loads`."""
    for i in range(len(v)):
        for c in range(3):
            v[i, c] = grains[i, V + c] + loads[i, F + c] * (duration / mass_of(body, i, p.mass))
        spin = spin_after(grains, loads, body, i, duration, p)
        w[i, 0] = spin.x
        w[i, 1] = spin.y
        w[i, 2] = spin.z
