"""Springs of blocks at parts that move, and the row of the present step; formulas: `labbook_dem.poses`."""

from labbook_dem.poses import spring_inwards, spring_outwards
from labbook_dem.words import ROLLING_SPRING, func

from labbook_numba.kernels.blocks import GX, SX, put_vector, vector_at
from labbook_numba.kernels.features import STEP, int64, kernel
from labbook_numba.state import State


@func
def pose_now(st: State):
    """Row of the present step in st.pose."""
    return int64(st.count[STEP]) - int64(st.pose_first[0])


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
