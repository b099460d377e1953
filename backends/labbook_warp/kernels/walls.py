"""Where the walls of a member are, and how their surfaces move."""

from __future__ import annotations

from labbook_dem.walls.frustum import frustum_distance
from labbook_dem.walls.plane import plane_distance
from labbook_dem.walls.strip import strip_distance
from labbook_dem.words import func, wide, wide3

from labbook_warp.kernels.system import System
from labbook_warp.kernels.words import FRUSTUMS, PLANES, STRIPS


@func
def wall_distance(a: System, g: int, x: wide3):
    """Distance [m] of x from wall g, and the unit normal from the wall to x."""
    b = a.wall_shape[g]
    zero = wide(0.0)
    if PLANES:
        distance, normal = plane_distance(wide3(b[0], b[1], b[2]), wide3(b[3], b[4], b[5]), x)
        if STRIPS:
            if a.wall_kind[g] == 1:
                distance, normal = strip_distance(wide3(b[0], zero, b[1]), wide3(b[2], zero, b[3]), b[4], x)
        if FRUSTUMS:
            if a.wall_kind[g] == 2:
                distance, normal = frustum_distance(wide3(b[0], zero, b[1]), wide3(b[2], zero, b[3]), b[4], x)
    elif STRIPS:
        distance, normal = strip_distance(wide3(b[0], zero, b[1]), wide3(b[2], zero, b[3]), b[4], x)
        if FRUSTUMS:
            if a.wall_kind[g] == 2:
                distance, normal = frustum_distance(wide3(b[0], zero, b[1]), wide3(b[2], zero, b[3]), b[4], x)
    else:
        distance, normal = frustum_distance(wide3(b[0], zero, b[1]), wide3(b[2], zero, b[3]), b[4], x)
    return distance, normal


@func
def wall_velocity(a: System, g: int, at: wide3):
    """Velocity [m/s] of the surface of wall g at the point `at`."""
    b = a.wall_motion[g]
    return wide3(b[0] - b[3] * at[1], b[1] + b[3] * at[0], b[2])
