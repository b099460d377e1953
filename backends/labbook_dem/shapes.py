"""Shapes of grains: what they are to kernels, whichever backend steps them."""

from dataclasses import dataclass
from types import ModuleType

from labbook_dem import rods, rotation, segments, spheres


@dataclass(frozen=True)
class Shape:
    """One shape. oriented: whether its grains have an orientation, which turns; physics: modules of its formulas.

    A backend has, by the same name, the kernels of a shape (`labbook_numba.shapes`, `labbook_warp.shapes`)."""

    oriented: bool
    physics: tuple[ModuleType, ...]


SHAPES = {
    "sphere": Shape(oriented=False, physics=(spheres,)),
    "spherocylinder": Shape(oriented=True, physics=(spheres, segments, rotation, rods)),
}
"""Shapes by the names that scenes know (`labbook.scene.grains`)."""
