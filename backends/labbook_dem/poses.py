"""Parts that move: from space into the frame of a part and back (`labbook.scene.part_motion`), for compiled backends.

`pose` holds rows of `Poses.table` by step and part; `now` is the row of the present step, `w` the part. Springs at a
part that moves are stored in its frame. Rows of parts that stand still change no bit.
"""

import numpy as np

from labbook_dem.words import func, narrow, vec3, wide, wide3


@func
def inwards(pose: np.ndarray, now: int, w: int, v: wide3):
    """A vector in space, in the frame of part w."""
    return wide3(
        pose[now, w, 0] * v.x + pose[now, w, 3] * v.y + pose[now, w, 6] * v.z,
        pose[now, w, 1] * v.x + pose[now, w, 4] * v.y + pose[now, w, 7] * v.z,
        pose[now, w, 2] * v.x + pose[now, w, 5] * v.y + pose[now, w, 8] * v.z,
    )


@func
def outwards(pose: np.ndarray, now: int, w: int, v: wide3):
    """A vector in the frame of part w, in space."""
    return wide3(
        pose[now, w, 0] * v.x + pose[now, w, 1] * v.y + pose[now, w, 2] * v.z,
        pose[now, w, 3] * v.x + pose[now, w, 4] * v.y + pose[now, w, 5] * v.z,
        pose[now, w, 6] * v.x + pose[now, w, 7] * v.y + pose[now, w, 8] * v.z,
    )


@func
def in_part(pose: np.ndarray, now: int, w: int, x: wide3):
    """A point in space, in the frame of part w."""
    return inwards(pose, now, w, x - wide3(pose[now, w, 9], pose[now, w, 10], pose[now, w, 11]))


@func
def part_velocity(pose: np.ndarray, now: int, w: int, at: wide3):
    """Velocity [m/s] of part w at a point in space."""
    return wide3(
        pose[now, w, 12] + pose[now, w, 16] * at.z - pose[now, w, 17] * at.y,
        pose[now, w, 13] + pose[now, w, 17] * at.x - pose[now, w, 15] * at.z,
        pose[now, w, 14] + pose[now, w, 15] * at.y - pose[now, w, 16] * at.x,
    )


@func
def part_velocity_before(pose: np.ndarray, now: int, w: int, at: wide3, dt: wide, step: int):
    """The same half a step before, of the point of the part that is there now: springs are advanced by the way that
    grain and part went since the last step. At step 0 velocities are of that time."""
    body = in_part(pose, now, w, at)
    before = now - 1 if step > 0 else now
    there = outwards(pose, before, w, body) + wide3(pose[before, w, 9], pose[before, w, 10], pose[before, w, 11])
    return (at - there) * (wide(1.0) / dt) if step > 0 else part_velocity(pose, now, w, at)


@func
def part_spin(pose: np.ndarray, now: int, w: int):
    """Angular velocity [rad/s] of part w."""
    return narrow(wide3(pose[now, w, 15], pose[now, w, 16], pose[now, w, 17]))


@func
def spring_outwards(pose: np.ndarray, now: int, w: int, s: vec3):
    """A spring in the frame of part w, in space."""
    return narrow(outwards(pose, now, w, wide3(wide(s.x), wide(s.y), wide(s.z))))


@func
def spring_inwards(pose: np.ndarray, now: int, w: int, s: vec3):
    """A spring in space, in the frame of part w."""
    return narrow(inwards(pose, now, w, wide3(wide(s.x), wide(s.y), wide(s.z))))
