"""Which kernels a shape of grains has, how it lies in memory, and what suits it on a GPU."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import ModuleType

from labbook_warp.codec import GrainFields
from labbook_warp.kernels import (
    mesh_walls,
    meshes,
    rod_contacts,
    rod_meshes,
    rod_plates,
    rod_walls,
    rods,
    sphere_walls,
    spheres,
)


@dataclass(frozen=True)
class Shape:
    """One shape. Numbers of registers are those of a thread, by precision; 0 leaves them to the compiler."""

    kernels: tuple[ModuleType, ...]
    """The modules that define what `labbook_warp.kernels.shape` lists."""
    mesh_kernels: tuple[ModuleType, ...]
    """The same for scenes with a mesh."""
    shown: GrainFields
    state: Mapping[str, str]
    """Arrays of its state beside those that all shapes have; see `labbook_warp.layout.state`."""
    reach: int
    """How many cells away a neighbour may be: rods have small cells, since most of what is within a length of them is
    not listed."""
    threads: tuple[tuple[int, int], ...]
    """Threads a grain up to so many grains on a large GPU, and one where there are more. Each part of a rod that may
    touch a wall has a thread of its own, where threads share it."""
    registers: Mapping[str, int]
    """Of the step, where grains are many."""
    registers_of_few: Mapping[str, int]
    """The same where threads share grains."""
    registers_of_rims: Mapping[str, int]
    """How many more, where a grain may meet a wall that is round."""
    registers_of_walls: Mapping[str, int]
    """Of a kernel that meets walls apart from the step, where that pays; none: walls are met in the step."""
    registers_of_meshes: Mapping[str, int]
    """The same in scenes with a mesh."""
    bytes: int
    """What a step moves for a grain, about."""
    asked: int
    """Entries of a list that are asked for beforehand, where lists do not stay in the GPU's cache. (Of a rod in double
    as many as 32 lines hold, some four.)"""
    unroll: int
    """Loops that are longer are compiled as loops."""


SHAPES = {
    "sphere": Shape(
        kernels=(spheres, sphere_walls),
        mesh_kernels=(spheres, meshes, mesh_walls),
        shown=GrainFields(("x",), ("v", "w", "u"), rest=True),
        state={},
        reach=1,
        threads=((5_000, 8), (15_000, 4), (42_000, 2)),
        registers={"mixed": 80, "double": 128},
        registers_of_few={"mixed": 96, "double": 0},
        registers_of_rims={"mixed": 0, "double": 8},
        registers_of_walls={},
        registers_of_meshes={"mixed": 128, "double": 168},
        bytes=240,
        asked=6,
        unroll=16,
    ),
    "spherocylinder": Shape(
        kernels=(rods, rod_walls, rod_contacts, rod_plates),
        mesh_kernels=(rods, rod_walls, rod_contacts, meshes, rod_meshes),
        shown=GrainFields(("x", "axis"), ("v", "w", "u", "y"), rest=False),
        state={"facing": "one", "turned": "one", "momentum": "one"},
        reach=2,
        threads=((5_600, 8), (50_000, 4)),
        registers={"mixed": 96, "double": 168},
        registers_of_few={"mixed": 168, "double": 0},
        registers_of_rims={"mixed": 0, "double": 0},
        registers_of_walls={"mixed": 128, "double": 168},
        registers_of_meshes={"mixed": 128, "double": 168},
        bytes=480,
        asked=8,
        unroll=1,
    ),
}
"""Shapes by the names that scenes know."""
