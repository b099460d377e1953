"""Contacts of one grain, and their sums.

Sums are exact, so that they do not depend on order: each contribution is rounded to a multiple of a quantum far below
a grain's weight, and sums of such multiples lose nothing in double precision. (Contributions in double are split in
two: what the rounding leaves over is summed likewise, in quanta finer by 2^48.) Hence neither the order of a list, nor
when it was built, nor how many threads share a grain decides a bit of the result.
"""

from __future__ import annotations

from labbook_dem.words import FRICTION, func, narrow, real, struct, vec3, wide, wide3

from labbook_warp.kernels.system import Material, System
from labbook_warp.kernels.words import FINE, LANES, TORQUES, Vectors, add_lanes, most_lanes, widen


@struct
class Contact:
    """A contact as one grain sees it; where nothing touches, only `touches` means something."""

    touches: bool
    overlap: real  # [m]
    force: vec3  # [N]
    torque: vec3  # [N m]
    spring: vec3  # [m], to be kept for the next step
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
def on_grid(v: vec3, magic: wide):
    """v rounded to multiples of a quantum: `magic` is 1.5 * 2^52 of them."""
    m = wide3(magic, magic, magic)
    return (widen(v) + m) - m


@func
def fine(v: vec3, magic: wide):
    """What `on_grid` leaves over, on a grid finer by 2^48."""
    return on_grid(narrow(widen(v) - on_grid(v, magic)), magic * wide(2.0**-48.0))


@func
def all_lanes(v: wide3):
    """Sum over the threads that share a grain."""
    return wide3(add_lanes(v[0], LANES), add_lanes(v[1], LANES), add_lanes(v[2], LANES))


@struct
class Sums:
    """Force [N] and torque [N m] so far, in quanta and in finer ones, and the largest overlap [m]."""

    force: wide3
    torque: wide3
    fine_force: wide3
    fine_torque: wide3
    deepest: real


@func
def plus(sums: Sums, c: Contact, m: Material):
    """Sums with one contact more."""
    new = Sums()
    new.force = sums.force + on_grid(c.force, m.grid_f)
    new.deepest = max(sums.deepest, c.overlap)
    if FINE:
        new.fine_force = sums.fine_force + fine(c.force, m.grid_f)
    if TORQUES:
        new.torque = sums.torque + on_grid(c.torque, m.grid_t)
        if FINE:
            new.fine_torque = sums.fine_torque + fine(c.torque, m.grid_t)
    return new


@func
def put_aside(a: System, i: int, sums: Sums):
    """Keep the sums over contacts of grain i with walls."""
    a.wall_force[i] = sums.force
    a.wall_deep[i] = sums.deepest
    if FINE:
        a.wall_fine_force[i] = sums.fine_force
    if TORQUES:
        a.wall_torque[i] = sums.torque
        if FINE:
            a.wall_fine_torque[i] = sums.fine_torque


@func
def with_walls(a: System, i: int, sums: Sums):
    """Sums with those that were put aside."""
    new = Sums()
    new.force = sums.force + a.wall_force[i]
    new.deepest = max(sums.deepest, a.wall_deep[i])
    if FINE:
        new.fine_force = sums.fine_force + a.wall_fine_force[i]
    if TORQUES:
        new.torque = sums.torque + a.wall_torque[i]
        if FINE:
            new.fine_torque = sums.fine_torque + a.wall_fine_torque[i]
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
