"""Between grains and the block of contacts, eight at a time: gather before the law, scatter after it.

Which grains are in the block stands in `i` and `j`, which list entries in `slot`; both are filled up to a
multiple of eight with ghosts.
"""

from labbook_numba.kernels.blocks import (
    AX,
    AY,
    AZ,
    BX,
    BY,
    BZ,
    DT,
    HELD,
    SX,
    SY,
    SZ,
    UX,
    UY,
    UZ,
    VX,
    VY,
    VZ,
)
from labbook_numba.kernels.features import (
    FRICTION,
    GRAIN,
    LOAD,
    SPRING,
    F,
    T,
    U,
    V,
    W,
    kernel,
    uint64,
)
from labbook_numba.lanes import eight_at, put, spread
from labbook_numba.rows import add_rows, columns, put_rows, rows, rows_at


@kernel
def fill_up(i, j, slot, count, ghost, spare):
    """Put the row `ghost` and the list entry `spare` behind the `count` contacts of the block."""
    for t in range(count, count + uint64(8)):
        i[t] = ghost
        j[t] = ghost
        slot[t] = spare


@kernel
def gather_pairs(g, i, j, b, count):
    """Velocities of i relative to j, predicted and half a step old, and both spins."""
    for t in range(uint64(0), count, uint64(8)):
        x, y, z, _ = columns(rows_at(g, i, t, GRAIN, U) - rows_at(g, j, t, GRAIN, U))
        put(b, UX + t, x)
        put(b, UY + t, y)
        put(b, UZ + t, z)
        if FRICTION:
            x, y, z, _ = columns(rows_at(g, i, t, GRAIN, V) - rows_at(g, j, t, GRAIN, V))
            put(b, VX + t, x)
            put(b, VY + t, y)
            put(b, VZ + t, z)
            x, y, z, _ = columns(rows_at(g, i, t, GRAIN, W))
            put(b, AX + t, x)
            put(b, AY + t, y)
            put(b, AZ + t, z)
            x, y, z, _ = columns(rows_at(g, j, t, GRAIN, W))
            put(b, BX + t, x)
            put(b, BY + t, y)
            put(b, BZ + t, z)


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
        if pairs:
            add_rows(loads, j, t, LOAD, F, -force)
        add_rows(loads, i, t, LOAD, F, force)
        if FRICTION:
            if pairs:
                torque = rows(eight_at(b, BX + t), eight_at(b, BY + t), eight_at(b, BZ + t), nothing)
                add_rows(loads, j, t, LOAD, T, torque)
            torque = rows(eight_at(b, AX + t), eight_at(b, AY + t), eight_at(b, AZ + t), nothing)
            add_rows(loads, i, t, LOAD, T, torque)


@kernel
def scatter_springs(spring, slot, b, count):
    """Keep the springs."""
    nothing = spread(0.0)
    for t in range(uint64(0), count, uint64(8)):
        kept = rows(eight_at(b, SX + t), eight_at(b, SY + t), eight_at(b, SZ + t), nothing)
        put_rows(spring, slot, t, kept)
