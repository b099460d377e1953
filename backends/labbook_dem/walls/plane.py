"""Infinite plane; grains are on the side that its normal points to."""

import math

from labbook.scene import Plane
from labbook_dem.words import dot, func, wide, wide3

PARTS = 2


@func
def plane_distance(point: wide3, normal: wide3, x: wide3):
    """Signed distance [m] of x from the plane, and its unit normal."""
    return dot(x - point, normal), normal


@func
def plane_rod(point: wide3, normal: wide3, x: wide3, a: wide3, half: wide, part: int):
    """Distance [m] of an end of a rod from the plane, unit normal, and position on the segment [m].

    x: centre [m]; a: unit axis; half: half the length of the segment [m]. Part 0 is the end at -half, part 1 at +half.
    """
    s = -half if part == 0 else half
    distance = dot(x + a * s - point, normal)
    there = part == 0 or (part == 1 and half > wide(0.0))
    return (distance if there else wide(1e9)), normal, s


def parameters(shape: Plane) -> tuple[float, ...]:
    """Point [m] and unit normal."""
    size = math.hypot(*shape.normal)
    return (*shape.point, *(component / size for component in shape.normal))
