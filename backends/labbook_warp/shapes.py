"""Shapes of grains: their kernels, memory layout and tuning for GPUs."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
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
    """Kernels and layout of a shape. Numbers of registers are those of a thread, by precision; 0: the compiler's
    choice."""

    kernels: tuple[ModuleType, ...]
    """Modules that define the functions of `labbook_warp.kernels.shape`."""
    mesh_kernels: tuple[ModuleType, ...]
    """The same for scenes with a mesh."""
    shared_fields: GrainFields
    """Fields that other threads read."""
    state: Mapping[str, str]
    """Further state arrays; see `labbook_warp.layout.state`."""
    reach: int
    """Cells to the farthest neighbour, along each axis: rods have small cells, since most grains within a length of
    them are not listed."""
    threads: tuple[tuple[int, int], ...]
    """Pairs of rows and threads a grain up to so many rows on a large GPU; one thread beyond. Each part of a rod at a
    wall has a thread of its own, if threads share it."""
    registers: Mapping[str, int]
    """Registers of the step with one thread a grain."""
    registers_of_few: Mapping[str, int]
    """Registers of the step with several threads a grain."""
    registers_of_rims: Mapping[str, int]
    """Further registers if a grain may meet a round wall."""
    registers_of_walls: Mapping[str, int]
    """Registers of the separate kernel of walls, if it saves time; empty: walls are part of the step."""
    registers_of_meshes: Mapping[str, int]
    """The same in scenes with a mesh."""
    bytes: int
    """Bytes that a step moves for a grain, about."""
    prefetch: int
    """Entries of a list to prefetch if lists do not stay in the GPU's cache. (For a rod in double precision, the 32
    lines of a warp hold some four.)"""
    unroll: int
    """Longest loop that is unrolled."""


_SPHERE = Shape(
    kernels=(spheres, sphere_walls),
    mesh_kernels=(spheres, meshes, mesh_walls),
    shared_fields=GrainFields(("x",), ("v", "w", "u"), rounding=True),
    state={},
    reach=1,
    threads=((5_000, 8), (15_000, 4), (42_000, 2)),
    registers={"mixed": 80, "double": 128},
    registers_of_few={"mixed": 96, "double": 0},
    registers_of_rims={"mixed": 0, "double": 8},
    registers_of_walls={},
    registers_of_meshes={"mixed": 128, "double": 168},
    bytes=240,
    prefetch=6,
    unroll=16,
)
SHAPES = {
    "sphere": _SPHERE,
    # rows are its spheres; the clump itself has a state of its own
    "clump": replace(_SPHERE, state={"clump_x": "one", "clump_v": "one", "clump_m": "one", "turned": "one"}, bytes=340),
    "spherocylinder": Shape(
        kernels=(rods, rod_walls, rod_contacts, rod_plates),
        mesh_kernels=(rods, rod_walls, rod_contacts, meshes, rod_meshes),
        shared_fields=GrainFields(("x", "axis"), ("v", "w", "u", "y"), rounding=False),
        state={"facing": "one", "turned": "one", "momentum": "one"},
        reach=2,
        threads=((5_600, 8), (50_000, 4)),
        registers={"mixed": 96, "double": 168},
        registers_of_few={"mixed": 168, "double": 0},
        registers_of_rims={"mixed": 0, "double": 0},
        registers_of_walls={"mixed": 128, "double": 168},
        registers_of_meshes={"mixed": 128, "double": 168},
        bytes=480,
        prefetch=8,
        unroll=1,
    ),
}
"""Shapes by the names of scenes."""
