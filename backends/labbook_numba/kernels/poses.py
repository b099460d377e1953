"""Parts that move: from space into the frame of a part and back, at the present step (`labbook.scene.part_motion`).

Springs at a part that moves are stored in its frame. Rows of walls that stand still change no bit.
"""

from labbook_dem.words import ROLLING_SPRING, func, narrow, vec3, wide, wide3

from labbook_numba.kernels.blocks import GX, SX, put_vector, vector_at
from labbook_numba.kernels.features import STEP, int64, kernel
from labbook_numba.state import State


@func
def pose_now(st: State):
    """Row of the present step in st.pose."""
    return int64(st.count[STEP]) - int64(st.pose_first[0])


@func
def inwards(pose, now, w, v):
    """A vector in space, in the frame of wall w."""
    return wide3(
        pose[now, w, 0] * v.x + pose[now, w, 3] * v.y + pose[now, w, 6] * v.z,
        pose[now, w, 1] * v.x + pose[now, w, 4] * v.y + pose[now, w, 7] * v.z,
        pose[now, w, 2] * v.x + pose[now, w, 5] * v.y + pose[now, w, 8] * v.z,
    )


@func
def outwards(pose, now, w, v):
    """A vector in the frame of wall w, in space."""
    return wide3(
        pose[now, w, 0] * v.x + pose[now, w, 1] * v.y + pose[now, w, 2] * v.z,
        pose[now, w, 3] * v.x + pose[now, w, 4] * v.y + pose[now, w, 5] * v.z,
        pose[now, w, 6] * v.x + pose[now, w, 7] * v.y + pose[now, w, 8] * v.z,
    )


@func
def in_part(pose, now, w, x):
    """A point in space, in the frame of wall w."""
    return inwards(pose, now, w, x - wide3(pose[now, w, 9], pose[now, w, 10], pose[now, w, 11]))


@func
def part_velocity(pose, now, w, at):
    """Velocity [m/s] of wall w as a whole at a point in space."""
    return wide3(
        pose[now, w, 12] + pose[now, w, 16] * at.z - pose[now, w, 17] * at.y,
        pose[now, w, 13] + pose[now, w, 17] * at.x - pose[now, w, 15] * at.z,
        pose[now, w, 14] + pose[now, w, 15] * at.y - pose[now, w, 16] * at.x,
    )


@func
def part_velocity_before(pose, now, w, at, dt, step):
    """The same half a step before, of the point of the wall that is there now: springs are advanced by the way that
    grain and wall went since the last step. At step 0 velocities are of that time."""
    body = in_part(pose, now, w, at)
    before = now - 1 if step > 0 else now
    there = outwards(pose, before, w, body) + wide3(pose[before, w, 9], pose[before, w, 10], pose[before, w, 11])
    return (at - there) * (wide(1.0) / dt) if step > 0 else part_velocity(pose, now, w, at)


@func
def part_spin(pose, now, w):
    """Angular velocity [rad/s] of wall w as a whole."""
    return narrow(wide3(pose[now, w, 15], pose[now, w, 16], pose[now, w, 17]))


@func
def spring_outwards(pose, now, w, s: vec3):
    """A spring in the frame of wall w, in space."""
    return narrow(outwards(pose, now, w, wide3(wide(s.x), wide(s.y), wide(s.z))))


@func
def spring_inwards(pose, now, w, s: vec3):
    """A spring in space, in the frame of wall w."""
    return narrow(inwards(pose, now, w, wide3(wide(s.x), wide(s.y), wide(s.z))))


@kernel
def springs_outwards(b, pose, now, w, count):
    """Turn the springs of a block from the frame of wall w into space."""
    for t in range(count):
        put_vector(b, SX + t, spring_outwards(pose, now, w, vector_at(b, SX + t)))
        if ROLLING_SPRING:
            put_vector(b, GX + t, spring_outwards(pose, now, w, vector_at(b, GX + t)))


@kernel
def springs_inwards(b, pose, now, w, count):
    """Turn the springs of a block from space into the frame of wall w."""
    for t in range(count):
        put_vector(b, SX + t, spring_inwards(pose, now, w, vector_at(b, SX + t)))
        if ROLLING_SPRING:
            put_vector(b, GX + t, spring_inwards(pose, now, w, vector_at(b, GX + t)))
