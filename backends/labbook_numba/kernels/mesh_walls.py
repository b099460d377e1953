"""Grains at walls of triangles: which features are near, and the present contacts of spheres; compiled only for scenes
that have a mesh. Those of rods are in `rod_walls`."""

import numpy as np
from labbook_dem.contact import rolling_rate
from labbook_dem.mesh import (
    K_FEATURE,
    K_NORMAL,
    K_OLDER,
    K_OVERLAP,
    K_SPRING,
    MESH_CONTACTS,
    OVER,
    SPRING_KEY,
    mesh_away,
    mesh_cell,
    mesh_contacts,
    mesh_listed,
    mesh_near,
    mesh_normal,
    mesh_springs,
    mesh_vector,
    mesh_within,
)
from labbook_dem.mesh_rods import mesh_rod_near
from labbook_dem.poses import (
    in_part,
    inwards,
    outwards,
    part_spin,
    part_velocity,
    part_velocity_before,
    spring_outwards,
)
from labbook_dem.spheres import sphere_on_wall
from labbook_dem.words import FRICTION, func, narrow, real, vec3, wide

from labbook_numba.kernels.blocks import DEPTH, HELD, NX, UX, VX, put_vector, reals, row_of
from labbook_numba.kernels.bodies import inertia_of, kind_of, mass_of, radius_of
from labbook_numba.kernels.features import (
    BLOCK,
    KINDS,
    MESH_NUMBER,
    MOVING,
    ORIENTED,
    POSES,
    STEP,
    WALL_PARTS,
    A,
    U,
    V,
    W,
    X,
    entry,
    int64,
    kernel,
    uint64,
)
from labbook_numba.kernels.poses import pose_now
from labbook_numba.kernels.surfaces import wall_velocity
from labbook_numba.kernels.transfer import load, spring_at, write_row
from labbook_numba.state import Params, State


@func
def may_touch(features, conditions, f, x, a, half, radius, moves):
    """True if a grain at x, a rod along a, may touch feature f before a point of it has moved by a distance [m]."""
    if ORIENTED:
        return mesh_rod_near(features, conditions, f, x, a, half, radius, moves)
    return mesh_near(features, conditions, f, x, radius, moves)


@func
def grain_in_frame(st: State, w, i):
    """Position and axis of grain i in the frame of wall w; for spheres the axis has no meaning."""
    x = load(st.grains, i, X)
    a = x
    if ORIENTED:
        a = load(st.grains, i, A)
    if POSES:
        now = pose_now(st)
        x = in_part(st.pose, now, w, x)
        a = inwards(st.pose, now, w, a)
    return x, a


@kernel
def near_mesh(st: State, p: Params, w, i, moves):
    """True if grain i may touch mesh w before a point of it has moved by a distance [m]."""
    features, conditions = p.mesh_features, p.mesh_conditions
    x, a = grain_in_frame(st, w, i)
    radius = radius_of(st.body, i, p.radius)
    cell = mesh_cell(p.mesh_frame, w, x)
    if cell >= 0:
        for k in range(p.mesh_cell[cell], p.mesh_cell[cell + 1]):
            if may_touch(features, conditions, p.mesh_listed[k], x, a, p.half, radius, moves):
                return True
    return False


@entry
def list_features(st: State, p: Params, first, near):
    """List the features that each entry near a mesh may touch before the next rebuild, in ascending order.

    Returns the needed length of `near`, even if it is shorter: features beyond its end are counted only.
    """
    # wider than `near_mesh` by rounding errors: each grain that it listed has a feature here
    moves = wide(1.0000002) * p.mesh_moves
    features, conditions = p.mesh_features, p.mesh_conditions
    rows = 0
    first[0] = 0
    for w in range(len(p.wall_kind)):
        for k in range(st.wall_first[w], st.wall_first[w + 1]):
            if p.wall_kind[w] == MESH_NUMBER:
                i = st.wall_grain[k]
                x, a = grain_in_frame(st, w, i)
                radius = radius_of(st.body, i, p.radius)
                cell = mesh_cell(p.mesh_frame, w, x)
                if cell >= 0:
                    for n in range(p.mesh_cell[cell], p.mesh_cell[cell + 1]):
                        f = p.mesh_listed[n]
                        if may_touch(features, conditions, f, x, a, p.half, radius, moves):
                            if rows < len(near):
                                near[rows] = f
                                if not ORIENTED:
                                    near[rows] = mesh_listed(features, conditions, f, x, moves)
                            rows += 1
            first[k + 1] = rows
    return rows


@kernel
def contacts_at(st: State, p: Params, k, x, radius):
    """Write the contacts of entry k with its mesh to st.touch; return their number. x: position in the mesh's frame."""
    first, last = int(st.mesh_first[k]), int(st.mesh_first[k + 1])
    return mesh_contacts(p.mesh_features, p.mesh_conditions, st.mesh_near, first, last, x, radius, st.touch)


@func
def put_normal(b, count, pose, now, w, motion, x, radius, overlap, normal, dt, step):
    """Write overlap, normal and surface velocities of a contact with mesh w to the block, as contact number `count`."""
    if POSES:
        normal = outwards(pose, now, w, normal)
    put_vector(b, NX + count, normal)
    b[DEPTH + count] = overlap
    if MOVING:
        point = x - normal * (radius - overlap)
        velocity = wall_velocity(motion, w, point)
        if POSES:
            before = part_velocity_before(pose, now, w, point, dt, step)
            put_vector(b, VX + count, velocity + before)
            velocity = velocity + part_velocity(pose, now, w, point)
        put_vector(b, UX + count, velocity)


@func
def put_spring(b, i, slot, j, count, grain, row, feature, older):
    """Write the grain of a contact, the row of its spring and its feature to the block, as contact number `count`."""
    i[count] = grain
    if FRICTION:
        b[HELD + count] = older
        slot[count] = row
        j[count] = feature


@kernel
def pack_mesh(st: State, p: Params, w, k, last, b, i, slot):
    """Write the contacts of the entries from k on with mesh w to the block, until it is full.

    Returns the number of contacts, and the first entry that did not fit. Arrays are taken out of the records once:
    passing a record of many arrays to a function costs time.
    """
    count = uint64(0)
    touch, spring, bits, j = st.touch, st.wall_spring, st.wall_held, st.block_j
    grains, body, listed = st.grains, st.body, st.wall_grain
    features, conditions = p.mesh_features, p.mesh_conditions
    near, first, motion, pose, now = st.mesh_near, st.mesh_first, p.wall_motion, st.pose, int64(0)
    step = st.count[STEP]
    if POSES:
        now = pose_now(st)
    # an entry may have MESH_CONTACTS contacts, and its springs are found together: it is never split between blocks
    while k < last and count + uint64(MESH_CONTACTS) <= BLOCK:
        grain = listed[k]
        x = load(grains, grain, X)
        at = x
        if POSES:
            at = in_part(pose, now, w, x)
        radius = radius_of(body, grain, p.radius)
        begin, end = int64(first[k]), int64(first[k + uint64(1)])
        base = int64(k) * int64(WALL_PARTS)
        before = int64(bits[k])
        # an entry -1 - f stands for a feature whose conditions hold until the next rebuild (`mesh_listed`)
        alone = int64(-1) - int64(near[begin]) if end - begin == 1 else int64(-1)
        if alone >= 0 and (before == 0 or (before == 1 and spring[base, SPRING_KEY] == alone)):
            # most grains: one feature is near, and only with it was there a contact
            away = mesh_away(features, alone, at)
            bits[k] = 0
            if mesh_within(away, radius):
                bits[k] = 1
                distance, normal = mesh_normal(away)
                overlap = radius - distance
                put_normal(b, count, pose, now, w, motion, x, radius, overlap, normal, p.dt, step)
                put_spring(b, i, slot, j, count, grain, base, alone, wide(before))
                count += uint64(1)
        else:
            rows = mesh_contacts(features, conditions, near, begin, end, at, radius, touch)
            if rows == OVER:
                rows = 1
                touch[0, K_OVERLAP] = np.inf  # more contacts than there is room for: the guard stops the run
            if FRICTION:
                bits[k] = mesh_springs(features, touch, rows, before, spring, base)
            for n in range(rows):
                normal, overlap = mesh_vector(touch, n, K_NORMAL), touch[n, K_OVERLAP]
                put_normal(b, count, pose, now, w, motion, x, radius, overlap, normal, p.dt, step)
                row = base + int64(touch[n, K_SPRING])
                put_spring(b, i, slot, j, count, grain, row, int64(touch[n, K_FEATURE]), touch[n, K_OLDER])
                count += uint64(1)
        k += uint64(1)
    return count, k


@kernel
def key_springs(st: State, slot, count):
    """Write the features of the contacts of the block beside their springs."""
    for t in range(count):
        st.wall_spring[slot[t], SPRING_KEY] = st.block_j[t]


@kernel
def mesh_now(st: State, p: Params, w, k, dt, out, rows):
    """Write the contacts of entry k with mesh w, as `walls_now` does."""
    zero = real(0.0)
    spin = vec3(zero, zero, real(p.wall_motion[w, 3]))
    i = st.wall_grain[k]
    x = load(st.grains, i, X)
    radius = radius_of(st.body, i, p.radius)
    position, _ = grain_in_frame(st, w, i)
    contacts = contacts_at(st, p, k, position, radius)
    if POSES:
        spin = spin + part_spin(st.pose, pose_now(st), w)
    base = int64(k) * int64(WALL_PARTS)
    if FRICTION:
        mesh_springs(p.mesh_features, st.touch, contacts, int64(st.wall_held[k]), st.wall_spring, base)
    for n in range(contacts):
        normal = mesh_vector(st.touch, n, K_NORMAL)
        if POSES:
            normal = outwards(st.pose, pose_now(st), w, normal)
        overlap = st.touch[n, K_OVERLAP]
        branch = normal * (overlap - radius)
        u = load(st.grains, i, U)
        v = load(st.grains, i, V)
        if MOVING:
            surface = wall_velocity(p.wall_motion, w, x + branch)
            u = u - surface
            v = v - surface
            if POSES:
                u = u - part_velocity(st.pose, pose_now(st), w, x + branch)
                v = v - part_velocity_before(st.pose, pose_now(st), w, x + branch, p.dt, st.count[STEP])
        older = st.touch[n, K_OLDER] if FRICTION else wide(0.0)
        row = base + int64(st.touch[n, K_SPRING]) if FRICTION else base
        spring = spring_at(st.wall_spring, row, older)
        if POSES:
            spring = spring_outwards(st.pose, pose_now(st), w, spring)
        force, _, _ = sphere_on_wall(
            reals(row_of(p.wall_c, w * KINDS + kind_of(st.body, i))),
            real(radius), real(mass_of(st.body, i, p.mass)), real(overlap), narrow(normal),
            narrow(u), narrow(v), narrow(load(st.grains, i, W)), spin,
            spring, real(0.5) * dt * (real(1.0) + real(older)),
            rolling_rate(real(inertia_of(st.body, i, p.inertia)), real(p.dt)),
        )  # fmt: skip
        write_row(out, rows, st.ids[i], -1, w, force, branch)
        rows += 1
    return rows
