"""Shapes of grains, for all backends."""

from dataclasses import dataclass
from types import ModuleType

from labbook_dem import clumps, rods, rotation, segments, spheres


@dataclass(frozen=True)
class Shape:
    """Formulas of a shape. Backends that compile have its kernels under the same name (`labbook_numba.shapes`,
    `labbook_warp.shapes`), or do not list it among their capabilities.

    Attributes:
        oriented: grains have an orientation.
        physics: modules of its formulas.
    """

    oriented: bool
    physics: tuple[ModuleType, ...]


SHAPES = {
    "sphere": Shape(oriented=False, physics=(spheres,)),
    "spherocylinder": Shape(oriented=True, physics=(spheres, segments, rotation, rods)),
    "clump": Shape(oriented=True, physics=(spheres, rotation, rods, clumps)),
}
"""Shapes by the names of scenes (`labbook.scene.grains`)."""
