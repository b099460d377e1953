"""Forces of walls on spheres, wall by wall, a block at a time: measure, pack, gather, law, scatter."""

from labbook_dem.chosen import wall_distance
from labbook_dem.contact import rolling_rate
from labbook_dem.poses import part_spin
from labbook_dem.spheres import rolling_on_wall, sphere_on_wall
from labbook_dem.words import ROLLING_SPRING, VARIED, real, vec3, wide, wide3

from labbook_numba.kernels.blocks import (
    AX,
    DEPTH,
    DT,
    GX,
    MI,
    NX,
    RI,
    SX,
    TI,
    UX,
    VX,
    coefficients_at,
    largest_depth,
    put_forces,
    put_vector,
    reals,
    row_of,
    vector_at,
    where_depth,
    whole,
)
from labbook_numba.kernels.bodies import gather_bodies, gather_coefficients, radius_of
from labbook_numba.kernels.features import (
    BLOCK,
    FAIL_GRAIN,
    FRICTION,
    GHOSTS,
    GRAIN,
    KINDS,
    LEDGER,
    MAX_OVERLAP,
    MESH_NUMBER,
    MESHES,
    MOVING,
    POSES,
    STRIDE,
    TOUCHING,
    WALL_PARTS,
    X,
    int64,
    kernel,
    uint64,
)
from labbook_numba.kernels.mesh_walls import key_springs, pack_mesh
from labbook_numba.kernels.poses import pose_now, springs_inwards, springs_outwards
from labbook_numba.kernels.surfaces import near_here, wall_numbers, wall_velocity
from labbook_numba.kernels.transfer import (
    eights_at,
    fill_up,
    gather_grains,
    gather_springs,
    put_vectors,
    scatter_forces,
    scatter_springs,
    squeeze_entries,
    squeeze_vectors,
)
from labbook_numba.lanes import eight_at
from labbook_numba.rows import columns, rows_at
from labbook_numba.squeeze import both, first_of, how_many, positive, squeeze_numbers
from labbook_numba.state import SPHERES, Params, State

# columns of State.near: position, which becomes the unit normal; overlap; velocity of the surface
XX, XY, XZ, NEAR_OVERLAP, QX, QY, QZ = (uint64(column * STRIDE) for column in range(SPHERES.NEAR_COLUMNS))


@kernel
def measure_walls(grains, body, wall_grain, near, walls, kind, motion, w, k, count, radius):
    """Normal, overlap and surface velocity of wall w for its near grains k..k + count, touching or not."""
    for t in range(uint64(0), count, uint64(8)):
        x, y, z, _ = columns(rows_at(grains, wall_grain, k + t, GRAIN, X))
        put_vectors(near, XX + t, x, y, z)
    # positions are in columns now, so that the distances are computed without an indirect address
    numbers = wall_numbers(walls, w)
    for t in range(whole(count)):
        x = wide3(near[XX + t], near[XY + t], near[XZ + t])
        distance, normal = wall_distance(numbers, w, kind[w], x)
        if MOVING:
            surface = wall_velocity(motion, w, x - normal * distance)
            near[QX + t] = surface.x
            near[QY + t] = surface.y
            near[QZ + t] = surface.z
        near[XX + t] = normal.x
        near[XY + t] = normal.y
        near[XZ + t] = normal.z
        near[NEAR_OVERLAP + t] = radius_of(body, wall_grain[k + t], radius) - distance


@kernel
def pack_walls(near, wall_grain, held, b, i, slot, k, near_count):
    """Copy the touching ones of the measured near grains into the block; return their number."""
    count = uint64(0)
    for t in range(uint64(0), near_count, uint64(8)):
        overlap = eight_at(near, NEAR_OVERLAP + t)
        here = first_of(near_count - t)
        touching = both(positive(overlap), here)
        squeeze_vectors(b, NX + count, eights_at(near, XX + t), touching)
        if MOVING:
            squeeze_vectors(b, UX + count, eights_at(near, QX + t), touching)
        squeeze_entries(b, slot, count, overlap, held, k + t, touching, here)
        squeeze_numbers(i, count, wall_grain, k + t, touching)
        count += how_many(touching)
    return count


@kernel
def wall_law(b, count, coefficients, radius, mass, inertia, dt, spin, stiffness, damping):
    """Law stage of grain on wall. Unit normal in NX.., overlap in DEPTH; the wall turns with `spin` [rad/s].

    radius, mass, inertia: of all grains, if they are the same. dt: step [s]. stiffness, damping: of rolling springs.
    """
    c = reals(coefficients)
    rate = rolling_rate(inertia, dt)
    for t in range(whole(count)):
        if VARIED:
            radius, mass, rate = b[RI + t], b[MI + t], rolling_rate(b[TI + t], dt)
        force, torque, kept = sphere_on_wall(
            coefficients_at(b, t, c), radius, mass, b[DEPTH + t], vector_at(b, NX + t), vector_at(b, UX + t),
            vector_at(b, VX + t), vector_at(b, AX + t), spin, vector_at(b, SX + t), b[DT + t], rate,
        )  # fmt: skip
        if ROLLING_SPRING:
            roll, turned = rolling_on_wall(
                coefficients_at(b, t, c), radius, mass, b[DEPTH + t], vector_at(b, NX + t), force, vector_at(b, AX + t),
                spin, vector_at(b, GX + t), b[DT + t], stiffness, damping,
            )  # fmt: skip
            torque = torque + roll
            put_vector(b, GX + t, turned)
        put_forces(b, t, force, torque, kept)


@kernel
def wall_forces(st: State, p: Params):
    """Add the forces of walls on spheres to loads; continues the totals of `pair_forces`."""
    b = st.block
    i = st.block_i
    slot = st.slot
    half_dt = wide(0.5) * p.dt
    ghost = len(st.grains) - GHOSTS
    spare = len(st.wall_spring) - 1
    touching = uint64(0)
    deepest = st.sums[MAX_OVERLAP]
    a = p.wall_c
    for w in range(uint64(len(p.wall_kind))):
        c = row_of(a, w)
        spin = vec3(real(0.0), real(0.0), real(p.wall_motion[w, 3]))
        if POSES:
            spin = spin + part_spin(st.pose, pose_now(st), w)
        start, end = near_here(st.domain, st.wall_grain, st.wall_first[w], st.wall_first[w + uint64(1)])
        last = uint64(end)
        k = uint64(start)
        while k < last:
            count = uint64(0)
            a_mesh = False
            if MESHES:
                a_mesh = p.wall_kind[w] == MESH_NUMBER
                if a_mesh:
                    count, k = pack_mesh(st, p, w, k, last, b, i, slot)
            if not a_mesh:
                near = min(last - k, BLOCK)
                measure_walls(
                    st.grains, st.body, st.wall_grain, st.near, p.walls, p.wall_kind, p.wall_motion, w, k, near,
                    p.radius,
                )  # fmt: skip
                count = pack_walls(st.near, st.wall_grain, st.wall_held, b, i, slot, k, near)
                if MESHES:  # which let each entry have several springs
                    for t in range(count):
                        slot[t] = slot[t] * int64(WALL_PARTS)
                k += BLOCK
            fill_up(i, st.block_j, slot, count, ghost, spare)
            gather_grains(st.grains, i, b, count, a_mesh)
            if FRICTION:
                gather_springs(st.wall_spring, slot, b, count, half_dt)
                if POSES:  # noqa: SIM102 - compiled code leaves out what one constant decides
                    if a_mesh:
                        springs_outwards(b, st.pose, pose_now(st), w, count)
            if VARIED:
                gather_bodies(st.body, i, i, b, count, False)
                if KINDS > 1:
                    gather_coefficients(a, int64(w) * int64(KINDS), st.body, i, i, b, count, False)
            wall_law(
                b, count, c, real(p.radius), real(p.mass), real(p.inertia), real(p.dt), spin, real(p.rolling_stiffness),
                real(p.rolling_damping),
            )  # fmt: skip
            scatter_forces(st.loads, i, st.block_j, b, count, False)
            if FRICTION:
                if POSES:  # noqa: SIM102 - compiled code leaves out what one constant decides
                    if a_mesh:
                        springs_inwards(b, st.pose, pose_now(st), w, count)
                scatter_springs(st.wall_spring, slot, b, count)
                if MESHES:  # noqa: SIM102 - compiled code leaves out what one constant decides
                    if a_mesh:
                        key_springs(st, slot, count)
            touching += count
            overlap = largest_depth(b, st.bits, count)
            # so written that NaN counts as the largest overlap, and reaches the guard
            if not overlap <= deepest:
                deepest = overlap
                if not deepest <= p.overlap_limit:
                    st.count[FAIL_GRAIN] = st.ids[i[where_depth(b, count, overlap)]]
    st.sums[MAX_OVERLAP] = deepest
    if LEDGER:
        st.count[TOUCHING] += touching
