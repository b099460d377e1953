"""Thin plate seen edge on: a segment in the x-z plane, endless along y. A grain rolls over its ends."""

import math

from labbook.scene import Strip
from labbook_dem.words import func, section, sqrt, wide, wide3

PARTS = 4


@func
def strip_distance(start: section, along: section, length: wide, x: wide3):
    """Distance [m] of x from the nearest point of the segment, and the unit normal from there to x.

    start, along: first end [m] and unit direction, with zero y; length [m].
    """
    zero = wide(0.0)
    dx = x.x - start.x
    dz = x.z - start.z
    at = min(max(dx * along.x + dz * along.z, zero), length)
    rx = dx - along.x * at
    rz = dz - along.z * at
    distance = sqrt(rx * rx + rz * rz)
    inverse = wide(1.0) / distance if distance > zero else zero
    return distance, wide3(rx * inverse, zero, rz * inverse)


@func
def strip_over(start: section, along: section, x: wide3):
    """Coordinate [m] of x along the plate."""
    return (x.x - start.x) * along.x + (x.z - start.z) * along.z


@func
def strip_edge(start: section, along: section, length: wide, x: wide3, part: int):
    """Distance [m] of x from an edge, that at `start` for part 2."""
    edge = start if part == 2 else start + along * length
    distance, _normal = strip_distance(edge, along, wide(0.0), x)
    return distance


@func
def strip_rod(
    start: section, along: section, length: wide, x: wide3, a: wide3, half: wide, radius: wide, part: int
):  # fmt: skip
    """Distance [m] of a part of a rod from the plate, unit normal, and place on the rod's axis from its centre [m].

    The distance is 1e9 m if the part is not there; see `walls`. start, along, length: plate, as in `strip_distance`; x:
    centre of the rod [m]; a: its unit axis; half: half the length of its segment [m]; part: 2 is the edge at `start`.
    """
    zero = wide(0.0)
    nowhere = wide(1e9)
    low, down = strip_distance(start, along, length, x - a * half)
    high, up = strip_distance(start, along, length, x + a * half)
    at_low = strip_over(start, along, x - a * half)
    at_high = strip_over(start, along, x + a * half)
    low_over = at_low >= zero and at_low <= length
    high_over = at_high >= zero and at_high <= length
    # the part of the segment beyond the edge: where `out` + s `slope` <= 0
    start_edge = part == 2
    edge_x = start.x if start_edge else start.x + along.x * length
    edge_z = start.z if start_edge else start.z + along.z * length
    sign = wide(1.0) if start_edge else wide(-1.0)
    slope = sign * (a.x * along.x + a.z * along.z)
    out = sign * ((x.x - edge_x) * along.x + (x.z - edge_z) * along.z)
    leaves = -out / slope if slope != zero else zero
    first = max(leaves, -half) if slope < zero else -half
    last = min(leaves, half) if slope > zero else half
    there = first <= last if slope != zero else out <= zero
    # on it, the point nearest to the edge
    a2 = a.x * a.x + a.z * a.z + wide(2e-7)  # continuous through parallel, as in `labbook_dem.segments`
    nearest = -((x.x - edge_x) * a.x + (x.z - edge_z) * a.z) / a2
    s = min(max(nearest, first), last)
    distance, normal = strip_distance(start, along, length, x + a * s)
    part_of = (s + half) / (half + half) if half > zero else zero
    carried = (wide(1.0) - part_of) * max(radius - low, zero) if low_over else zero
    carried = carried + (part_of * max(radius - high, zero) if high_over else zero)
    distance = distance + carried if there else nowhere
    low = low if low_over else nowhere
    high = high if high_over and half > zero else nowhere
    distance = low if part == 0 else (high if part == 1 else distance)
    s = -half if part == 0 else (half if part == 1 else s)
    normal = down if part == 0 else (up if part == 1 else normal)
    return distance, normal, s


def parameters(shape: Strip) -> tuple[float, ...]:
    """First end (x, z) [m], unit direction (x, z), length [m]."""
    (x, z), (x1, z1) = shape.start, shape.end
    length = math.hypot(x1 - x, z1 - z)
    return x, z, (x1 - x) / length, (z1 - z) / length, length
