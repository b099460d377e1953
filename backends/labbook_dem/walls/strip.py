"""A thin plate seen edge on: a segment in the x-z plane, endless along y. A grain rolls over its ends."""

import math

from labbook.scene import Strip
from labbook_dem.words import func, sqrt, wide, wide3


@func
def strip_distance(start: wide3, along: wide3, length: wide, x: wide3):
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


def parameters(shape: Strip) -> tuple[float, ...]:
    """First end (x, z) [m], unit direction (x, z), length [m]."""
    (x, z), (x1, z1) = shape.start, shape.end
    length = math.hypot(x1 - x, z1 - z)
    return x, z, (x1 - x) / length, (z1 - z) / length, length, 0.0
