"""Reading forces without changing the motion."""

from labbook_dem.words import dot, narrow, real, sqrt, vec3, wide
from labbook_numba.kernels.features import ANY_WALLS, GRAINS, MOVING, kernel
from labbook_numba.kernels.forces import load, touch, wall_distance, wall_velocity
from labbook_numba.state import Params, State


@kernel
def contact_rows(st: State, p: Params, out):
    """Rows i, j, wall, force on i [N], branch vector from i [m] of all touching contacts; how many there are."""
    found = 0
    half = real(0.5 * p.dt)
    rate = real(0.125 * p.inertia / p.dt)
    zero = real(0.0)
    reach = wide(2.0) * p.radius
    for i in range(st.count[GRAINS]):
        x = load(st.x, i)
        u = load(st.u, i)
        o = narrow(load(st.o, i))
        for k in range(st.row[i], st.row[i + 1]):
            j = st.pair_j[k]
            away = x - load(st.x, j)
            r = sqrt(dot(away, away))
            if r < reach:
                lever = real(0.5 * r)
                force, _, _, _ = touch(
                    p.c, real(0.5 * p.radius), real(0.5 * p.mass), lever, lever, real(p.radius), real(reach - r),
                    narrow(away * (wide(1.0) / r)), narrow(u - load(st.u, j)), o, narrow(load(st.o, j)),
                    narrow(load(st.spring, k)), half, rate,
                )  # fmt: skip
                put(out, found, st.ids[i], st.ids[j], -1, force, -away)
                found += 1
        if ANY_WALLS:
            for k in range(st.wall_row[i], st.wall_row[i + 1]):
                w = st.wall_of[k]
                distance, normal = wall_distance(p, w, x)
                if distance < p.radius:
                    c = p.wall_c
                    row = (c[w, 0], c[w, 1], c[w, 2], c[w, 3], c[w, 4], c[w, 5], c[w, 6], c[w, 7])
                    relative = u
                    spin = vec3(zero, zero, zero)
                    if MOVING:
                        surface, turns = wall_velocity(p, w, x, normal, distance)
                        relative = u - surface
                        spin = vec3(zero, zero, real(turns))
                    force, _, _, _ = touch(
                        row, real(p.radius), real(p.mass), real(distance), zero, real(p.radius),
                        real(p.radius - distance), narrow(normal), narrow(relative), o, spin,
                        narrow(load(st.wall_spring, k)), half, rate,
                    )  # fmt: skip
                    put(out, found, st.ids[i], -1, w, force, -(normal * distance))
                    found += 1
    return found


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
