"""Contacts of one grain, and their sums.

Sums are exact and so do not depend on order: each contribution is truncated to whole quanta, which are far below a
grain's weight, and integers are added. In double precision the remainders are summed likewise, in quanta finer by 2^48.
Hence the order of a list, its age and the number of threads that share a grain decide no bit of the result.
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
    max_lanes,
    quanta3,
    uint32,
    wp,
)


@struct
class Contact:
    """Contact as one of its grains sees it; without a contact, only `touches` is valid."""

    touches: bool
    overlap: real  # [m]
    force: vec3  # [N]
    torque: vec3  # [N m]
    spring: vec3  # tangential displacement [m] for the next step
    rolling: vec3  # torque of the rolling spring [N m] for the next step, if the law has one
    branch: wide3  # [m], from the centre of the grain to that of its neighbour, or to the point of the wall


@func
def spring_before(springs: Vectors, at: int, has_spring: bool, half_dt: real):
    """Tangential spring [m] of a contact, and the time [s] to advance it by: half a step if the contact is new."""
    last = vec3(real(0.0), real(0.0), real(0.0))
    advance = half_dt
    if FRICTION:
        if has_spring:
            last = springs[at]
            advance = half_dt + half_dt
    return last, advance


@func
def rolling_before(rolling: Vectors, at: int, has_spring: bool):
    """Torque of a contact's rolling spring [N m], zero if the contact is new."""
    last = vec3(real(0.0), real(0.0), real(0.0))
    if has_spring:
        last = rolling[at]
    return last


@func
def quanta(v: vec3, per: real):
    """Vector in whole quanta, truncated towards zero; per: 1/quantum."""
    return quanta3(wp.int64(v[0] * per), wp.int64(v[1] * per), wp.int64(v[2] * per))


@func
def from_quanta(n: quanta3, quantum: wide):
    """Vector of `n` quanta in SI units."""
    return wide3(wide(n[0]) * quantum, wide(n[1]) * quantum, wide(n[2]) * quantum)


@func
def fine_quanta(v: vec3, per: real):
    """Remainder of `quanta`, in quanta finer by 2^48."""
    return quanta(v * per - narrow(from_quanta(quanta(v, per), wide(1.0))), real(2.0**48.0))


@func
def sum_quanta_over_lanes(n: quanta3):
    """Sum over the threads that share a grain."""
    return quanta3(add_lanes(n[0], LANES), add_lanes(n[1], LANES), add_lanes(n[2], LANES))


@struct
class Sums:
    """Partial sums of force and torque in coarse and fine quanta, and the largest overlap [m]."""

    force: quanta3
    torque: quanta3
    fine_force: quanta3
    fine_torque: quanta3
    deepest: real  # NO_NUMBER stands for a force that is NaN or too large for the quanta


@func
def plus(sums: Sums, c: Contact, m: Material):
    """Sums with one more contact."""
    new = Sums()
    new.force = sums.force + quanta(c.force, m.per_quantum_f)
    new.deepest = max(sums.deepest, c.overlap)
    force_in_quanta = c.force * m.per_quantum_f
    square = dot(force_in_quanta, force_in_quanta)
    if TORQUES:
        torque_in_quanta = c.torque * m.per_quantum_t
        square = square + dot(torque_in_quanta, torque_in_quanta)
    if not square < real(2.0**114.0):  # below 2^57 quanta each, 64 contacts stay below 2^63
        new.deepest = real(NO_NUMBER)
    if FINE:
        new.fine_force = sums.fine_force + fine_quanta(c.force, m.per_quantum_f)
    if TORQUES:
        new.torque = sums.torque + quanta(c.torque, m.per_quantum_t)
        if FINE:
            new.fine_torque = sums.fine_torque + fine_quanta(c.torque, m.per_quantum_t)
    return new


@func
def store_wall_sums(a: System, i: int, touching: uint32, sums: Sums):
    """Store the mask of walls that grain i touches, and the sums over its contacts with them."""
    a.wall_touching[i] = touching
    if touching != wp.uint32(0):  # else the sums of an earlier step stay there, and are not read
        a.wall_force[i] = sums.force
        a.wall_deep[i] = sums.deepest
        if FINE:
            a.wall_fine_force[i] = sums.fine_force
        if TORQUES:
            a.wall_torque[i] = sums.torque
            if FINE:
                a.wall_fine_torque[i] = sums.fine_torque


@func
def load_wall_sums(a: System, i: int):
    """Sums that `store_wall_sums` stored."""
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
def add_sums(first: Sums, second: Sums):
    """Total of two sums."""
    new = Sums()
    new.force = first.force + second.force
    new.deepest = max(first.deepest, second.deepest)
    if FINE:
        new.fine_force = first.fine_force + second.fine_force
    if TORQUES:
        new.torque = first.torque + second.torque
        if FINE:
            new.fine_torque = first.fine_torque + second.fine_torque
    return new


@func
def sum_lanes(sums: Sums):
    """Sums over all threads that share a grain."""
    new = Sums()
    new.force = sum_quanta_over_lanes(sums.force)
    new.deepest = max_lanes(sums.deepest, LANES)
    if FINE:
        new.fine_force = sum_quanta_over_lanes(sums.fine_force)
    if TORQUES:
        new.torque = sum_quanta_over_lanes(sums.torque)
        if FINE:
            new.fine_torque = sum_quanta_over_lanes(sums.fine_torque)
    return new
