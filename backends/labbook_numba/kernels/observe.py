"""Reading forces without changing the motion."""

from labbook_dem.contact import rolling_rate
from labbook_dem.spheres import sphere_on_sphere, sphere_on_wall
from labbook_dem.words import VARIED, dot, func, narrow, real, vec3, wide, wide3

from labbook_numba.kernels.blocks import reals, row_of
from labbook_numba.kernels.bodies import inertia_of, kind_of, mass_of, radius_of
from labbook_numba.kernels.features import ANY_WALLS, KINDS, MOVING, PAIRS, F, T, U, V, W, X, entry, kernel
from labbook_numba.kernels.walls import load, wall_distance, wall_velocity
from labbook_numba.state import Params, State


@entry
def contact_rows(st: State, p: Params, out):
    """Rows i, j, wall, force on i [N], branch vector from i [m] of all touching contacts; how many there are."""
    found = 0
    dt = real(p.dt)
    zero = real(0.0)
    for k in range(st.count[PAIRS]):
        i = st.pair_i[k]
        j = st.pair_j[k]
        away = load(st.grains, i, X) - load(st.grains, j, X)
        ri, rj = radius_of(st.body, i, p.radius), radius_of(st.body, j, p.radius)
        mi, mj = mass_of(st.body, i, p.mass), mass_of(st.body, j, p.mass)
        gap = (ri + rj) * (ri + rj) - dot(away, away)
        if gap > wide(0.0):
            force, _, _, _, _ = sphere_on_sphere(
                reals(row_of(p.pair_c, kind_of(st.body, i) * KINDS + kind_of(st.body, j))),
                real(ri), real(rj), real(mi), real(mj), narrow(away), real(gap),
                narrow(load(st.grains, i, U) - load(st.grains, j, U)),
                narrow(load(st.grains, i, V) - load(st.grains, j, V)),
                narrow(load(st.grains, i, W)), narrow(load(st.grains, j, W)),
                spring_of(st.spring, st.held, k), advance_of(st.held, k, dt),
                rate_of(st.body, i, p), rate_of(st.body, j, p),
            )  # fmt: skip
            write_row(out, found, st.ids[i], st.ids[j], -1, force, -away)
            found += 1
    if not ANY_WALLS:
        return found
    for w in range(len(p.wall_kind)):
        spin = vec3(zero, zero, real(p.wall_motion[w, 3]))
        for k in range(st.wall_first[w], st.wall_first[w + 1]):
            i = st.wall_grain[k]
            x = load(st.grains, i, X)
            distance, normal_w = wall_distance(p.wall_shape, p.wall_kind, w, x)
            radius = radius_of(st.body, i, p.radius)
            if distance < radius:
                u = load(st.grains, i, U)
                v = load(st.grains, i, V)
                if MOVING:
                    surface = wall_velocity(p.wall_motion, w, x - normal_w * distance)
                    u = u - surface
                    v = v - surface
                force, _, _ = sphere_on_wall(
                    reals(row_of(p.wall_c, w * KINDS + kind_of(st.body, i))),
                    real(radius), real(mass_of(st.body, i, p.mass)), real(radius - distance), narrow(normal_w),
                    narrow(u), narrow(v), narrow(load(st.grains, i, W)), spin,
                    spring_of(st.wall_spring, st.wall_held, k), advance_of(st.wall_held, k, dt),
                    rate_of(st.body, i, p),
                )  # fmt: skip
                write_row(out, found, st.ids[i], -1, w, force, -(normal_w * distance))
                found += 1
    return found


@func
def rate_of(body, i, p):
    """`rolling_rate` of grain i."""
    return rolling_rate(real(inertia_of(body, i, p.inertia)), real(p.dt))


@func
def spring_of(spring, held, k):
    """The spring of entry k; none if it is not held."""
    kept = wide(held[k])
    return narrow(wide3(spring[k, 0] * kept, spring[k, 1] * kept, spring[k, 2] * kept))


@func
def advance_of(held, k, dt):
    """By how much the spring of entry k is to be advanced [s]."""
    return real(0.5) * dt * (real(1.0) + real(held[k]))


@kernel
def write_row(out, row, i, j, wall, force, branch):
    """Write one row."""
    out[row, 0] = i
    out[row, 1] = j
    out[row, 2] = wall
    out[row, 3] = force.x
    out[row, 4] = force.y
    out[row, 5] = force.z
    out[row, 6] = branch.x
    out[row, 7] = branch.y
    out[row, 8] = branch.z


@entry
def whole_step(grains, loads, body, part, mass, inertia, v, w):
    """Velocities [m/s] and spins [rad/s] into v and w: those of `grains`, `part` [s] later by `loads`."""
    for i in range(len(v)):
        if VARIED:
            mass, inertia = body[i, 1], body[i, 2]
        for c in range(3):
            v[i, c] = grains[i, V + c] + loads[i, F + c] * (part / mass)
            w[i, c] = grains[i, W + c] + loads[i, T + c] * (part / inertia)
