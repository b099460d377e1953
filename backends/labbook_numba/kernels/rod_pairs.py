"""Pairs of rods: selection of touching pairs by closest points, and their forces.

Closest points are computed for 384 near pairs at a time, in columns of State.near, in double precision.
"""

from labbook_dem.rods import rod_on_rod
from labbook_dem.segments import closest
from labbook_dem.words import dot, func, wide, wide3

from labbook_numba.kernels.blocks import AX, BX, DEPTH, DT, IX, JX, NX, OX, PX, SX, UX, VX, vector_at, whole
from labbook_numba.kernels.branches import eight_branches
from labbook_numba.kernels.features import GRAIN, STRIDE, A, kernel, uint64
from labbook_numba.kernels.transfer import eights_at, put_vectors, squeeze_entries, squeeze_vectors
from labbook_numba.lanes import eight_at
from labbook_numba.rows import columns, rows_at
from labbook_numba.squeeze import both, first_of, how_many, positive, squeeze_numbers
from labbook_numba.state import RODS as LAYOUT

# columns of State.near: branch between centres, replaced by that between closest points; axes, replaced by levers;
# overlap2, as `rod_on_rod` takes it
(CX, CY, CZ, KX, KY, KZ, LX, LY, LZ, CLOSE) = (uint64(column * STRIDE) for column in range(LAYOUT.NEAR_COLUMNS))


@kernel
def gather_rods(grains, pair_i, pair_j, near, first, count, period):
    """Copy branches between centres and axes of the listed pairs first..first + count into columns, padded by
    ghosts."""
    for t in range(uint64(0), count, uint64(8)):
        k = first + t
        x, y, z = eight_branches(grains, pair_i, pair_j, k, period)
        put_vectors(near, CX + t, x, y, z)
        x, y, z, _ = columns(rows_at(grains, pair_i, k, GRAIN, A))
        put_vectors(near, KX + t, x, y, z)
        x, y, z, _ = columns(rows_at(grains, pair_j, k, GRAIN, A))
        put_vectors(near, LX + t, x, y, z)


@kernel
def closest_points(b, count, half, reach2):
    """Replace branches and axes of near pairs by branch, levers and overlap2 (diameter^2 - r^2) at their closest
    points."""
    # without a branch for pairs that do not touch: SIMD registers compute all pairs faster than a loop skips some
    for t in range(whole(count)):
        axis_i = wide3(b[KX + t], b[KY + t], b[KZ + t])
        axis_j = wide3(b[LX + t], b[LY + t], b[LZ + t])
        r, s, away = closest(wide3(b[CX + t], b[CY + t], b[CZ + t]), axis_i, axis_j, half)
        b[CX + t] = away.x
        b[CY + t] = away.y
        b[CZ + t] = away.z
        b[KX + t] = axis_i.x * r
        b[KY + t] = axis_i.y * r
        b[KZ + t] = axis_i.z * r
        b[LX + t] = axis_j.x * s
        b[LY + t] = axis_j.y * s
        b[LZ + t] = axis_j.z * s
        b[CLOSE + t] = wide(reach2) - dot(away, away)


@kernel
def pack_pairs(
    grains, body, near, pair_i, pair_j, has_spring, b, block_i, block_j, slot, first, last, half, reach2, period
):
    """Copy the touching ones of the listed pairs first..last into the block; return their number.

    Branches between closest points, overlap2 (diameter^2 - r^2) and levers go to columns, grains to `block_i` and
    `block_j`, list entries to `slot`.
    """
    near_count = last - first
    gather_rods(grains, pair_i, pair_j, near, first, near_count, period)
    closest_points(near, near_count, half, reach2)
    count = uint64(0)
    for t in range(uint64(0), near_count, uint64(8)):
        k = first + t
        overlap2 = eight_at(near, CLOSE + t)
        in_list = first_of(near_count - t)
        touching = both(positive(overlap2), in_list)
        squeeze_vectors(b, NX + count, eights_at(near, CX + t), touching)
        squeeze_vectors(b, IX + count, eights_at(near, KX + t), touching)
        squeeze_vectors(b, JX + count, eights_at(near, LX + t), touching)
        squeeze_entries(b, slot, count, overlap2, has_spring, k, touching, in_list)
        squeeze_numbers(block_i, count, pair_i, k, touching)
        squeeze_numbers(block_j, count, pair_j, k, touching)
        count += how_many(touching)
    return count


@func
def pair_contact(b, t, c, radius, mass, rate, dt, stiffness, damping):
    """Force and torque on i, torque on j, spring and overlap [m] of contact t; see `pair_law`."""
    return rod_on_rod(
        c, radius, mass, vector_at(b, NX + t), b[DEPTH + t], vector_at(b, IX + t), vector_at(b, JX + t),
        vector_at(b, UX + t), vector_at(b, VX + t), vector_at(b, PX + t), vector_at(b, OX + t), vector_at(b, AX + t),
        vector_at(b, BX + t), vector_at(b, SX + t), b[DT + t], rate,
    )  # fmt: skip
