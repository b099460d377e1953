"""Forces of walls on rods, one rod and wall at a time.

Few rods are at walls. Each touches at up to four points, at a mesh at up to eight.
"""

from labbook_dem.chosen import wall_edges, wall_part
from labbook_dem.contact import rolling_rate
from labbook_dem.poses import part_spin, part_velocity, part_velocity_before, spring_inwards, spring_outwards
from labbook_dem.rods import has, rod_on_wall, spring_source
from labbook_dem.words import func, narrow, real, vec3, wide, wide3

from labbook_numba.kernels.blocks import reals
from labbook_numba.kernels.bodies import rolling_inertia
from labbook_numba.kernels.features import (
    FAIL_GRAIN,
    FRICTION,
    LEDGER,
    MAX_OVERLAP,
    MESH_NUMBER,
    MESHES,
    MOVING,
    PLATE_PARTS,
    POSES,
    STEP,
    TOUCHING,
    WALL_PARTS,
    A,
    F,
    P,
    T,
    U,
    V,
    W,
    X,
    kernel,
)
from labbook_numba.kernels.poses import pose_now
from labbook_numba.kernels.rod_meshes import key_rod_springs, measure_rod_at_mesh
from labbook_numba.kernels.surfaces import near_here, wall_numbers, wall_velocity
from labbook_numba.kernels.transfer import load
from labbook_numba.state import Params, State


@kernel
def measure_rod(grains, near, walls, kind, w, i, half, radius):
    """Write distance, unit normal and position of each part of rod i at wall w to `near`; return the mask of touching
    parts."""
    x = load(grains, i, X)
    axis = load(grains, i, A)
    numbers = wall_numbers(walls, w)
    met, on, twin, back = wall_edges(numbers, w, kind[w], x, axis, half, radius)
    now = 0
    for part in range(PLATE_PARTS):
        distance, normal, s = wall_part(numbers, w, kind[w], x, axis, half, radius, part, met, on, twin, back)
        if distance < radius:
            now |= 1 << part
            near[part * 5] = distance
            near[part * 5 + 1] = normal.x
            near[part * 5 + 2] = normal.y
            near[part * 5 + 3] = normal.z
            near[part * 5 + 4] = s
    return now


@kernel
def measure_rod_at(st: State, p: Params, w, k):
    """Measure the rod of entry k at wall w; return the masks of touching parts and, at a mesh, of parts with an older
    spring."""
    if MESHES:  # noqa: SIM102 - compiled code leaves out what one constant decides
        if p.wall_kind[w] == MESH_NUMBER:
            return measure_rod_at_mesh(st, p, w, k)
    return measure_rod(st.grains, st.near, p.walls, p.wall_kind, w, st.wall_grain[k], p.half, p.radius), 0


@func
def wall_contact(st: State, p: Params, w, i, part, spring, dt, rate):
    """Force and torque of wall w on a measured part of rod i, spring, and branch from the rod's centre [m].

    Springs are in the frame of the wall.
    """
    c = p.wall_c
    zero = real(0.0)
    distance = st.near[part * 5]
    n = wide3(wide(st.near[part * 5 + 1]), wide(st.near[part * 5 + 2]), wide(st.near[part * 5 + 3]))
    lever = load(st.grains, i, A) * st.near[part * 5 + 4]
    branch = lever - n * distance
    u = load(st.grains, i, U)
    v = load(st.grains, i, V)
    if MOVING:
        surface = wall_velocity(p.wall_motion, w, load(st.grains, i, X) + branch)
        u = u - surface
        v = v - surface
        if POSES:
            point = load(st.grains, i, X) + branch
            u = u - part_velocity(st.pose, pose_now(st), w, point)
            v = v - part_velocity_before(st.pose, pose_now(st), w, point, p.dt, st.count[STEP])
    spin = vec3(zero, zero, real(p.wall_motion[w, 3]))
    if POSES:
        spin = spin + part_spin(st.pose, pose_now(st), w)
        spring = spring_outwards(st.pose, pose_now(st), w, spring)
    force, torque, new_spring = rod_on_wall(
        reals((c[w, 0], c[w, 1], c[w, 2], c[w, 3], c[w, 4], c[w, 5], c[w, 6], c[w, 7])), real(p.radius), real(p.mass),
        real(p.radius - distance), narrow(n), narrow(lever), narrow(u), narrow(v), narrow(load(st.grains, i, P)),
        narrow(load(st.grains, i, W)), spin, spring, dt, rate,
    )  # fmt: skip
    if POSES:
        return force, torque, spring_inwards(st.pose, pose_now(st), w, new_spring), branch
    return force, torque, new_spring, branch


@func
def inherited_spring(spring, k, part, before, now, is_mesh, older):
    """Spring that a part inherits, and 1 if there is one, else 0; at a mesh its own spring, if that is `older`."""
    # a turning rod may shift its contact from one part to another: the friction spring goes on there
    source = spring_source(part, before, now)
    if MESHES:
        # springs of meshes belong to a feature of the mesh, and are found by its number
        own_part = part if has(older, part) else -1
        source = own_part if is_mesh else source
    valid = wide(1.0) if source >= 0 else wide(0.0)
    row = k * WALL_PARTS + max(source, 0)
    return narrow(wide3(spring[row, 0] * valid, spring[row, 1] * valid, spring[row, 2] * valid)), real(valid)


@kernel
def wall_forces(st: State, p: Params):
    """Add the forces of walls on rods to loads, and advance their springs; continues the totals of `pair_forces`."""
    dt = real(0.5) * real(p.dt)
    rate = rolling_rate(rolling_inertia(p.inertia, p.slender), real(p.dt))
    zero = real(0.0)
    touching = 0
    for w in range(len(p.wall_kind)):
        is_mesh = MESHES and p.wall_kind[w] == MESH_NUMBER
        first, last = near_here(st.domain, st.wall_grain, st.wall_first[w], st.wall_first[w + 1])
        for k in range(first, last):
            i = st.wall_grain[k]
            now, older = measure_rod_at(st, p, w, k)
            before = int(st.wall_held[k])
            if FRICTION:
                st.wall_held[k] = now
            if now == 0:
                continue
            # at plates all springs are read before one is written: a part may inherit the spring of another
            spring0, valid0 = inherited_spring(st.wall_spring, k, 0, before, now, is_mesh, older)
            spring1, valid1 = inherited_spring(st.wall_spring, k, 1, before, now, is_mesh, older)
            spring2, valid2 = inherited_spring(st.wall_spring, k, 2, before, now, is_mesh, older)
            spring3, valid3 = inherited_spring(st.wall_spring, k, 3, before, now, is_mesh, older)
            for part in range(WALL_PARTS):
                if has(now, part):
                    spring, valid = spring0, valid0
                    if part == 1:
                        spring, valid = spring1, valid1
                    if part == 2:
                        spring, valid = spring2, valid2
                    if part == 3:
                        spring, valid = spring3, valid3
                    if MESHES:  # noqa: SIM102 - compiled code leaves out what one constant decides
                        if part > 3:
                            spring, valid = inherited_spring(st.wall_spring, k, part, before, now, is_mesh, older)
                    if not FRICTION:
                        spring = vec3(zero, zero, zero)
                    force, torque, new_spring, _ = wall_contact(
                        st, p, w, i, part, spring, dt * (real(1.0) + valid), rate
                    )
                    st.loads[i, F + 0] += force.x
                    st.loads[i, F + 1] += force.y
                    st.loads[i, F + 2] += force.z
                    st.loads[i, T + 0] += torque.x
                    st.loads[i, T + 1] += torque.y
                    st.loads[i, T + 2] += torque.z
                    if FRICTION:
                        st.wall_spring[k * WALL_PARTS + part, 0] = new_spring.x
                        st.wall_spring[k * WALL_PARTS + part, 1] = new_spring.y
                        st.wall_spring[k * WALL_PARTS + part, 2] = new_spring.z
                    touching += 1
                    overlap = p.radius - st.near[part * 5]
                    # so written that NaN counts as the largest overlap
                    if not overlap <= st.sums[MAX_OVERLAP]:
                        st.sums[MAX_OVERLAP] = overlap
                        if not overlap <= p.overlap_limit:
                            st.count[FAIL_GRAIN] = st.ids[i]
            if FRICTION and is_mesh:
                key_rod_springs(st, k, now)
    if LEDGER:
        st.count[TOUCHING] += touching
