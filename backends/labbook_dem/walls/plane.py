"""An infinite plane; grains are on the side that its normal points to."""

import math

from labbook.scene import Plane
from labbook_dem.words import dot, func, wide3


@func
def plane_distance(point: wide3, normal: wide3, x: wide3):
    """Signed distance [m] of x from the plane, and its unit normal."""
    return dot(x - point, normal), normal


def parameters(shape: Plane) -> tuple[float, ...]:
    """Point [m] and unit normal."""
    size = math.hypot(*shape.normal)
    return (*shape.point, *(component / size for component in shape.normal))
