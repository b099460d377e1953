"""Shapes of grains: kernels and memory layout."""

from types import ModuleType
from typing import NamedTuple

from labbook_numba.kernels import (
    clumps,
    move,
    rod_observe,
    rod_pairs,
    rod_walls,
    rods,
    sphere_lists,
    sphere_observe,
    sphere_pairs,
    sphere_walls,
    spheres,
)
from labbook_numba.state import LAYOUTS, Layout


class Shape(NamedTuple):
    """Kernels of a shape.

    Attributes:
        layout: layout of equal grains.
        kernels: modules that define the functions of `labbook_numba.kernels.shape`.
    """

    layout: Layout
    kernels: tuple[ModuleType, ...]


SHAPES = {
    "sphere": Shape(LAYOUTS["sphere"], (sphere_lists, sphere_pairs, sphere_walls, spheres, move, sphere_observe)),
    "spherocylinder": Shape(LAYOUTS["spherocylinder"], (rod_pairs, rod_walls, rods, move, rod_observe)),
    "clump": Shape(LAYOUTS["clump"], (sphere_lists, sphere_pairs, sphere_walls, clumps, sphere_observe)),
}
"""Shapes by the names of scenes."""
