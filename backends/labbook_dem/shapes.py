"""Shapes of grains, for all backends."""

from dataclasses import dataclass
from types import ModuleType

from labbook_dem import rods, rotation, segments, spheres


@dataclass(frozen=True)
class Shape:
    """Formulas of a shape. Backends have its kernels under the same name (`labbook_numba.shapes`,
    `labbook_warp.shapes`).

    Attributes:
        oriented: grains have an orientation.
        physics: modules of its formulas.
    """

    oriented: bool
    physics: tuple[ModuleType, ...]


SHAPES = {
    "sphere": Shape(oriented=False, physics=(spheres,)),
    "spherocylinder": Shape(oriented=True, physics=(spheres, segments, rotation, rods)),
}
"""Shapes by the names of scenes (`labbook.scene.grains`)."""
