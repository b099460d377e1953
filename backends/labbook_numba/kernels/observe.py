"""Reading forces without changing the motion."""

from labbook_dem.words import dot, func, narrow, real, sqrt, vec3, wide, wide3

from labbook_numba.kernels.blocks import touch
from labbook_numba.kernels.features import ANY_WALLS, MOVING, PAIRS, kernel
from labbook_numba.kernels.walls import load, wall_distance, wall_velocity
from labbook_numba.state import Params, State


@kernel
def contact_rows(st: State, p: Params, out):
    """Rows i, j, wall, force on i [N], branch vector from i [m] of all touching contacts; how many there are."""
    found = 0
    half = real(wide(0.5) * p.dt)
    rate = real(wide(0.125) * p.inertia / p.dt)
    zero = real(0.0)
    diameter = wide(2.0) * p.radius
    for k in range(st.count[PAIRS]):
        i = st.pair_i[k]
        j = st.pair_j[k]
        away = load(st.x, i) - load(st.x, j)
        r = sqrt(dot(away, away))
        if r < diameter:
            lever = real(wide(0.5) * r)
            force, _, _, _ = touch(
                p.c, real(wide(0.5) * p.radius), real(wide(0.5) * p.mass), lever, lever, real(p.radius),
                real(diameter - r), narrow(away * (wide(1.0) / r)), narrow(load(st.u, i) - load(st.u, j)),
                narrow(load(st.o, i)), narrow(load(st.o, j)), spring_of(st.spring, st.held, k), half, rate,
            )  # fmt: skip
            put(out, found, st.ids[i], st.ids[j], -1, force, -away)
            found += 1
    if not ANY_WALLS:
        return found
    for w in range(len(p.wall_kind)):
        c = p.wall_c
        row = (c[w, 0], c[w, 1], c[w, 2], c[w, 3], c[w, 4], c[w, 5], c[w, 6], c[w, 7])
        spin = vec3(zero, zero, real(p.wall_motion[w, 3]))
        for k in range(st.wall_first[w], st.wall_first[w + 1]):
            i = st.wall_grain[k]
            x = load(st.x, i)
            distance, normal_w = wall_distance(p, w, x)
            if distance < p.radius:
                u = load(st.u, i)
                if MOVING:
                    u = u - wall_velocity(p, w, x - normal_w * distance)
                force, _, _, _ = touch(
                    row, real(p.radius), real(p.mass), real(distance), zero, real(p.radius),
                    real(p.radius - distance), narrow(normal_w), narrow(u), narrow(load(st.o, i)), spin,
                    spring_of(st.wall_spring, st.wall_held, k), half, rate,
                )  # fmt: skip
                put(out, found, st.ids[i], -1, w, force, -(normal_w * distance))
                found += 1
    return found


@func
def spring_of(spring, held, k):
    """The spring of entry k; none if it is not held."""
    kept = wide(held[k])
    return narrow(wide3(spring[0, k] * kept, spring[1, k] * kept, spring[2, k] * kept))


@kernel
def put(out, row, i, j, wall, force, branch):
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
