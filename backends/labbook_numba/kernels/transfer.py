"""Between grains and the block of contacts, eight at a time: gather before the law, scatter after it.

Which grains are in the block stands in `i` and `j`, which list entries in `slot`; both are filled up to a
multiple of eight with ghosts.
"""

from labbook_dem.words import func

from labbook_numba.kernels.blocks import (
    AX,
    AY,
    AZ,
    BX,
    BY,
    BZ,
    DT,
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
    RODS,
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
        if RODS:
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
        if RODS:
            put_vectors(b, PX + t, px, py, pz)
            put_vectors(b, OX + t, ox, oy, oz)


@kernel
def gather_grains(g, i, b, count):
    """Velocities relative to the wall, predicted and half a step old, and spins."""
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
        if FRICTION or RODS:
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
        put_rows(spring, slot, t, kept)
