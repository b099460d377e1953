"""Block of contacts for a law: columns of one small buffer, so that the law runs in SIMD registers.

Contacts pass three stages: *gather* copies the inputs of BLOCK contacts into columns, *law* runs over the columns
without a branch or an indirect address, *scatter* adds the results to the grains. Three things silently prevent the
vectorisation of the law loop: signed indices (hence uint64 throughout), columns in separate arrays or at offsets
unknown to the compiler (hence one buffer, constant offsets), and a law that is not inlined.
"""

from labbook_dem.words import FRICTION, func, real, vec3, wide

from labbook_numba.kernels.features import COEFFICIENTS, KINDS, LANES, ORIENTED, STRIDE, kernel, uint64
from labbook_numba.state import MIXTURES, SPHERES
from labbook_numba.state import RODS as LAYOUT_OF_RODS

# columns. Input: normal or branch, DEPTH, velocity predicted and half a step old, spins of i and j, spring and the time
# to advance it by. Output, over velocities, spins and spring: force, torques on i and on j, spring. DEPTH is the
# overlap [m], but for two grains before the law stage `overlap2` [m^2], as `sphere_on_sphere` and `rod_on_rod` take it
(NX, NY, NZ, DEPTH, UX, UY, UZ, VX, VY, VZ, AX, AY, AZ, BX, BY, BZ, SX, SY, SZ, DT, SPARE) = (
    uint64(column * STRIDE) for column in range(SPHERES.BLOCK_COLUMNS)
)
# for mixtures: radius, mass and moment of inertia of i and j; coefficients from C0 on
(RI, RJ, MI, MJ, TI, TJ, C0) = (
    uint64(column * STRIDE) for column in range(SPHERES.BLOCK_COLUMNS, MIXTURES.BLOCK_COLUMNS - COEFFICIENTS + 1)
)
# for rods: levers of i and j, predicted spins of i and j
(IX, IY, IZ, JX, JY, JZ, PX, PY, PZ, OX, OY, OZ) = (
    uint64(column * STRIDE) for column in range(SPHERES.BLOCK_COLUMNS, LAYOUT_OF_RODS.BLOCK_COLUMNS)
)
# torques of rolling springs, input and output: behind all other columns
GX, GY, GZ = (uint64(column * STRIDE) for column in range(MIXTURES.BLOCK_COLUMNS, MIXTURES.BLOCK_COLUMNS + 3))
HELD = DT  # 1 for a contact with a spring, else 0; `gather_springs` replaces it by the time


@func
def whole(count):
    """Places to compute for `count` contacts: full registers, so that every contact takes the same instructions."""
    return (uint64(count) + LANES - uint64(1)) // LANES * LANES


@func
def row_of(table, k):
    """Coefficients in row k of a table, as a tuple."""
    return (
        table[k, 0], table[k, 1], table[k, 2], table[k, 3], table[k, 4], table[k, 5], table[k, 6], table[k, 7],
    )  # fmt: skip


@func
def reals(c):
    """Coefficients in the precision of laws."""
    return (real(c[0]), real(c[1]), real(c[2]), real(c[3]), real(c[4]), real(c[5]), real(c[6]), real(c[7]))


@func
def coefficients_at(b, t, c):
    """Coefficients of contact t; c if there is one species."""
    if KINDS > 1:
        d = C0 + t
        return (
            b[d], b[d + STRIDE], b[d + uint64(2) * STRIDE], b[d + uint64(3) * STRIDE], b[d + uint64(4) * STRIDE],
            b[d + uint64(5) * STRIDE], b[d + uint64(6) * STRIDE], b[d + uint64(7) * STRIDE],
        )  # fmt: skip
    return c


@func
def vector_at(b, element):
    """Load a vector of a contact from three columns."""
    return vec3(b[element], b[element + STRIDE], b[element + STRIDE + STRIDE])


@func
def put_vector(b, element, v):
    """Store a vector of a contact in three columns."""
    b[element] = v.x
    b[element + STRIDE] = v.y
    b[element + STRIDE + STRIDE] = v.z


@func
def put_forces(b, t, force, torque, spring):
    """Store the results of contact t over its velocities, spins and spring."""
    put_vector(b, UX + t, force)
    if FRICTION or ORIENTED:
        put_vector(b, AX + t, torque)
    if FRICTION:
        put_vector(b, SX + t, spring)


@kernel
def largest_depth(b, bits, count):
    """Largest of DEPTH, zero if none is positive.

    Positive floats sort like the integers of their bits, and a maximum of integers vectorises.
    """
    largest = bits[DEPTH] - bits[DEPTH]
    for t in range(uint64(count)):
        largest = max(largest, bits[DEPTH + t])
    bits[SPARE] = largest
    return wide(b[SPARE])


@kernel
def where_depth(b, count, value):
    """Place of the first DEPTH that is not below `value`."""
    for t in range(uint64(count)):
        if not b[DEPTH + t] < value:
            return t
    return uint64(0)
