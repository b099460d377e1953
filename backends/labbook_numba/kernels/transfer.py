"""Between grains and the block of contacts, eight at a time: gather before the law, scatter after it; near contacts
are squeezed to those that touch. And one grain or contact at a time.

Which grains are in the block stands in `i` and `j`, which list entries in `slot`; both are filled up to a
multiple of eight with ghosts.
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
from labbook_numba.squeeze import exchange, squeeze, squeeze_places


@kernel
def fill_up(i, j, slot, count, ghost, spare):
    """Put the row `ghost` and the list entry `spare` behind the `count` contacts of the block."""
    for t in range(count, count + uint64(8)):
        i[t] = ghost
        j[t] = ghost
        slot[t] = spare


@func
def put_vectors(b, place, x, y, z):
    """Write the columns of eight vectors."""
    put(b, place, x)
    put(b, place + STRIDE, y)
    put(b, place + STRIDE + STRIDE, z)


@kernel
def gather_pairs(g, i, j, b, count):
    """Velocities of i relative to j, predicted and half a step old, and both spins, of rods predicted too.

    All is read before anything is written: the compiler then looks up the eight places once.
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
    """Velocities relative to the wall, predicted and half a step old, and spins.

    of_mesh: the velocity of the wall half a step before stands in VX.., where parts may move; else it is that of now.
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
    """Springs, and by how much to advance them: those of new contacts are zero, and advance by half a step."""
    for t in range(uint64(0), count, uint64(8)):
        held = eight_at(b, HELD + t)
        x, y, z, _ = columns(rows_at(spring, slot, t, SPRING, uint64(0)))
        put(b, SX + t, x * held)
        put(b, SY + t, y * held)
        put(b, SZ + t, z * held)
        if ROLLING_SPRING:
            gx, gy, gz, _ = columns(rows_at(spring, slot, t, SPRING, ROLL))
            put_vectors(b, GX + t, gx * held, gy * held, gz * held)
        put(b, DT + t, held * half_dt + spread(half_dt))


@kernel
def scatter_forces(loads, i, j, b, count, pairs):
    """Add forces and torques to the grains, to j only if these are `pairs`.

    Those on j come first: a list that ascends in i then j names a grain as j before it names it as i, so that the
    order of the sum is that of the list, wherever the groups of eight begin.
    """
    nothing = spread(0.0)
    for t in range(uint64(0), count, uint64(8)):
        force = rows(eight_at(b, UX + t), eight_at(b, UY + t), eight_at(b, UZ + t), nothing)
        if FRICTION or ORIENTED:
            torque = rows(eight_at(b, AX + t), eight_at(b, AY + t), eight_at(b, AZ + t), nothing)
            if pairs:
                torque_j = rows(eight_at(b, BX + t), eight_at(b, BY + t), eight_at(b, BZ + t), nothing)
                add_two_rows(loads, j, t, LOAD, F, -force, T, torque_j)
            add_two_rows(loads, i, t, LOAD, F, force, T, torque)
        else:
            if pairs:
                add_rows(loads, j, t, LOAD, F, -force)
            add_rows(loads, i, t, LOAD, F, force)


@kernel
def scatter_springs(spring, slot, b, count):
    """Keep the springs."""
    nothing = spread(0.0)
    for t in range(uint64(0), count, uint64(8)):
        kept = rows(eight_at(b, SX + t), eight_at(b, SY + t), eight_at(b, SZ + t), nothing)
        put_rows(spring, slot, t, SPRING, uint64(0), kept)
        if ROLLING_SPRING:
            kept = rows(eight_at(b, GX + t), eight_at(b, GY + t), eight_at(b, GZ + t), nothing)
            put_rows(spring, slot, t, SPRING, ROLL, kept)


@func
def eights_at(near, place):
    """Eight vectors, from columns of State.near."""
    return eight_at(near, place), eight_at(near, place + STRIDE), eight_at(near, place + STRIDE + STRIDE)


@func
def squeeze_vectors(b, place, vectors, touching):
    """Write the picked of eight vectors to columns of the block."""
    x, y, z = vectors
    squeeze(b, place, x, touching)
    squeeze(b, place + STRIDE, y, touching)
    squeeze(b, place + STRIDE + STRIDE, z, touching)


@func
def squeeze_entries(b, slot, count, depth, held, k, touching, here):
    """Write `depth` of the picked of the list entries k..k + 8, whether they hold springs, and which entries they are.

    depth: what goes to DEPTH.

    From now on those that touch hold one; `here`: those of the eight that are in the list.
    """
    squeeze(b, DEPTH + count, depth, touching)
    if FRICTION:
        squeeze(b, HELD + count, exchange(held, k, touching, here), touching)
        squeeze_places(slot, count, k, touching)


@func
def load(a, i, c):
    """The vector that starts at column c of row i."""
    return wide3(a[i, c], a[i, c + 1], a[i, c + 2])


@func
def spring_of(spring, held, k):
    """The spring of entry k; none if it is not held."""
    return spring_at(spring, k, wide(held[k]))


@func
def spring_at(spring, row, kept):
    """The spring in a row; none if `kept` is 0 and not 1."""
    return narrow(wide3(spring[row, 0] * kept, spring[row, 1] * kept, spring[row, 2] * kept))


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
