"""The block of contacts that a law works on: columns of one small buffer, so that the law runs in SIMD registers.

Contacts go through three stages: *gather* copies what the law needs of BLOCK contacts into columns, *law* runs over the
columns without a branch or an indirect address, *scatter* adds the results to the grains. Three things each silently
undo the vectorisation of the law loop: signed indices (hence uint64 throughout), columns in separate arrays or at
offsets unknown to the compiler (hence one buffer, constant offsets), and a law that is not inlined.
"""

from labbook_dem.spheres import sphere_on_sphere, sphere_on_wall
from labbook_dem.words import FRICTION, func, real, vec3, wide

from labbook_numba.kernels.features import LANES, STRIDE, kernel, uint64
from labbook_numba.state import SPHERES

# columns; in: normal or branch, gap, velocity predicted and half a step old, spins of i and j, spring and its advance;
# out, in the places of the velocities, spins and spring: force, torque on i and on j, spring
(NX, NY, NZ, GAP, UX, UY, UZ, VX, VY, VZ, AX, AY, AZ, BX, BY, BZ, SX, SY, SZ, DT, SPARE) = (
    uint64(column * STRIDE) for column in range(SPHERES.BLOCK_COLUMNS)
)
HELD = DT  # 1 for a contact that has a spring; becomes DT


@func
def whole(count):
    """Places to compute for `count` contacts: full registers, so that every contact sees the same instructions."""
    return (uint64(count) + LANES - uint64(1)) // LANES * LANES


@func
def reals(c):
    """Coefficients in the precision of laws."""
    return (real(c[0]), real(c[1]), real(c[2]), real(c[3]), real(c[4]), real(c[5]), real(c[6]), real(c[7]))


@kernel
def pair_law(b, count, coefficients, radius, mass, inertia_rate):
    """Law stage of grain on grain. Branch in NX.., (diameter^2 - r^2) in GAP; velocities relative, spins own."""
    c = reals(coefficients)
    for t in range(whole(count)):
        force, torque, other, kept, delta = sphere_on_sphere(
            c, radius, mass, vec3(b[NX + t], b[NY + t], b[NZ + t]), b[GAP + t],
            vec3(b[UX + t], b[UY + t], b[UZ + t]), vec3(b[VX + t], b[VY + t], b[VZ + t]),
            vec3(b[AX + t], b[AY + t], b[AZ + t]), vec3(b[BX + t], b[BY + t], b[BZ + t]),
            vec3(b[SX + t], b[SY + t], b[SZ + t]), b[DT + t], inertia_rate,
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
def wall_law(b, count, coefficients, radius, mass, inertia_rate, spin):
    """Law stage of grain on wall. Unit normal in NX.., overlap in GAP; the wall turns with `spin` [rad/s] about z."""
    c = reals(coefficients)
    zero = real(0.0)
    for t in range(whole(count)):
        force, torque, kept = sphere_on_wall(
            c, radius, mass, b[GAP + t], vec3(b[NX + t], b[NY + t], b[NZ + t]),
            vec3(b[UX + t], b[UY + t], b[UZ + t]), vec3(b[VX + t], b[VY + t], b[VZ + t]),
            vec3(b[AX + t], b[AY + t], b[AZ + t]), vec3(zero, zero, spin),
            vec3(b[SX + t], b[SY + t], b[SZ + t]), b[DT + t], inertia_rate,
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
