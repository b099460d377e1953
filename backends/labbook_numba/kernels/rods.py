"""Rods: criteria for lists, rotation, and work of contacts; as `spheres`."""

from labbook_dem.chosen import wall_edges, wall_part
from labbook_dem.motion import kick, predict
from labbook_dem.rotation import axis, spin, turn
from labbook_dem.segments import closest
from labbook_dem.words import dot, func, sqrt, wide, wide3

from labbook_numba.kernels.branches import branch_between
from labbook_numba.kernels.features import GRAIN, GRAINS, PLATE_PARTS, A, F, M, P, Q, T, V, W, X, kernel, uint64
from labbook_numba.kernels.surfaces import wall_numbers
from labbook_numba.kernels.transfer import load, store
from labbook_numba.lanes import put_row, row_at, square
from labbook_numba.state import Params, State


@func
def near_grain(grains, body, i, j, reach, half, skin, period):
    """True if the segments of two rods are closer than `reach` [m], a diameter and a skin."""
    centre_limit = reach + wide(2.0) * half  # centres further apart cannot be near
    branch = branch_between(grains, i, j, period)
    near = dot(branch, branch) < centre_limit * centre_limit
    if near:
        _, _, closest_branch = closest(branch, load(grains, i, A), load(grains, j, A), half)
        near = dot(closest_branch, closest_branch) < reach * reach
    return near


@func
def near_wall(grains, body, i, walls, kind, w, radius, half, skin):
    """True if a part of rod i is closer than a radius and a skin to wall w."""
    x = load(grains, i, X)
    axis = load(grains, i, A)
    reach = radius + skin
    numbers = wall_numbers(walls, w)
    met, on, twin, back = wall_edges(numbers, w, kind[w], x, axis, half, reach)
    near = False
    for part in range(PLATE_PARTS):
        distance, _, _ = wall_part(numbers, w, kind[w], x, axis, half, reach, part, met, on, twin, back)
        near = near or distance < reach
    return near


@func
def turn_grain(g, i, turn_acc, v, slender, half, kick_dt, dt):
    """Kick, turn and predict rod i by the angular acceleration turn_acc = T/I_t [rad/s^2].

    Returns the square of an upper bound of the speed of its ends, |v| + h |m x a| [m^2/s^2].
    """
    at = i * GRAIN
    put_row(g, at + M, kick(row_at(g, at + M), turn_acc, kick_dt))
    m = load(g, i, M)
    qw, qx, qy, qz = turn(g[i, Q], g[i, Q + 1], g[i, Q + 2], g[i, Q + 3], m, slender, dt)
    g[i, Q] = qw
    g[i, Q + 1] = qx
    g[i, Q + 2] = qy
    g[i, Q + 3] = qz
    a = axis(qw, qx, qy, qz)
    store(g, i, A, a)
    store(g, i, W, spin(m, a, slender))
    # the normal dashpot needs the spin at the time of the positions; the leapfrog has it half a step before
    put_row(g, at + P, predict(row_at(g, at + M), turn_acc, dt))
    store(g, i, P, spin(load(g, i, P), a, slender))
    rate = wide3(m.y * a.z - m.z * a.y, m.z * a.x - m.x * a.z, m.x * a.y - m.y * a.x)
    speed = sqrt(square(v)) + half * sqrt(dot(rate, rate))
    return speed * speed


@kernel
def contact_work(st: State, p: Params, kick_dt):
    """Work [J] of the contact forces in loads during the next kick: force times mean velocity of the kick."""
    work = wide(0.0)
    half = wide(0.5) * kick_dt
    for i in range(uint64(st.count[GRAINS])):
        force = load(st.loads, i, F)
        torque = load(st.loads, i, T)
        # mean velocities of the kick, as for spheres; loads hold the weight too, whose work is taken off
        v = load(st.grains, i, V) + force * (half / p.mass)
        m = load(st.grains, i, M) + torque * (half / p.inertia)
        work += dot(force, v) + p.mass * p.gravity * v.z + dot(torque, spin(m, load(st.grains, i, A), p.slender))
    return work * kick_dt
