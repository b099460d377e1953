"""Distances of the parts of a rod from a wall; see `labbook_dem.walls`."""

from __future__ import annotations

from labbook_dem.chosen import wall_edge, wall_edges, wall_part
from labbook_dem.walls.frustum import is_across, leaves_plate, nearest_to_rim, rim_met, two_minima
from labbook_dem.words import func, wide, wide3

from labbook_warp.kernels.system import System
from labbook_warp.kernels.walls import wall_number
from labbook_warp.kernels.words import FRUSTUM, LOOKS, OTHERS_TOGETHER, TOGETHER, Wides, other_of_two, rare_func


@rare_func
def rare_edges(walls: Wides, w: int, kind: int, x: wide3, axis: wide3, half: wide, radius: wide):
    """`wall_edges`, not inlined."""
    met, s, twin, back = wall_edges(walls, w, kind, x, axis, half, radius)
    return met, s, twin, back


@func
def edges(a: System, wall: int, x: wide3, axis: wide3, half: wide, radius: wide, parts: int):
    """`wall_edges` of a wall if one of its edges is in the mask `parts`; else two distances of 1e9."""
    met = wide(1e9)
    s = wide(0.0)
    twin = wide(1e9)
    back = wide(0.0)
    if TOGETHER:
        if parts > 3:
            met, s, twin, back = rare_edges(a.wall_numbers, wall, a.wall_kind[wall], x, axis, half, radius)
    return met, s, twin, back


@func
def rim_of_two(rim: wide3, along: wide3, length: wide, x: wide3, axis: wide3, half: wide, radius: wide, second: bool):
    """Search of `frustum_edges` by two neighbouring threads, one edge each; the `second` starts from the other end."""
    direction = -axis if second else axis
    first = leaves_plate(rim, along, x, direction, half)
    last = -other_of_two(first)
    met = wide(1e9)
    s = wide(0.0)
    if is_across(rim, along, x, direction, half, first, last, last if second else first):
        s = nearest_to_rim(rim, x, direction, first, last)
        back = -other_of_two(s)
        two = two_minima(s, back, half)
        if two or not second:
            met = rim_met(rim, along, length, x, direction, half, radius, s, two)
    return met, (-s if second else s)


@func
def edge_of_two(a: System, wall: int, x: wide3, axis: wide3, half: wide, radius: wide, parts: int, part: int):
    """Distance [m] of part 2 or 3 from the edge, and its position on the segment, by two neighbouring threads.

    At a frustum the threads search from one end each; at other walls with a common search each thread finds both edges.
    parts: mask of the parts near the wall.
    """
    met = wide(1e9)
    s = wide(0.0)
    kind = a.wall_kind[wall]
    if TOGETHER:
        if parts > 3 and part > 1:
            if kind == FRUSTUM:
                b = a.wall_numbers
                rim = wide3(wall_number(b, wall, 0), wide(0.0), wall_number(b, wall, 1))
                along = wide3(wall_number(b, wall, 2), wide(0.0), wall_number(b, wall, 3))
                met, s = rim_of_two(rim, along, wall_number(b, wall, 4), x, axis, half, radius, part == 3)
            elif OTHERS_TOGETHER:
                met, s, twin, back = rare_edges(a.wall_numbers, wall, kind, x, axis, half, radius)
                if part == 3:
                    met = twin
                    s = back
    return met, s


@func
def part_distance(
    a: System, wall: int, x: wide3, axis: wide3, half: wide, radius: wide, part: int, met: wide, on: wide, twin: wide,
    back: wide,
):  # fmt: skip
    """Distance [m] of a part of a rod from a wall, unit normal, and position on the segment [m].

    met, on, twin, back: from `edges`.
    """
    distance, normal, s = wall_part(
        a.wall_numbers, wall, a.wall_kind[wall], x, axis, half, radius, part, met, on, twin, back
    )  # fmt: skip
    return distance, normal, s


@func
def edge_distance(a: System, wall: int, part: int, x: wide3):
    """Distance [m] of x from the edge of a part of a rod; 1e9 if the wall has none."""
    return wall_edge(a.wall_numbers, wall, a.wall_kind[wall], x, part)


@func
def edge_near(a: System, wall: int, part: int, x: wide3, axis: wide3, half: wide, reach: wide):
    """True if a segment may be closer than `reach` [m] to the edge of a part of a rod.

    No point of the segment is farther than half a gap from a sample, and the distance from an edge grows no faster than
    the distance along the segment.
    """
    near = bool(False)
    if edge_distance(a, wall, part, x) < half + reach:
        gap = (half + half) / wide(LOOKS)
        s = -half
        remaining = int(LOOKS)
        while remaining >= 0:
            if edge_distance(a, wall, part, x + axis * s) < reach + wide(0.5) * gap:
                near = True
            s = s + gap
            remaining = remaining - 1
    return near
