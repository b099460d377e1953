"""Transfer between grains and a block of contacts, eight at a time: gather before the law, scatter after it, and
compress near contacts to touching ones. Also loads and stores for one grain or contact.

`i` and `j` are the grains of a block, `slot` their list entries; all are padded by ghosts to a multiple of eight.
"""

from labbook_dem.words import ROLLING_SPRING, func, narrow, real, wide, wide3

from labbook_numba.kernels.blocks import (
    AX,
    AY,
    AZ,
    BX,
    BY,
    BZ,
    DEPTH,
    DT,
    GX,
    GY,
    GZ,
    HELD,
    OX,
    PX,
    SX,
    SY,
    SZ,
    UX,
    UY,
    UZ,
    VX,
)
from labbook_numba.kernels.features import (
    FRICTION,
    GRAIN,
    LOAD,
    MOVING,
    ORIENTED,
    POSES,
    ROLL,
    SPRING,
    STRIDE,
    F,
    P,
    T,
    U,
    V,
    W,
    kernel,
    uint64,
)
from labbook_numba.lanes import eight_at, put, spread
from labbook_numba.rows import add_rows, add_two_rows, columns, put_rows, rows, rows_at
from labbook_numba.squeeze import exchange, squeeze, squeeze_indices


@kernel
def fill_up(i, j, slot, count, ghost, spare):
    """Pad the `count` contacts of the block by the row `ghost` and the list entry `spare`."""
    # whole registers without a shorter last pass: results of the padding go to the row of a ghost, which nothing reads
    for t in range(count, count + uint64(8)):
        i[t] = ghost
        j[t] = ghost
        slot[t] = spare


@func
def put_vectors(b, element, x, y, z):
    """Store eight vectors in three columns."""
    put(b, element, x)
    put(b, element + STRIDE, y)
    put(b, element + STRIDE + STRIDE, z)


@kernel
def gather_pairs(g, i, j, b, count):
    """Copy velocities of i relative to j, predicted and half a step old, and both spins, of rods also the predicted
    ones.

    All loads precede the stores: the compiler then computes the eight addresses once.
    """
    for t in range(uint64(0), count, uint64(8)):
        ux, uy, uz, _ = columns(rows_at(g, i, t, GRAIN, U) - rows_at(g, j, t, GRAIN, U))
        if ORIENTED:
            px, py, pz, _ = columns(rows_at(g, i, t, GRAIN, P))
            ox, oy, oz, _ = columns(rows_at(g, j, t, GRAIN, P))
        if FRICTION:
            vx, vy, vz, _ = columns(rows_at(g, i, t, GRAIN, V) - rows_at(g, j, t, GRAIN, V))
            ax, ay, az, _ = columns(rows_at(g, i, t, GRAIN, W))
            bx, by, bz, _ = columns(rows_at(g, j, t, GRAIN, W))
            put_vectors(b, VX + t, vx, vy, vz)
            put_vectors(b, AX + t, ax, ay, az)
            put_vectors(b, BX + t, bx, by, bz)
        put_vectors(b, UX + t, ux, uy, uz)
        if ORIENTED:
            put_vectors(b, PX + t, px, py, pz)
            put_vectors(b, OX + t, ox, oy, oz)


@kernel
def gather_grains(g, i, b, count, of_mesh):
    """Copy velocities relative to the wall, predicted and half a step old, and spins.

    of_mesh: VX.. has the velocity of the wall half a step before, if parts move; else the present one serves for both.
    """
    for t in range(uint64(0), count, uint64(8)):
        ux, uy, uz, _ = columns(rows_at(g, i, t, GRAIN, U))
        if FRICTION:
            vx, vy, vz, _ = columns(rows_at(g, i, t, GRAIN, V))
            wx, wy, wz, _ = columns(rows_at(g, i, t, GRAIN, W))
        if MOVING:
            x = eight_at(b, UX + t)
            y = eight_at(b, UY + t)
            z = eight_at(b, UZ + t)
            ux, uy, uz = ux - x, uy - y, uz - z
            if FRICTION:
                if POSES:  # noqa: SIM102 - compiled code leaves out what one constant decides
                    if of_mesh:
                        x = eight_at(b, VX + t)
                        y = eight_at(b, VX + t + STRIDE)
                        z = eight_at(b, VX + t + STRIDE + STRIDE)
                vx, vy, vz = vx - x, vy - y, vz - z
        if FRICTION:
            put_vectors(b, VX + t, vx, vy, vz)
            put_vectors(b, AX + t, wx, wy, wz)
        put_vectors(b, UX + t, ux, uy, uz)


@kernel
def gather_springs(spring, slot, b, count, half_dt):
    """Copy springs and the time to advance them by: those of new contacts are zero, and advance by half a step."""
    for t in range(uint64(0), count, uint64(8)):
        # a factor of 0 or 1 instead of a branch, which would keep the loop out of SIMD registers
        has_spring = eight_at(b, HELD + t)
        x, y, z, _ = columns(rows_at(spring, slot, t, SPRING, uint64(0)))
        put(b, SX + t, x * has_spring)
        put(b, SY + t, y * has_spring)
        put(b, SZ + t, z * has_spring)
        if ROLLING_SPRING:
            gx, gy, gz, _ = columns(rows_at(spring, slot, t, SPRING, ROLL))
            put_vectors(b, GX + t, gx * has_spring, gy * has_spring, gz * has_spring)
        # a new contact began within the last step, on average half a step ago
        put(b, DT + t, has_spring * half_dt + spread(half_dt))


@kernel
def scatter_forces(loads, i, j, b, count, pairs):
    """Add forces and torques to the grains, to j only for `pairs`.

    Those on j come first. A list that ascends in i, then j, has a grain as j before it has it as i. So the order of
    each sum is that of the list, wherever the groups of eight begin.
    """
    zero = spread(0.0)
    for t in range(uint64(0), count, uint64(8)):
        force = rows(eight_at(b, UX + t), eight_at(b, UY + t), eight_at(b, UZ + t), zero)
        if FRICTION or ORIENTED:
            torque = rows(eight_at(b, AX + t), eight_at(b, AY + t), eight_at(b, AZ + t), zero)
            if pairs:
                torque_j = rows(eight_at(b, BX + t), eight_at(b, BY + t), eight_at(b, BZ + t), zero)
                add_two_rows(loads, j, t, LOAD, F, -force, T, torque_j)
            add_two_rows(loads, i, t, LOAD, F, force, T, torque)
        else:
            if pairs:
                add_rows(loads, j, t, LOAD, F, -force)
            add_rows(loads, i, t, LOAD, F, force)


@kernel
def scatter_springs(spring, slot, b, count):
    """Store the springs of the block in the list."""
    zero = spread(0.0)
    for t in range(uint64(0), count, uint64(8)):
        spring_rows = rows(eight_at(b, SX + t), eight_at(b, SY + t), eight_at(b, SZ + t), zero)
        put_rows(spring, slot, t, SPRING, uint64(0), spring_rows)
        if ROLLING_SPRING:
            spring_rows = rows(eight_at(b, GX + t), eight_at(b, GY + t), eight_at(b, GZ + t), zero)
            put_rows(spring, slot, t, SPRING, ROLL, spring_rows)


@func
def eights_at(near, element):
    """Load eight vectors from columns of State.near."""
    return eight_at(near, element), eight_at(near, element + STRIDE), eight_at(near, element + STRIDE + STRIDE)


@func
def squeeze_vectors(b, element, vectors, touching):
    """Store the touching ones of eight vectors in columns of the block."""
    x, y, z = vectors
    squeeze(b, element, x, touching)
    squeeze(b, element + STRIDE, y, touching)
    squeeze(b, element + STRIDE + STRIDE, z, touching)


@func
def squeeze_entries(b, slot, count, depth, has_spring, k, touching, in_list):
    """Store `depth`, flag of a spring and index of those list entries k..k + 8 that touch.

    depth: values of DEPTH; in_list: mask of the eight that are in the list. Entries that touch have a spring from now
    on, the others have none.
    """
    squeeze(b, DEPTH + count, depth, touching)
    if FRICTION:
        squeeze(b, HELD + count, exchange(has_spring, k, touching, in_list), touching)
        squeeze_indices(slot, count, k, touching)


@func
def load(a, i, c):
    """Load the vector that starts at column c of row i."""
    return wide3(a[i, c], a[i, c + 1], a[i, c + 2])


@func
def store(a, i, c, vector):
    """Store a vector in row i from column c on."""
    a[i, c] = vector.x
    a[i, c + 1] = vector.y
    a[i, c + 2] = vector.z


@func
def spring_of(spring, held, k):
    """Spring of entry k; zero if it is not valid."""
    return spring_at(spring, k, wide(held[k]))


@func
def spring_at(spring, row, factor):
    """Spring in a row times a factor of 0 or 1."""
    return narrow(wide3(spring[row, 0] * factor, spring[row, 1] * factor, spring[row, 2] * factor))


@func
def advance_of(held, k, dt):
    """Time [s] to advance the spring of entry k by."""
    return real(0.5) * dt * (real(1.0) + real(held[k]))


@kernel
def write_row(out, row, i, j, wall, force, branch):
    """Write one row of contacts."""
    out[row, 0] = i
    out[row, 1] = j
    out[row, 2] = wall
    out[row, 3] = force.x
    out[row, 4] = force.y
    out[row, 5] = force.z
    out[row, 6] = branch.x
    out[row, 7] = branch.y
    out[row, 8] = branch.z
