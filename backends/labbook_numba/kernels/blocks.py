"""The block of contacts that a law works on: columns of one small buffer, so that the law runs in SIMD registers.

Contacts go through three stages: *gather* copies what the law needs of BLOCK contacts into columns, *law* runs over the
columns without a branch or an indirect address, *scatter* adds the results to the grains. Three things each silently
undo the vectorisation of the law loop: signed indices (hence uint64 throughout), columns in separate arrays or at
offsets unknown to the compiler (hence one buffer, constant offsets), and a law that is not inlined.
"""

from labbook_dem.contact import rolling_rate
from labbook_dem.spheres import sphere_on_sphere, sphere_on_wall
from labbook_dem.words import FRICTION, VARIED, func, real, vec3, wide

from labbook_numba.kernels.features import COEFFICIENTS, KINDS, LANES, STRIDE, kernel, uint64
from labbook_numba.state import MIXTURES, SPHERES

# columns; in: normal or branch, gap, velocity predicted and half a step old, spins of i and j, spring and its advance;
# out, in the places of the velocities, spins and spring: force, torque on i and on j, spring
(NX, NY, NZ, GAP, UX, UY, UZ, VX, VY, VZ, AX, AY, AZ, BX, BY, BZ, SX, SY, SZ, DT, SPARE) = (
    uint64(column * STRIDE) for column in range(SPHERES.BLOCK_COLUMNS)
)
# where grains differ: radius, mass and moment of inertia of i and j; and where kinds do, coefficients from C0 on
(RI, RJ, MI, MJ, TI, TJ, C0) = (
    uint64(column * STRIDE) for column in range(SPHERES.BLOCK_COLUMNS, MIXTURES.BLOCK_COLUMNS - COEFFICIENTS + 1)
)
HELD = DT  # 1 for a contact that has a spring; becomes DT


@func
def whole(count):
    """Places to compute for `count` contacts: full registers, so that every contact sees the same instructions."""
    return (uint64(count) + LANES - uint64(1)) // LANES * LANES


@func
def row_of(table, k):
    """Coefficients in row k of a table."""
    return (
        table[k, 0], table[k, 1], table[k, 2], table[k, 3], table[k, 4], table[k, 5], table[k, 6], table[k, 7],
    )  # fmt: skip


@func
def reals(c):
    """Coefficients in the precision of laws."""
    return (real(c[0]), real(c[1]), real(c[2]), real(c[3]), real(c[4]), real(c[5]), real(c[6]), real(c[7]))


@func
def coefficients_at(b, t, c):
    """Coefficients of contact t; c where there are no kinds."""
    if KINDS > 1:
        d = C0 + t
        return (
            b[d], b[d + STRIDE], b[d + uint64(2) * STRIDE], b[d + uint64(3) * STRIDE], b[d + uint64(4) * STRIDE],
            b[d + uint64(5) * STRIDE], b[d + uint64(6) * STRIDE], b[d + uint64(7) * STRIDE],
        )  # fmt: skip
    return c


@kernel
def pair_law(b, count, coefficients, radius, mass, inertia, dt):
    """Law stage of grain on grain. Branch in NX.., (r_i + r_j)^2 - r^2 in GAP; velocities relative, spins own.

    radius, mass, inertia: of all, if they are alike. dt: step [s].
    """
    c = reals(coefficients)
    rate = rolling_rate(inertia, dt)
    ri = rj = radius
    mi = mj = mass
    rate_i = rate_j = rate
    for t in range(whole(count)):
        if VARIED:
            ri, rj = b[RI + t], b[RJ + t]
            mi, mj = b[MI + t], b[MJ + t]
            rate_i, rate_j = rolling_rate(b[TI + t], dt), rolling_rate(b[TJ + t], dt)
        force, torque, other, kept, delta = sphere_on_sphere(
            coefficients_at(b, t, c), ri, rj, mi, mj, vec3(b[NX + t], b[NY + t], b[NZ + t]), b[GAP + t],
            vec3(b[UX + t], b[UY + t], b[UZ + t]), vec3(b[VX + t], b[VY + t], b[VZ + t]),
            vec3(b[AX + t], b[AY + t], b[AZ + t]), vec3(b[BX + t], b[BY + t], b[BZ + t]),
            vec3(b[SX + t], b[SY + t], b[SZ + t]), b[DT + t], rate_i, rate_j,
        )  # fmt: skip
        b[UX + t] = force.x
        b[UY + t] = force.y
        b[UZ + t] = force.z
        if FRICTION:
            b[AX + t] = torque.x
            b[AY + t] = torque.y
            b[AZ + t] = torque.z
            b[BX + t] = other.x
            b[BY + t] = other.y
            b[BZ + t] = other.z
            b[SX + t] = kept.x
            b[SY + t] = kept.y
            b[SZ + t] = kept.z
        b[GAP + t] = delta


@kernel
def wall_law(b, count, coefficients, radius, mass, inertia, dt, spin):
    """Law stage of grain on wall. Unit normal in NX.., overlap in GAP; the wall turns with `spin` [rad/s] about z.

    radius, mass, inertia: of all, if they are alike. dt: step [s].
    """
    c = reals(coefficients)
    rate = rolling_rate(inertia, dt)
    zero = real(0.0)
    for t in range(whole(count)):
        if VARIED:
            radius, mass, rate = b[RI + t], b[MI + t], rolling_rate(b[TI + t], dt)
        force, torque, kept = sphere_on_wall(
            coefficients_at(b, t, c), radius, mass, b[GAP + t], vec3(b[NX + t], b[NY + t], b[NZ + t]),
            vec3(b[UX + t], b[UY + t], b[UZ + t]), vec3(b[VX + t], b[VY + t], b[VZ + t]),
            vec3(b[AX + t], b[AY + t], b[AZ + t]), vec3(zero, zero, spin),
            vec3(b[SX + t], b[SY + t], b[SZ + t]), b[DT + t], rate,
        )  # fmt: skip
        b[UX + t] = force.x
        b[UY + t] = force.y
        b[UZ + t] = force.z
        if FRICTION:
            b[AX + t] = torque.x
            b[AY + t] = torque.y
            b[AZ + t] = torque.z
            b[SX + t] = kept.x
            b[SY + t] = kept.y
            b[SZ + t] = kept.z


@kernel
def largest_gap(b, bits, count):
    """Largest of GAP, zero if none. Positive floats sort like the integers of their bits, and integers vectorise."""
    most = bits[GAP] - bits[GAP]
    for t in range(uint64(count)):
        most = max(most, bits[GAP + t])
    bits[SPARE] = most
    return wide(b[SPARE])


@kernel
def where_gap(b, count, value):
    """Place of the first GAP that is not below `value`."""
    for t in range(uint64(count)):
        if not b[GAP + t] < value:
            return t
    return uint64(0)
