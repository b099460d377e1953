"""Reading forces on rods without changing the motion."""

from labbook_dem.contact import rolling_rate
from labbook_dem.rods import rod_on_rod
from labbook_dem.rotation import spin
from labbook_dem.segments import closest
from labbook_dem.words import dot, narrow, real, wide

from labbook_numba.kernels.blocks import reals
from labbook_numba.kernels.bodies import rolling_inertia
from labbook_numba.kernels.features import ANY_WALLS, PAIRS, WALL_PARTS, A, F, M, P, T, U, V, W, X, entry
from labbook_numba.kernels.rod_walls import heritage, measure_rod, wall_contact
from labbook_numba.kernels.rods import store
from labbook_numba.kernels.transfer import advance_of, load, spring_of, write_row
from labbook_numba.state import Params, State


@entry
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
        overlap2 = diameter * diameter - dot(away, away)
        if overlap2 > wide(0.0):
            force, _, _, _, _ = rod_on_rod(
                reals(p.c), real(p.radius), real(p.mass), narrow(away), real(overlap2), narrow(a * s), narrow(b * t),
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
            now = measure_rod(st.grains, st.near, p.walls, p.wall_kind, w, i, p.half, p.radius)
            was = int(st.wall_held[k])
            for part in range(WALL_PARTS):
                if (now >> part) & 1:
                    spring, held = heritage(st.wall_spring, k, part, was, now)
                    force, _, _, point = wall_contact(
                        st, p, w, i, part, spring, half_dt * (real(1.0) + held), rate
                    )  # fmt: skip
                    write_row(out, found, st.ids[i], -1, w, force, point)
                    found += 1
    return found


@entry
def whole_step(grains, loads, body, later, p: Params, v, w):
    """Velocities [m/s] and spins [rad/s] into v and w: those of `grains`, `later` [s] later by `loads`."""
    for i in range(len(v)):
        store(v, i, 0, load(grains, i, V) + load(loads, i, F) * (later / p.mass))
        m = load(grains, i, M) + load(loads, i, T) * (later / p.inertia)
        store(w, i, 0, spin(m, load(grains, i, A), p.slender))
