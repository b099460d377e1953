"""Parts that move: their poses of now, by wall; compiled only for scenes with such a part. Formulas:
`labbook_dem.poses`; the tables: `labbook_warp.poses`."""

from __future__ import annotations

from labbook_dem.poses import (
    in_part,
    inwards,
    outwards,
    part_spin,
    part_velocity,
    part_velocity_before,
    spring_inwards,
    spring_outwards,
)
from labbook_dem.words import func, narrow, vec3, wide3

from labbook_warp.kernels.system import Material, System
from labbook_warp.kernels.words import kernel, load_int, wp


@func
def row_of(a: System, wall: int):
    """Row of the poses of now of the member that has a wall."""
    return a.pose_row[wall // a.walls]


@func
def position_in_part(a: System, wall: int, x: wide3):
    """A point in space, in the frame of a wall."""
    return in_part(a.pose, row_of(a, wall), load_int(a.pose_of, wall), x)


@func
def direction_in_part(a: System, wall: int, v: wide3):
    """A direction in space, in the frame of a wall."""
    return inwards(a.pose, row_of(a, wall), load_int(a.pose_of, wall), v)


@func
def direction_in_space(a: System, wall: int, v: wide3):
    """A direction in the frame of a wall, in space."""
    return outwards(a.pose, row_of(a, wall), load_int(a.pose_of, wall), v)


@func
def spring_from_part(a: System, wall: int, s: vec3):
    """A spring in the frame of a wall, in space."""
    return spring_outwards(a.pose, row_of(a, wall), load_int(a.pose_of, wall), s)


@func
def spring_to_part(a: System, wall: int, s: vec3):
    """A spring in space, in the frame of a wall."""
    return spring_inwards(a.pose, row_of(a, wall), load_int(a.pose_of, wall), s)


@func
def turning_of(a: System, wall: int):
    """Angular velocity [rad/s] of a wall as a whole."""
    return part_spin(a.pose, row_of(a, wall), load_int(a.pose_of, wall))


@func
def velocity_of(a: System, wall: int, at: wide3):
    """Velocity [m/s] of a wall as a whole at a point in space."""
    return narrow(part_velocity(a.pose, row_of(a, wall), load_int(a.pose_of, wall), at))


@func
def velocity_before(a: System, m: Material, wall: int, at: wide3):
    """The same half a step before, of the point of the wall that is there now."""
    begun = int(wp.min(a.pose_step[wall // a.walls], wp.int64(1)))
    return narrow(part_velocity_before(a.pose, row_of(a, wall), load_int(a.pose_of, wall), at, m.dt, begun))


@func
def lists_are_due(a: System, s: int, ahead: int):
    """True if parts may have moved by half a skin since lists were built, before so many steps more.

    Lists are built again whenever the number of the step passes a multiple of `pose_every`: that needs no memory.
    """
    now = a.pose_step[s]
    every = a.pose_every[s]
    return (now + wp.int64(ahead)) // every != now // every


@kernel
def tick(a: System, slot: int):
    """Go on to the poses of the next step, in the slots from `slot` on."""
    s = slot + wp.tid()
    if a.rows[s] > 0:
        a.pose_row[s] = a.pose_row[s] + 1
        a.pose_step[s] = a.pose_step[s] + wp.int64(1)
