"""Sizes of arrays, capacity of a device, and the kernels that suit both."""

from collections.abc import Collection
from dataclasses import replace
from types import ModuleType

import warp as wp
from labbook_dem.clump_rows import rows_of_grain
from labbook_dem.mesh import MESH_CONTACTS

from labbook.backend import Overflow, Spec
from labbook.backend.probes import Contacts, Dissipation
from labbook.scene import Scene
from labbook_warp import devices
from labbook_warp.build import kernels
from labbook_warp.layout import Sizes, memory, shapes
from labbook_warp.parameters import max_cells
from labbook_warp.run import Run
from labbook_warp.shapes import SHAPES
from labbook_warp.spec import most_parts

NEAR, DEPTH = 16, 8  # initial capacities: neighbours a grain, grains a cell; both grow after an overflow
MOST_NEAR = 32  # bits of a mask
CACHE = 60_000_000
"""Bytes a step moves that stay in the second-level cache of a large GPU, about."""
LARGE = 20_000
"""Rows of a member from which on closing up the rows of grains that have left saves time."""
SPARE = 8
"""Rows of a fed member for each spare one."""
LARGEST_INDEX = 2**31 - 1  # indices of arrays in kernels are signed, of 32 bits
USED = 0.8
"""Part of a device's free memory that members may fill; the rest is for other allocations."""


def empty(spec: Spec, slots: int) -> Sizes:
    """Sizes without members, for at least `slots` slots."""
    return Sizes(slots, 0, NEAR, 0, 0, DEPTH, most_parts(spec), spec.feature("shape"), spec.feature("LISTED"))


def with_members(sizes: Sizes, seated: int, new: Collection[Run]) -> Sizes:
    """Sizes for new members beside `seated` ones that fit already.

    With several slots some cells are spare, since later members may spread over more.
    """
    cells = max(run.cells for run in new)
    return replace(
        sizes,
        slots=max(sizes.slots, seated + len(new)),
        cap=max(sizes.cap, *(rounded(run.rows) for run in new)),
        near=max(sizes.near, *(run.near for run in new)),
        walls=max(sizes.walls, *(len(run.names) for run in new)),
        cells=sizes.cells if cells <= sizes.cells else cells + (cells // 8 if sizes.slots > 1 else 0),
    )


def with_spare_rows(sizes: Sizes, runs: Collection[Run]) -> Sizes:
    """Sizes with rows for all grains of these members, and for some that return beside those that have left."""
    rows = max(max(run.rows, run.scene.grains.count * run.per_grain) for run in runs)
    return replace(sizes, cap=max(sizes.cap, rounded(rows + rows // SPARE)))


_INSTEAD = "use a thinner numerics.skin, or the backend numba, whose lists are of any length"


def rounded(grains: int) -> int:
    """Number of rows for this many grains: a multiple of 32."""
    return max(32, -(-grains // 32) * 32)


def grown(sizes: Sizes, near: int, depth: int, walls: int) -> Sizes:
    """Sizes with room for longer lists.

    Args:
        sizes: present sizes.
        near: needed neighbours a grain, 0 if they fit.
        depth: needed grains a cell, 0 if they fit.
        walls: needed walls a grain, 0 if they fit.

    Raises:
        Overflow: lists of walls or of neighbours cannot be that long.
    """
    if walls:
        unite = ", or unite meshes into one part" if sizes.parts == MESH_CONTACTS else ""
        raise Overflow(f"a grain is near {walls} walls, more than {sizes.seats}; use a thinner numerics.skin{unite}")
    if near > MOST_NEAR:
        raise Overflow(f"a grain has {near} near neighbours, more than {MOST_NEAR}; {_INSTEAD}")
    wider = min(MOST_NEAR, near + 4) if near else sizes.near
    return replace(sizes, near=wider, depth=max(sizes.depth, depth + 4 if depth else 0))


def closed_up(sizes: Sizes, runs: Collection[Run]) -> Sizes:
    """Sizes without empty rows, for a single large member of which half of the grains have left; else `sizes`.

    A row without a grain costs a part of a step, and with few rows threads may share grains.
    """
    if sizes.slots > 1 or sizes.cap < LARGE:
        return sizes
    cap = max((rounded(run.rows - run.left) for run in runs), default=sizes.cap)
    return replace(sizes, cap=cap) if 2 * cap <= sizes.cap else sizes


def suitable(spec: Spec, sizes: Sizes, uniform: bool, lanes: int) -> ModuleType:
    """Kernel module for arrays of these sizes.

    Args:
        spec: features.
        sizes: sizes of the arrays.
        uniform: all members have the same material.
        lanes: threads a grain.
    """
    precision, shape = spec.feature("precision"), SHAPES[sizes.shape]
    assert 2 * lanes <= sizes.near, "each thread asks for its first two neighbours, whether there are any or not"
    one_lane = lanes == 1
    registers = shape.registers[precision] if one_lane else shape.registers_of_few[precision]
    if one_lane and "frustum" in spec.feature("walls"):
        registers += shape.registers_of_rims[precision]
    # with few grains, or cheap contacts with walls, a second launch a step costs more than it saves
    wall_registers = shape.registers_of_meshes if spec.feature("MESHES") else shape.registers_of_walls
    apart = wall_registers.get(precision, 0) if one_lane and spec.feature("ANY_WALLS") else 0
    uncached = sizes.rows * shape.bytes > CACHE
    prefetched = shape.prefetch if one_lane and uncached and spec.feature("FRICTION") else 0
    assert not prefetched or prefetched + 2 <= sizes.near, "lines are asked for whether lists are as long or not"
    return kernels(spec, uniform, lanes, registers, apart=apart, prefetch=prefetched)


def lanes(sizes: Sizes, device: wp.Device, requested: int | None) -> int:
    """Threads a grain, a power of two: the requested number, or the fastest. It decides no bit.

    Threads that share a rod are at least as many as its parts: each part at a wall has its own.
    """
    if not device.is_cuda:
        return 1
    if requested:
        shared = sizes.parts if sizes.shape == "spherocylinder" else 1
        return max(requested, shared) if requested > 1 else 1
    return next((threads for rows, threads in SHAPES[sizes.shape].threads if sizes.rows <= rows), 1)


def records_crossings(spec: Spec) -> bool:
    """True if kernels record crossings, whether a probe reads them or not."""
    return bool(spec.feature("CROSSING"))


def largest(spec: Spec, scene: Scene) -> Sizes:
    """Largest sizes that one member of a scene may need."""
    n = scene.grains.count * rows_of_grain(scene)
    walls, rows = len(scene.container.walls()), n if scene.feed is None else n + n // SPARE
    return replace(empty(spec, 1), cap=rounded(rows), near=MOST_NEAR, walls=walls, cells=max_cells(n), depth=DEPTH + 4)


def capacity(spec: Spec, scene: Scene, device: wp.Device) -> int | None:
    """Number of members of a scene that fit into the free memory and the indices of kernels, at least 1.

    None on a device without a limit.
    """
    free = devices.free(device)
    if free is None:
        return None
    sizes = largest(spec, scene)
    module = suitable(spec, sizes, False, 1)
    reading = 80 * sizes.contacts if any(isinstance(probe, Contacts | Dissipation) for probe in spec.probes) else 0
    crossings = records_crossings(spec)
    slot = memory(module, sizes, crossings) + reading + 48 * sizes.rows
    indexed = LARGEST_INDEX // max(shape.length for shape in shapes(module, sizes, crossings))
    return max(1, min(int(USED * free / slot), indexed))
