"""Where the parts of a rod are near a wall; see `labbook_dem.walls`."""

from __future__ import annotations

from labbook_dem.chosen import wall_edge, wall_edges, wall_part
from labbook_dem.walls.frustum import is_across, leaves_plate, nearest_to_rim, rim_met, two_minima
from labbook_dem.words import func, wide, wide3

from labbook_warp.kernels.system import System
from labbook_warp.kernels.walls import wall_number
from labbook_warp.kernels.words import FRUSTUM, LOOKS, OTHERS_TOGETHER, TOGETHER, Wides, other_of_two, rare_func


@rare_func
def rare_edges(walls: Wides, w: int, kind: int, x: wide3, axis: wide3, half: wide, radius: wide):
    """`wall_edges`."""
    met, s, other, back = wall_edges(walls, w, kind, x, axis, half, radius)
    return met, s, other, back


@func
def edges(a: System, wall: int, x: wide3, axis: wide3, half: wide, radius: wide, parts: int):
    """`wall_edges` of a wall where one of its edges is among `parts`, as bits."""
    met = wide(1e9)
    s = wide(0.0)
    other = wide(1e9)
    back = wide(0.0)
    if TOGETHER:
        if parts > 3:
            met, s, other, back = rare_edges(a.wall_numbers, wall, a.wall_kind[wall], x, axis, half, radius)
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
    """Of part 2 or 3, by threads side by side: distance [m] from the edge, and where on the segment.

    Those of a frustum look from one end each; of other walls that find both edges together, each thread finds both.
    parts: those that are near the wall, as bits.
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
                met, s, other, back = rare_edges(a.wall_numbers, wall, kind, x, axis, half, radius)
                if part == 3:
                    met = other
                    s = back
    return met, s


@func
def part_distance(
    a: System, wall: int, x: wide3, axis: wide3, half: wide, radius: wide, part: int, met: wide, on: wide, other: wide,
    back: wide,
):  # fmt: skip
    """Distance [m] of a part of a rod from a wall, unit normal, and where on the segment it is [m].

    met, on, other, back: what `edges` gave.
    """
    distance, normal, s = wall_part(
        a.wall_numbers, wall, a.wall_kind[wall], x, axis, half, radius, part, met, on, other, back
    )  # fmt: skip
    return distance, normal, s


@func
def edge_distance(a: System, wall: int, part: int, x: wide3):
    """Distance [m] of x from the edge that a part of a rod lies across; 1e9 where a wall has none."""
    return wall_edge(a.wall_numbers, wall, a.wall_kind[wall], x, part)


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
