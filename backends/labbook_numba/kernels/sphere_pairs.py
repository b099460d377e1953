"""Pairs of spheres: which touch, and what acts on them."""

from labbook_dem.contact import rolling_rate
from labbook_dem.spheres import rolling_on_sphere, sphere_on_sphere
from labbook_dem.words import ROLLING_SPRING, VARIED, func

from labbook_numba.kernels.blocks import (
    AX,
    BX,
    DEPTH,
    DT,
    GX,
    MI,
    MJ,
    NX,
    RI,
    RJ,
    SX,
    TI,
    TJ,
    UX,
    VX,
    coefficients_at,
    put_vector,
    vector_at,
)
from labbook_numba.kernels.bodies import eight_reaches
from labbook_numba.kernels.features import GRAIN, X, kernel, uint64
from labbook_numba.kernels.transfer import squeeze_entries, squeeze_vectors
from labbook_numba.rows import columns, rows_at
from labbook_numba.squeeze import both, first_of, how_many, positive, squeeze_numbers


@kernel
def pack_pairs(grains, body, near, pair_i, pair_j, held, b, block_i, block_j, slot, first, last, half, reach2):
    """Bring those of the listed pairs first..last that touch into the block; how many they are.

    Branch and overlap2 ((r_i + r_j)^2 - r^2) go to columns, grains to `block_i` and `block_j`, list entries to `slot`.
    overlap2 is a small difference: it is taken in double, whatever the block holds.
    """
    count = uint64(0)
    for k in range(first, last, uint64(8)):
        x, y, z, _ = columns(rows_at(grains, pair_i, k, GRAIN, X) - rows_at(grains, pair_j, k, GRAIN, X))
        overlap2 = eight_reaches(body, pair_i, pair_j, k, reach2) - (x * x + y * y + z * z)
        here = first_of(last - k)
        touching = both(positive(overlap2), here)
        squeeze_vectors(b, NX + count, (x, y, z), touching)
        squeeze_entries(b, slot, count, overlap2, held, k, touching, here)
        squeeze_numbers(block_i, count, pair_i, k, touching)
        squeeze_numbers(block_j, count, pair_j, k, touching)
        count += how_many(touching)
    return count


@func
def pair_contact(b, t, c, radius, mass, rate, dt, stiffness, damping):
    """Force and torque on i, torque on j, spring and overlap [m] of contact t; see `pair_law`.

    stiffness, damping: of rolling springs, which are advanced in their columns.
    """
    ri = rj = radius
    mi = mj = mass
    rate_i = rate_j = rate
    if VARIED:
        ri, rj = b[RI + t], b[RJ + t]
        mi, mj = b[MI + t], b[MJ + t]
        rate_i, rate_j = rolling_rate(b[TI + t], dt), rolling_rate(b[TJ + t], dt)
    force, torque, other, kept, delta = sphere_on_sphere(
        coefficients_at(b, t, c), ri, rj, mi, mj, vector_at(b, NX + t), b[DEPTH + t], vector_at(b, UX + t),
        vector_at(b, VX + t), vector_at(b, AX + t), vector_at(b, BX + t), vector_at(b, SX + t), b[DT + t],
        rate_i, rate_j,
    )  # fmt: skip
    if ROLLING_SPRING:
        roll, turned = rolling_on_sphere(
            coefficients_at(b, t, c), ri, rj, mi, mj, vector_at(b, NX + t), delta, force, vector_at(b, AX + t),
            vector_at(b, BX + t), vector_at(b, GX + t), b[DT + t], stiffness, damping,
        )  # fmt: skip
        torque = torque + roll
        other = other - roll
        put_vector(b, GX + t, turned)
    return force, torque, other, kept, delta
