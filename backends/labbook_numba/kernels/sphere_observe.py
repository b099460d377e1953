"""Contacts of a sphere at the present time, for readings."""

from labbook_dem.chosen import wall_distance
from labbook_dem.contact import rolling_rate
from labbook_dem.spheres import sphere_on_sphere, sphere_on_wall
from labbook_dem.words import dot, func, narrow, real, sqrt, vec3, wide, wide3

from labbook_numba.kernels.blocks import reals, row_of
from labbook_numba.kernels.bodies import inertia_of, kind_of, mass_of, radius_of
from labbook_numba.kernels.branches import branch_between
from labbook_numba.kernels.features import KINDS, MESH_NUMBER, MESHES, MOVING, WALL_PARTS, U, V, W, X, int64
from labbook_numba.kernels.mesh_walls import mesh_now
from labbook_numba.kernels.surfaces import wall_numbers, wall_velocity
from labbook_numba.kernels.transfer import advance_of, load, spring_at, spring_of, write_row
from labbook_numba.state import Params, State


@func
def pair_now(st: State, p: Params, i, j, k, dt):
    """Contact of listed pair k now: True if it touches, force on i [N], and branch from i to j [m]."""
    zero = real(0.0)
    branch = branch_between(st.grains, i, j, p.period)
    ri, rj = radius_of(st.body, i, p.radius), radius_of(st.body, j, p.radius)
    mi, mj = mass_of(st.body, i, p.mass), mass_of(st.body, j, p.mass)
    overlap2 = (ri + rj) * (ri + rj) - dot(branch, branch)
    touches = overlap2 > wide(0.0)
    force = vec3(zero, zero, zero)
    if touches:
        force, _, _, _, _ = sphere_on_sphere(
            reals(row_of(p.pair_c, kind_of(st.body, i) * KINDS + kind_of(st.body, j))),
            real(ri), real(rj), real(mi), real(mj), narrow(branch), real(overlap2),
            narrow(load(st.grains, i, U) - load(st.grains, j, U)),
            narrow(load(st.grains, i, V) - load(st.grains, j, V)),
            narrow(load(st.grains, i, W)), narrow(load(st.grains, j, W)),
            spring_of(st.spring, st.held, k), advance_of(st.held, k, dt),
            rate_of(st.body, i, p), rate_of(st.body, j, p),
        )  # fmt: skip
    return touches, force, -branch


@func
def walls_now(st: State, p: Params, w, k, dt, out, count):
    """Write the contacts of entry k with wall w to `out` from row `count` on; return the new number of rows."""
    if MESHES:  # noqa: SIM102 - compiled code leaves out what one constant decides
        if p.wall_kind[w] == MESH_NUMBER:
            return mesh_now(st, p, w, k, dt, out, count)
    zero = real(0.0)
    spin = vec3(zero, zero, real(p.wall_motion[w, 3]))
    i = st.wall_grain[k]
    x = load(st.grains, i, X)
    distance, normal_w = wall_distance(wall_numbers(p.walls, w), w, int(p.wall_kind[w]), x)
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
            spring_at(st.wall_spring, int64(k) * int64(WALL_PARTS), wide(st.wall_held[k])),
            advance_of(st.wall_held, k, dt), rate_of(st.body, i, p),
        )  # fmt: skip
        write_row(out, count, st.ids[i], -1, w, force, -(normal_w * distance))
        count += 1
    return count


@func
def normal_now(st: State, p: Params, w, k, row, rows):
    """Unit normal from wall w to the sphere of entry k, along the branch to the contact."""
    branch = wide3(rows[row, 6], rows[row, 7], rows[row, 8])
    return branch * (wide(-1.0) / sqrt(dot(branch, branch)))


@func
def rate_of(body, i, p):
    """`rolling_rate` of grain i."""
    return rolling_rate(real(inertia_of(body, i, p.inertia)), real(p.dt))
