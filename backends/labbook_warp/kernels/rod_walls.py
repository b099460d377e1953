"""Where the parts of a rod are near a wall; see `labbook_dem.walls`."""

from __future__ import annotations

from labbook_dem.walls.frustum import frustum_distance, frustum_end, frustum_rod
from labbook_dem.walls.plane import plane_rod
from labbook_dem.walls.strip import strip_distance, strip_rod
from labbook_dem.words import func, wide, wide3

from labbook_warp.kernels.system import System
from labbook_warp.kernels.words import FRUSTUMS, PLANES, STRIPS, rare_func


@rare_func
def rim_distance(rim: wide3, along: wide3, length: wide, x: wide3, axis: wide3, half: wide, radius: wide, part: int):
    """`part_distance` of a rim from a rod that lies across it."""
    distance, normal, s = frustum_rod(rim, along, length, x, axis, half, radius, part)
    return distance, normal, s


@func
def part_distance(a: System, wall: int, x: wide3, axis: wide3, half: wide, radius: wide, part: int):
    """Distance [m] of a part of a rod from a wall, unit normal, and where on the segment it is [m]."""
    b = a.wall_shape[wall]
    kind = a.wall_kind[wall]
    distance = wide(1e9)
    s = wide(0.0)
    normal = wide3(wide(0.0), wide(0.0), wide(0.0))
    if PLANES:
        if kind == 0:
            distance, normal, s = plane_rod(wide3(b[0], b[1], b[2]), wide3(b[3], b[4], b[5]), x, axis, half, part)
    if STRIPS:
        if kind == 1:
            start = wide3(b[0], wide(0.0), b[1])
            distance, normal, s = strip_rod(start, wide3(b[2], wide(0.0), b[3]), b[4], x, axis, half, radius, part)
    if FRUSTUMS:
        if kind == 2:
            rim = wide3(b[0], wide(0.0), b[1])
            along = wide3(b[2], wide(0.0), b[3])
            if part < 2:
                distance, normal, s = frustum_end(rim, along, b[4], x, axis, half, part)
            else:
                distance, normal, s = rim_distance(rim, along, b[4], x, axis, half, radius, part)
    return distance, normal, s


@func
def edge_distance(a: System, wall: int, part: int, x: wide3):
    """Distance [m] of x from the edge that a part of a rod lies across; 1e9 where a wall has none."""
    b = a.wall_shape[wall]
    kind = a.wall_kind[wall]
    low = wide3(b[0], wide(0.0), b[1])
    along = wide3(b[2], wide(0.0), b[3])
    distance = wide(1e9)
    if STRIPS:
        if kind == 1:
            edge = low if part == 2 else low + along * b[4]
            distance, _normal = strip_distance(edge, along, wide(0.0), x)
    if FRUSTUMS:
        if kind == 2:
            distance, _normal = frustum_distance(low, along, wide(0.0), x)
    return distance
