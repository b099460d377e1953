"""Reading forces on rods without changing the motion."""

from labbook_dem.contact import rolling_rate
from labbook_dem.rods import rod_on_rod
from labbook_dem.rotation import spin
from labbook_dem.segments import closest
from labbook_dem.words import dot, narrow, real, wide

from labbook_numba.kernels.blocks import reals
from labbook_numba.kernels.features import ANY_WALLS, GRAINS, PAIRS, PARTS, STEP, A, F, M, P, T, U, V, W, X, kernel
from labbook_numba.kernels.rod_blocks import rolling_inertia
from labbook_numba.kernels.rod_move import store
from labbook_numba.kernels.rod_pairs import pair_forces
from labbook_numba.kernels.rod_walls import heritage, measure_rod, wall_contact, wall_forces
from labbook_numba.kernels.single import advance_of, load, spring_of, write_row
from labbook_numba.state import Params, State


@kernel
def contact_rows(st: State, p: Params, out):
    """Rows i, j, wall, force on i [N], branch vector from i [m] of all touching contacts; how many there are."""
    found = 0
    dt = real(p.dt)
    rate = rolling_rate(rolling_inertia(p.inertia, p.slender), dt)
    diameter = wide(2.0) * p.radius
    g = st.grains
    for k in range(st.count[PAIRS]):
        i = st.pair_i[k]
        j = st.pair_j[k]
        branch = load(g, i, X) - load(g, j, X)
        a = load(g, i, A)
        b = load(g, j, A)
        s, t, away = closest(branch, a, b, p.half)
        gap = diameter * diameter - dot(away, away)
        if gap > wide(0.0):
            force, _, _, _, _ = rod_on_rod(
                reals(p.c), real(p.radius), real(p.mass), narrow(away), real(gap), narrow(a * s), narrow(b * t),
                narrow(load(g, i, U) - load(g, j, U)), narrow(load(g, i, V) - load(g, j, V)),
                narrow(load(g, i, P)), narrow(load(g, j, P)), narrow(load(g, i, W)), narrow(load(g, j, W)),
                spring_of(st.spring, st.held, k), advance_of(st.held, k, dt), rate,
            )  # fmt: skip
            write_row(out, found, st.ids[i], st.ids[j], -1, force, -branch)
            found += 1
    if not ANY_WALLS:
        return found
    half_dt = real(0.5) * dt
    for w in range(len(p.wall_kind)):
        for k in range(st.wall_first[w], st.wall_first[w + 1]):
            i = st.wall_grain[k]
            now = measure_rod(st, p, w, i)
            was = int(st.wall_held[k])
            for part in range(PARTS):
                if (now >> part) & 1:
                    spring, held = heritage(st.wall_spring, k, part, was, now)
                    force, _, _, point = wall_contact(
                        st, p, w, i, part, spring, half_dt * (real(1.0) + held), rate
                    )  # fmt: skip
                    write_row(out, found, st.ids[i], -1, w, force, point)
                    found += 1
    return found


@kernel
def whole_step(st: State, p: Params, v, w):
    """Velocities [m/s] and spins [rad/s] at the whole step into v and w: half a kick by the forces there.

    The forces are computed in st.loads, and springs advanced: call it on a copy of the state.
    """
    pair_forces(st, p)
    if ANY_WALLS:
        wall_forces(st, p)
    part = wide(0.5) * p.dt if st.count[STEP] > 0 else wide(0.0)
    for i in range(st.count[GRAINS]):
        store(v, i, 0, load(st.grains, i, V) + load(st.loads, i, F) * (part / p.mass))
        m = load(st.grains, i, M) + load(st.loads, i, T) * (part / p.inertia)
        store(w, i, 0, spin(m, load(st.grains, i, A), p.slender))
