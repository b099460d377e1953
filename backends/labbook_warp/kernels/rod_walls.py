"""Where the parts of a rod are near a wall; see `labbook_dem.walls`."""

from __future__ import annotations

from labbook_dem.walls.frustum import (
    frustum_distance,
    frustum_part,
    frustum_rims,
    is_across,
    leaves_plate,
    nearest_to_rim,
    rim_met,
    two_minima,
)
from labbook_dem.walls.plane import plane_rod
from labbook_dem.walls.strip import strip_distance, strip_rod
from labbook_dem.words import func, wide, wide3

from labbook_warp.kernels.system import System
from labbook_warp.kernels.words import FRUSTUMS, LOOKS, PLANES, STRIPS, other_of_two, rare_func


@rare_func
def rims(rim: wide3, along: wide3, length: wide, x: wide3, axis: wide3, half: wide, radius: wide):
    """Of both edges of a frustum: distance [m] and where on the segment; see `frustum_rims`."""
    met, s, other, back = frustum_rims(rim, along, length, x, axis, half, radius)
    return met, s, other, back


@func
def edges(a: System, wall: int, x: wide3, axis: wide3, half: wide, radius: wide, parts: int):
    """`rims` of a wall where one of its edges is among `parts`, as bits."""
    met = wide(1e9)
    s = wide(0.0)
    other = wide(1e9)
    back = wide(0.0)
    if FRUSTUMS:
        if a.wall_kind[wall] == 2 and parts > 3:
            b = a.wall_shape[wall]
            rim = wide3(b[0], wide(0.0), b[1])
            met, s, other, back = rims(rim, wide3(b[2], wide(0.0), b[3]), b[4], x, axis, half, radius)
    return met, s, other, back


@func
def rim_of_two(rim: wide3, along: wide3, length: wide, x: wide3, axis: wide3, half: wide, radius: wide, second: bool):
    """As `frustum_rims`, one edge each of two neighbouring threads: the `second` looks from the other end."""
    a = -axis if second else axis
    first = leaves_plate(rim, along, x, a, half)
    last = -other_of_two(first)
    met = wide(1e9)
    s = wide(0.0)
    if is_across(rim, along, x, a, half, first, last, last if second else first):
        s = nearest_to_rim(rim, x, a, first, last)
        back = -other_of_two(s)
        two = two_minima(s, back, half)
        if two or not second:
            met = rim_met(rim, along, length, x, a, half, radius, s, two)
    return met, (-s if second else s)


@func
def edge_of_two(a: System, wall: int, x: wide3, axis: wide3, half: wide, radius: wide, parts: int, part: int):
    """Of part 2 or 3, by threads side by side: distance [m] from a frustum's edge, and where on the segment.

    parts: those that are near the wall, as bits.
    """
    met = wide(1e9)
    s = wide(0.0)
    if FRUSTUMS:
        if a.wall_kind[wall] == 2 and parts > 3 and part > 1:
            b = a.wall_shape[wall]
            rim = wide3(b[0], wide(0.0), b[1])
            met, s = rim_of_two(rim, wide3(b[2], wide(0.0), b[3]), b[4], x, axis, half, radius, part == 3)
    return met, s


@func
def part_distance(
    a: System, wall: int, x: wide3, axis: wide3, half: wide, radius: wide, part: int, met: wide, on: wide, other: wide,
    back: wide,
):  # fmt: skip
    """Distance [m] of a part of a rod from a wall, unit normal, and where on the segment it is [m].

    met, on, other, back: what `edges` gave.
    """
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
            distance, normal, s = frustum_part(rim, along, b[4], x, axis, half, part, on if part == 2 else back)
            if part > 1:
                distance = met if part == 2 else other
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


@func
def edge_near(a: System, wall: int, part: int, x: wide3, axis: wide3, half: wide, reach: wide):
    """Whether a segment may be closer than `reach` [m] to the edge that a part of a rod lies across.

    No point is farther than half a gap from one that is looked at, and the distance from an edge grows no faster than
    the way from point to point.
    """
    near = bool(False)
    if edge_distance(a, wall, part, x) < half + reach:
        gap = (half + half) / wide(LOOKS)
        on = -half
        left = int(LOOKS)
        while left >= 0:
            if edge_distance(a, wall, part, x + axis * on) < reach + wide(0.5) * gap:
                near = True
            on = on + gap
            left = left - 1
    return near
