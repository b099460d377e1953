"""Pairs of spheres: selection of touching pairs, and their forces."""

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
from labbook_numba.kernels.branches import eight_branches
from labbook_numba.kernels.features import kernel, uint64
from labbook_numba.kernels.transfer import squeeze_entries, squeeze_vectors
from labbook_numba.squeeze import both, first_of, how_many, positive, squeeze_numbers


@kernel
def pack_pairs(
    grains, body, near, pair_i, pair_j, has_spring, b, block_i, block_j, slot, first, last, half, reach2, period
):
    """Copy the touching ones of the listed pairs first..last into the block; return their number.

    Branch and overlap2 ((r_i + r_j)^2 - r^2) go to columns, grains to `block_i` and `block_j`, list entries to `slot`.
    overlap2 is a small difference of large squares: it is computed in double, whatever the precision of the block.
    """
    count = uint64(0)
    for k in range(first, last, uint64(8)):
        x, y, z = eight_branches(grains, pair_i, pair_j, k, period)
        overlap2 = eight_reaches(body, pair_i, pair_j, k, reach2) - (x * x + y * y + z * z)
        in_list = first_of(last - k)
        # squares are compared: most listed pairs do not touch, and need no square root
        touching = both(positive(overlap2), in_list)
        squeeze_vectors(b, NX + count, (x, y, z), touching)
        squeeze_entries(b, slot, count, overlap2, has_spring, k, touching, in_list)
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
    force, torque, torque_j, spring, delta = sphere_on_sphere(
        coefficients_at(b, t, c), ri, rj, mi, mj, vector_at(b, NX + t), b[DEPTH + t], vector_at(b, UX + t),
        vector_at(b, VX + t), vector_at(b, AX + t), vector_at(b, BX + t), vector_at(b, SX + t), b[DT + t],
        rate_i, rate_j,
    )  # fmt: skip
    if ROLLING_SPRING:
        rolling, rolling_torque = rolling_on_sphere(
            coefficients_at(b, t, c), ri, rj, mi, mj, vector_at(b, NX + t), delta, force, vector_at(b, AX + t),
            vector_at(b, BX + t), vector_at(b, GX + t), b[DT + t], stiffness, damping,
        )  # fmt: skip
        torque = torque + rolling
        torque_j = torque_j - rolling
        put_vector(b, GX + t, rolling_torque)
    return force, torque, torque_j, spring, delta
