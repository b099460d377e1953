"""Properties of grains: the same for all, or a row for each."""

from __future__ import annotations

from labbook_dem.contact import rolling_rate
from labbook_dem.words import VARIED, func, real, struct, wide

from labbook_warp.kernels.system import Material, System
from labbook_warp.kernels.words import KINDS


@struct
class Body:
    """Properties of one grain."""

    reach: wide  # radius [m] in double: an overlap is a small difference of large lengths
    radius: real  # [m]
    mass: real  # [kg]
    rolling_rate: real  # see `labbook_dem.contact.rolling_rate`
    kind: int  # number of its species


@func
def body(a: System, m: Material, i: int):
    """Properties of grain i."""
    b = Body()
    if VARIED:
        row = a.body[i]
        b.reach = row[0]
        b.radius = real(row[0])
        b.mass = real(row[1])
        b.rolling_rate = rolling_rate(real(row[2]), real(m.dt))
        b.kind = int(row[3])
    else:
        b.reach = m.reach
        b.radius = m.radius
        b.mass = m.mass
        b.rolling_rate = m.inertia_rate
    return b


@func
def pair_coefficients(a: System, m: Material, s: int, first: Body, second: Body):
    """Coefficients of the contact law between two grains of slot s."""
    c = m.c
    if VARIED:
        c = a.pair_c[(s * KINDS + first.kind) * KINDS + second.kind]
    return c


@func
def wall_coefficients(a: System, g: int, b: Body):
    """Coefficients of the contact law between a grain and wall g."""
    row = g
    if VARIED:
        row = g * KINDS + b.kind
    return a.wall_c[row]


@func
def contact_distance2(m: Material, first: Body, second: Body):
    """Square of the centre distance [m^2] below which two grains overlap."""
    square = m.reach2
    if VARIED:
        square = (first.reach + second.reach) * (first.reach + second.reach)
    return square


@func
def listed2(a: System, m: Material, i: int, j: int):
    """Square of the centre distance [m^2] up to which two grains are listed as neighbours."""
    square = m.listed2
    if VARIED:
        distance = a.body[i][0] + a.body[j][0] + wide(2.0) * m.half_skin
        square = distance * distance
    return square


@func
def inverse_mass(a: System, m: Material, i: int):
    """Inverse mass of grain i [1/kg]."""
    inverse = m.inverse_mass
    if VARIED:
        inverse = wide(1.0) / a.body[i][1]
    return inverse


@func
def inverse_inertia(a: System, m: Material, i: int):
    """Inverse moment of inertia of grain i [1/(kg m^2)]."""
    inverse = m.inverse_inertia
    if VARIED:
        inverse = wide(1.0) / a.body[i][2]
    return inverse
