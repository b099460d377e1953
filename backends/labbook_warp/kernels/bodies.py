"""What the grains are: all alike, or each by its own row."""

from __future__ import annotations

from labbook_dem.contact import rolling_rate
from labbook_dem.words import VARIED, func, real, struct, wide

from labbook_warp.kernels.system import Material, System
from labbook_warp.kernels.words import KINDS


@struct
class Body:
    """One grain. reach: its radius, for overlaps, which are small differences of large lengths."""

    reach: wide
    radius: real
    mass: real
    rolling_rate: real
    kind: int


@func
def body(a: System, m: Material, i: int):
    """What grain i is."""
    b = Body()
    if VARIED:
        own = a.body[i]
        b.reach = own[0]
        b.radius = real(own[0])
        b.mass = real(own[1])
        b.rolling_rate = rolling_rate(real(own[2]), real(m.dt))
        b.kind = int(own[3])
    else:
        b.reach = m.reach
        b.radius = m.radius
        b.mass = m.mass
        b.rolling_rate = m.inertia_rate
    return b


@func
def between(a: System, m: Material, s: int, one: Body, other: Body):
    """Coefficients of the law between two grains of slot s."""
    c = m.c
    if VARIED:
        c = a.pair_c[(s * KINDS + one.kind) * KINDS + other.kind]
    return c


@func
def with_plate(a: System, g: int, one: Body):
    """Coefficients of the law between a grain and wall g."""
    at = g
    if VARIED:
        at = g * KINDS + one.kind
    return a.wall_c[at]


@func
def touching2(m: Material, one: Body, other: Body):
    """Square of the distance [m] at which two grains touch."""
    square = m.reach2
    if VARIED:
        square = (one.reach + other.reach) * (one.reach + other.reach)
    return square


@func
def listed2(a: System, m: Material, i: int, j: int):
    """Square of the distance [m] up to which two grains are listed as neighbours."""
    square = m.listed2
    if VARIED:
        far = a.body[i][0] + a.body[j][0] + wide(2.0) * m.half_skin
        square = far * far
    return square


@func
def per_mass(a: System, m: Material, i: int):
    """One over the mass of grain i [1/kg]."""
    per = m.per_mass
    if VARIED:
        per = wide(1.0) / a.body[i][1]
    return per


@func
def per_inertia(a: System, m: Material, i: int):
    """One over the moment of inertia of grain i [1/(kg m^2)]."""
    per = m.per_inertia
    if VARIED:
        per = wide(1.0) / a.body[i][2]
    return per
