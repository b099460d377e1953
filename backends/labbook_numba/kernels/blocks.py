"""The block of contacts that a law works on: columns of one small buffer, so that the law runs in SIMD registers.

Contacts go through three stages: *gather* copies what the law needs of BLOCK contacts into columns, *law* runs over the
columns without a branch or an indirect address, *scatter* adds the results to the grains. Three things each silently
undo the vectorisation of the law loop: signed indices (hence uint64 throughout), columns in separate arrays or at
offsets unknown to the compiler (hence one buffer, constant offsets), and a law that is not inlined.
"""

from labbook_dem.contact import rolling, slip, trial
from labbook_dem.laws.hertz_mindlin import normal, respond
from labbook_dem.words import cross, dot, func, real, sqrt, vec3, wide

from labbook_numba.kernels.features import BLOCK_COLUMNS, FRICTION, LANES, ROLLING, STRIDE, TWIST, kernel, uint64

# columns; in: normal or branch, gap, velocity predicted and half a step old, spins of i and j, spring and its advance;
# out, in the places of the velocities, spins and spring: force, torque on i and on j, spring
(NX, NY, NZ, GAP, UX, UY, UZ, VX, VY, VZ, AX, AY, AZ, BX, BY, BZ, SX, SY, SZ, DT, SPARE) = (
    uint64(column * STRIDE) for column in range(BLOCK_COLUMNS)
)
HELD = DT  # 1 for a contact that has a spring; becomes DT


@func
def touch(c, rs, ms, lever_i, lever_j, radius, delta, n, u, v, wi, wj, s, dt, inertia_rate):
    """Force on i, its arm n x f_t, rolling torque on i, and the spring. dt: by how much to advance it [s]."""
    zero = real(0.0)
    vn = dot(u, n)
    if FRICTION:
        vt = slip(n, v, wi * lever_i + wj * lever_j)
        fn, ft, kept = respond(c, rs, ms, delta, vn, trial(s, n, vt, dt), vt)
        force = n * fn + ft
        arm = cross(n, ft)
    else:
        fn = normal(c, rs, ms, delta, vn)
        force = n * fn
        arm = vec3(zero, zero, zero)
        kept = arm
    if ROLLING:
        roll = rolling(wi - wj, n, c[5] * radius * fn, inertia_rate, TWIST)
    else:
        roll = vec3(zero, zero, zero)
    return force, arm, roll, kept


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
    one = real(1.0)
    half = real(0.5)
    diameter = real(2.0) * radius
    ms = half * mass
    rs = half * radius
    for t in range(whole(count)):
        away = vec3(b[NX + t], b[NY + t], b[NZ + t])
        r = sqrt(dot(away, away))
        delta = b[GAP + t] / (diameter + r)
        lever = half * r
        force, arm, roll, kept = touch(
            c, rs, ms, lever, lever, radius, delta, away * (one / r),
            vec3(b[UX + t], b[UY + t], b[UZ + t]), vec3(b[VX + t], b[VY + t], b[VZ + t]),
            vec3(b[AX + t], b[AY + t], b[AZ + t]), vec3(b[BX + t], b[BY + t], b[BZ + t]),
            vec3(b[SX + t], b[SY + t], b[SZ + t]), b[DT + t], inertia_rate,
        )  # fmt: skip
        b[UX + t] = force.x
        b[UY + t] = force.y
        b[UZ + t] = force.z
        if FRICTION:
            arm = arm * lever
            b[AX + t] = roll.x - arm.x
            b[AY + t] = roll.y - arm.y
            b[AZ + t] = roll.z - arm.z
            b[BX + t] = -roll.x - arm.x
            b[BY + t] = -roll.y - arm.y
            b[BZ + t] = -roll.z - arm.z
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
        delta = b[GAP + t]
        lever = radius - delta
        force, arm, roll, kept = touch(
            c, radius, mass, lever, zero, radius, delta, vec3(b[NX + t], b[NY + t], b[NZ + t]),
            vec3(b[UX + t], b[UY + t], b[UZ + t]), vec3(b[VX + t], b[VY + t], b[VZ + t]),
            vec3(b[AX + t], b[AY + t], b[AZ + t]), vec3(zero, zero, spin),
            vec3(b[SX + t], b[SY + t], b[SZ + t]), b[DT + t], inertia_rate,
        )  # fmt: skip
        b[UX + t] = force.x
        b[UY + t] = force.y
        b[UZ + t] = force.z
        if FRICTION:
            arm = arm * lever
            b[AX + t] = roll.x - arm.x
            b[AY + t] = roll.y - arm.y
            b[AZ + t] = roll.z - arm.z
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
