"""The block of contacts of rods: the columns of `blocks`, and levers and predicted spins behind them.

Before a block come its closest points: 384 near pairs at a time, in columns of State.near, in double whatever the law.
"""

from labbook_dem.rods import rod_on_rod
from labbook_dem.segments import closest
from labbook_dem.words import dot, real, vec3, wide, wide3

from labbook_numba.kernels.blocks import (
    AX,
    AY,
    AZ,
    BX,
    BY,
    BZ,
    DT,
    GAP,
    NX,
    NY,
    NZ,
    SX,
    SY,
    SZ,
    UX,
    UY,
    UZ,
    VX,
    VY,
    VZ,
    reals,
    whole,
)
from labbook_numba.kernels.features import FRICTION, STRIDE, kernel, uint64
from labbook_numba.state import RODS as LAYOUT
from labbook_numba.state import SPHERES

# of a block: levers of i and j, spins of i and j predicted for now
(IX, IY, IZ, JX, JY, JZ, PX, PY, PZ, OX, OY, OZ) = (
    uint64(column * STRIDE) for column in range(SPHERES.BLOCK_COLUMNS, LAYOUT.BLOCK_COLUMNS)
)
# of State.near: branch between centres, which becomes that between closest points; axes, which become levers; gap
(CX, CY, CZ, KX, KY, KZ, LX, LY, LZ, CLOSE) = (uint64(column * STRIDE) for column in range(LAYOUT.NEAR_COLUMNS))


@kernel
def closest_points(b, count, half, reach2):
    """Branch, levers and gap (diameter^2 - r^2) of near pairs."""
    for t in range(uint64(count)):
        a = wide3(b[KX + t], b[KY + t], b[KZ + t])
        other = wide3(b[LX + t], b[LY + t], b[LZ + t])
        r, s, away = closest(wide3(b[CX + t], b[CY + t], b[CZ + t]), a, other, half)
        b[CX + t] = away.x
        b[CY + t] = away.y
        b[CZ + t] = away.z
        b[KX + t] = a.x * r
        b[KY + t] = a.y * r
        b[KZ + t] = a.z * r
        b[LX + t] = other.x * s
        b[LY + t] = other.y * s
        b[LZ + t] = other.z * s
        b[CLOSE + t] = wide(reach2) - dot(away, away)


@kernel
def rod_law(b, count, coefficients, radius, mass, inertia_rate):
    """Law stage of rod on rod. Branch in NX.., gap in GAP; levers; velocities of centres relative, spins own."""
    c = reals(coefficients)
    for t in range(whole(count)):
        force, torque, other, kept, delta = rod_on_rod(
            c, radius, mass, vec3(b[NX + t], b[NY + t], b[NZ + t]), b[GAP + t],
            vec3(b[IX + t], b[IY + t], b[IZ + t]), vec3(b[JX + t], b[JY + t], b[JZ + t]),
            vec3(b[UX + t], b[UY + t], b[UZ + t]), vec3(b[VX + t], b[VY + t], b[VZ + t]),
            vec3(b[PX + t], b[PY + t], b[PZ + t]), vec3(b[OX + t], b[OY + t], b[OZ + t]),
            vec3(b[AX + t], b[AY + t], b[AZ + t]), vec3(b[BX + t], b[BY + t], b[BZ + t]),
            vec3(b[SX + t], b[SY + t], b[SZ + t]), b[DT + t], inertia_rate,
        )  # fmt: skip
        b[UX + t] = force.x
        b[UY + t] = force.y
        b[UZ + t] = force.z
        b[AX + t] = torque.x
        b[AY + t] = torque.y
        b[AZ + t] = torque.z
        b[BX + t] = other.x
        b[BY + t] = other.y
        b[BZ + t] = other.z
        if FRICTION:
            b[SX + t] = kept.x
            b[SY + t] = kept.y
            b[SZ + t] = kept.z
        b[GAP + t] = delta


@kernel
def rolling_inertia(inertia, slender):
    """The smaller moment of inertia [kg m^2], that about the axis, by which rolling resistance is limited."""
    return real(inertia / (wide(1.0) + slender))
