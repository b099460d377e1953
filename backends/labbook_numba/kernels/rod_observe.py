"""Contacts of a rod at the present time, for readings."""

from labbook_dem.contact import rolling_rate
from labbook_dem.rods import rod_on_rod
from labbook_dem.rotation import spin
from labbook_dem.segments import closest
from labbook_dem.words import dot, func, narrow, real, vec3, wide, wide3

from labbook_numba.kernels.blocks import reals
from labbook_numba.kernels.bodies import rolling_inertia
from labbook_numba.kernels.features import MESH_NUMBER, MESHES, WALL_PARTS, A, M, P, T, U, V, W, X
from labbook_numba.kernels.rod_walls import inherited_spring, measure_rod_at, wall_contact
from labbook_numba.kernels.transfer import advance_of, load, spring_of, write_row
from labbook_numba.state import Params, State


@func
def pair_now(st: State, p: Params, i, j, k, dt):
    """Contact of listed pair k now: True if it touches, force on i [N], and branch from i to j [m]."""
    zero = real(0.0)
    rate = rolling_rate(rolling_inertia(p.inertia, p.slender), dt)
    diameter = wide(2.0) * p.radius
    g = st.grains
    branch = load(g, i, X) - load(g, j, X)
    a = load(g, i, A)
    b = load(g, j, A)
    s, t, r = closest(branch, a, b, p.half)
    overlap2 = diameter * diameter - dot(r, r)
    touches = overlap2 > wide(0.0)
    force = vec3(zero, zero, zero)
    if touches:
        force, _, _, _, _ = rod_on_rod(
            reals(p.c), real(p.radius), real(p.mass), narrow(r), real(overlap2), narrow(a * s), narrow(b * t),
            narrow(load(g, i, U) - load(g, j, U)), narrow(load(g, i, V) - load(g, j, V)),
            narrow(load(g, i, P)), narrow(load(g, j, P)), narrow(load(g, i, W)), narrow(load(g, j, W)),
            spring_of(st.spring, st.held, k), advance_of(st.held, k, dt), rate,
        )  # fmt: skip
    return touches, force, -branch


@func
def walls_now(st: State, p: Params, w, k, dt, out, count):
    """Write the contacts of entry k with wall w to `out` from row `count` on; return the new number of rows."""
    rate = rolling_rate(rolling_inertia(p.inertia, p.slender), dt)
    half_dt = real(0.5) * dt
    i = st.wall_grain[k]
    is_mesh = MESHES and p.wall_kind[w] == MESH_NUMBER
    now, older = measure_rod_at(st, p, w, k)
    before = int(st.wall_held[k])
    for part in range(WALL_PARTS):
        if (now >> part) & 1:
            spring, has_spring = inherited_spring(st.wall_spring, k, part, before, now, is_mesh, older)
            force, _, _, point = wall_contact(st, p, w, i, part, spring, half_dt * (real(1.0) + has_spring), rate)
            write_row(out, count, st.ids[i], -1, w, force, point)
            count += 1
    return count


@func
def normal_now(st: State, p: Params, w, k, row, rows):
    """Unit normal from wall w to the rod of entry k at contact number `row`."""
    now, _ = measure_rod_at(st, p, w, k)
    number, contacts = 0, 0
    for part in range(WALL_PARTS):
        if (now >> part) & 1:
            if contacts == row:
                number = part
            contacts += 1
    return wide3(wide(st.near[number * 5 + 1]), wide(st.near[number * 5 + 2]), wide(st.near[number * 5 + 3]))


@func
def spin_after(grains, loads, body, i, duration, p: Params):
    """Spin [rad/s] of grain i, `duration` [s] later under the torque in `loads`."""
    m = load(grains, i, M) + load(loads, i, T) * (duration / p.inertia)
    return spin(m, load(grains, i, A), p.slender)
