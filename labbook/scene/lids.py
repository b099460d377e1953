"""Openings under lids: form and size of the outlets of containers of single walls."""

import math
from collections.abc import Iterable
from typing import Literal, NamedTuple

import numpy as np

from labbook.scene.mesh import TriangleMesh
from labbook.scene.wall_shape import WallShape
from labbook.scene.walls import Frustum, Plane, Strip, Wall

_FULL = 1e-3
"""Part of its bounding box that a rectangle may lack, and of the depth of a container that a slot may."""


class OutletForm(NamedTuple):
    """Opening that a lid covers.

    Attributes:
        form: A slot from the front to the back wall, or a hole; None of any other.
        width: Width of a slot; diameter of a hole, or of a circle of its area [m]. NaN if it is unknown.
        centre: x of its middle [m].
    """

    form: Literal["slot", "hole"] | None = None
    width: float = math.nan
    centre: float = 0.0


def opening(lid: WallShape, depth: float) -> OutletForm:
    """Describe the opening that a lid covers, as seen from above.

    Args:
        lid: A strip, a frustum or a mesh.
        depth: Distance of front and back wall [m]; NaN without these.

    Returns:
        Slot under a strip, or under a rectangle of triangles from the front to the back wall. Hole under a frustum
        without a hole of its own, or under any other mesh.
    """
    if isinstance(lid, Strip):
        (left, _), (right, _) = lid.start, lid.end
        return OutletForm("slot", abs(right - left), (left + right) / 2)
    if isinstance(lid, Frustum) and lid.lower[0] == 0:
        return OutletForm("hole", 2 * lid.upper[0])
    if isinstance(lid, TriangleMesh):
        area, (wide, deep, _) = _area_from_above(lid), lid.bounds.size
        middle = (lid.bounds.low[0] + lid.bounds.high[0]) / 2
        if deep >= depth * (1 - _FULL) and area >= wide * deep * (1 - _FULL):
            return OutletForm("slot", wide, middle)
        return OutletForm("hole", math.sqrt(4 * area / math.pi), middle)
    return OutletForm()


def depth_between(walls: Iterable[Wall]) -> float:
    """Distance [m] of the innermost planes y = const that face each other; NaN without two."""
    front, back = -math.inf, math.inf
    for shape in (wall.shape for wall in walls):
        if isinstance(shape, Plane) and shape.normal[0] == shape.normal[2] == 0:
            if shape.normal[1] > 0:
                front = max(front, shape.point[1])
            else:
                back = min(back, shape.point[1])
    return back - front if math.isfinite(back - front) else math.nan


def _area_from_above(mesh: TriangleMesh) -> float:
    """Area [m^2] of the shadow of a plate of triangles, thin or closed."""
    a, b, c = (mesh.surface.corner_positions[:, k, :2] for k in range(3))
    (ux, uy), (vx, vy) = (b - a).T, (c - a).T
    total = float(np.abs(ux * vy - uy * vx).sum() / 2)
    return total / 2 if mesh.surface.closed else total
