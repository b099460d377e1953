"""Contacts of one grain, and their sums.

Sums are exact, so that they do not depend on order: each contribution is counted in whole quanta far below a grain's
weight, towards zero, and integers are added. (Of contributions in double, what that leaves over is counted likewise, in
quanta finer by 2^48.) Hence neither the order of a list, nor when it was built, nor how many threads share a grain
decides a bit of the result.
"""

from __future__ import annotations

from labbook_dem.words import FRICTION, dot, func, narrow, real, struct, vec3, wide, wide3

from labbook_warp.kernels.system import Material, System
from labbook_warp.kernels.words import (
    FINE,
    LANES,
    NO_NUMBER,
    TORQUES,
    Vectors,
    add_lanes,
    most_lanes,
    quanta3,
    uint32,
    wp,
)


@struct
class Contact:
    """A contact as one grain sees it; where nothing touches, only `touches` means something."""

    touches: bool
    overlap: real  # [m]
    force: vec3  # [N]
    torque: vec3  # [N m]
    spring: vec3  # [m], to be kept for the next step
    rolling: vec3  # torque of the rolling spring [N m], likewise, where contacts have any
    branch: wide3  # [m], from the centre of the grain to that of its neighbour, or to the point of the wall


@func
def spring_before(springs: Vectors, at: int, held: bool, half_dt: real):
    """A contact's spring [m], and by how much to advance it [s]: a new one is half a step old."""
    last = vec3(real(0.0), real(0.0), real(0.0))
    advance = half_dt
    if FRICTION:
        if held:
            last = springs[at]
            advance = half_dt + half_dt
    return last, advance


@func
def rolling_before(rolling: Vectors, at: int, held: bool):
    """Torque of a contact's rolling spring [N m], zero for a new one."""
    last = vec3(real(0.0), real(0.0), real(0.0))
    if held:
        last = rolling[at]
    return last


@func
def quanta(v: vec3, per: real):
    """v in whole quanta; per: 1/quantum."""
    return quanta3(wp.int64(v[0] * per), wp.int64(v[1] * per), wp.int64(v[2] * per))


@func
def amount(n: quanta3, quantum: wide):
    """So many quanta, in their unit."""
    return wide3(wide(n[0]) * quantum, wide(n[1]) * quantum, wide(n[2]) * quantum)


@func
def left_over(v: vec3, per: real):
    """What `quanta` leaves of v, in finer quanta."""
    return quanta(v * per - narrow(amount(quanta(v, per), wide(1.0))), real(2.0**48.0))


@func
def all_lanes(n: quanta3):
    """Sum over the threads that share a grain."""
    return quanta3(add_lanes(n[0], LANES), add_lanes(n[1], LANES), add_lanes(n[2], LANES))


@struct
class Sums:
    """Force and torque so far, in quanta and in finer ones, and the largest overlap [m]."""

    force: quanta3
    torque: quanta3
    fine_force: quanta3
    fine_torque: quanta3
    deepest: real  # or NO_NUMBER


@func
def plus(sums: Sums, c: Contact, m: Material):
    """Sums with one contact more."""
    new = Sums()
    new.force = sums.force + quanta(c.force, m.per_quantum_f)
    new.deepest = max(sums.deepest, c.overlap)
    in_quanta = c.force * m.per_quantum_f
    far = dot(in_quanta, in_quanta)
    if TORQUES:
        turn = c.torque * m.per_quantum_t
        far = far + dot(turn, turn)
    if not far < real(2.0**114.0):  # of less than 2^57 quanta each, as many as a grain may have come to less than 2^63
        new.deepest = real(NO_NUMBER)
    if FINE:
        new.fine_force = sums.fine_force + left_over(c.force, m.per_quantum_f)
    if TORQUES:
        new.torque = sums.torque + quanta(c.torque, m.per_quantum_t)
        if FINE:
            new.fine_torque = sums.fine_torque + left_over(c.torque, m.per_quantum_t)
    return new


@func
def put_aside(a: System, i: int, touching: uint32, sums: Sums):
    """Keep which walls grain i touches, as bits, and the sums over its contacts with them, where there are any."""
    a.wall_touching[i] = touching
    if touching != wp.uint32(0):
        a.wall_force[i] = sums.force
        a.wall_deep[i] = sums.deepest
        if FINE:
            a.wall_fine_force[i] = sums.fine_force
        if TORQUES:
            a.wall_torque[i] = sums.torque
            if FINE:
                a.wall_fine_torque[i] = sums.fine_torque


@func
def of_walls(a: System, i: int):
    """What was put aside."""
    sums = Sums()
    sums.force = a.wall_force[i]
    sums.deepest = a.wall_deep[i]
    if FINE:
        sums.fine_force = a.wall_fine_force[i]
    if TORQUES:
        sums.torque = a.wall_torque[i]
        if FINE:
            sums.fine_torque = a.wall_fine_torque[i]
    return sums


@func
def joined_sums(one: Sums, other: Sums):
    """Both together."""
    new = Sums()
    new.force = one.force + other.force
    new.deepest = max(one.deepest, other.deepest)
    if FINE:
        new.fine_force = one.fine_force + other.fine_force
    if TORQUES:
        new.torque = one.torque + other.torque
        if FINE:
            new.fine_torque = one.fine_torque + other.fine_torque
    return new


@func
def over_lanes(sums: Sums):
    """Sums over all threads that share a grain."""
    new = Sums()
    new.force = all_lanes(sums.force)
    new.deepest = most_lanes(sums.deepest, LANES)
    if FINE:
        new.fine_force = all_lanes(sums.fine_force)
    if TORQUES:
        new.torque = all_lanes(sums.torque)
        if FINE:
            new.fine_torque = all_lanes(sums.fine_torque)
    return new
