"""How large arrays have to be, how many members a device can hold, and which kernels suit them."""

from collections.abc import Collection
from dataclasses import replace
from types import ModuleType

import warp as wp
from labbook_dem.features import switches

from labbook.backend import Overflow, Spec
from labbook.backend.probes import Contacts, Crossing
from labbook.scene import Scene
from labbook_warp import devices
from labbook_warp.build import kernels, most_parts
from labbook_warp.layout import Sizes, memory
from labbook_warp.parameters import most_cells
from labbook_warp.run import Run

NEAR, DEPTH = 16, 8  # first guesses of neighbours a grain and grains a cell; both grow when they are too few
MOST_NEAR = 32  # bits of a mask
THREADS = {False: ((5_000, 8), (15_000, 4), (42_000, 2)), True: ((5_600, 8), (50_000, 4))}
"""Threads a sphere or a rod up to so many grains on a large GPU, and one where there are more. Each part of a rod that
may touch a wall has a thread of its own, where threads share it."""
REGISTERS = {"mixed": 80, "double": 128}
REGISTERS_OF_RODS = {"mixed": 96, "double": 168}
"""A thread of the step, where grains are many."""
REGISTERS_OF_FEW = {False: {"mixed": 96, "double": 0}, True: {"mixed": 168, "double": 0}}
"""The same where threads share spheres or rods; 0 is as many as the compiler likes."""
WALLS_OF_RODS = {"mixed": 128, "double": 168}
"""A thread that meets walls, where these have a kernel of their own."""
ROUND_WALLS = {"mixed": 0, "double": 8}
"""Registers more of a sphere that may meet one."""
BYTES, CACHE = {False: 240, True: 480}, 60_000_000
"""What a step moves for a grain, a sphere or a rod, and what a large GPU's second cache holds of it, about."""
ASKED = {False: 4, True: 8}
"""Entries of a list that are asked for beforehand, where lists do not stay in that cache: of a sphere, or a rod (in
double as many as 32 lines hold, some four)."""
USED = 0.8
"""Part of a device's free memory that members may fill; the rest is for what else goes on there."""


def empty(spec: Spec, slots: int) -> Sizes:
    """Sizes for nobody yet, in at least so many slots."""
    return Sizes(slots, 0, NEAR, 0, 0, DEPTH, most_parts(dict(spec.features)))


def with_members(sizes: Sizes, seated: int, new: Collection[Run]) -> Sizes:
    """Sizes for `seated` members that fit already, and new ones."""
    return replace(
        sizes,
        slots=max(sizes.slots, seated + len(new)),
        cap=max(sizes.cap, *(_rounded(run.rows) for run in new)),
        near=max(sizes.near, *(run.near for run in new)),
        walls=max(sizes.walls, *(len(run.names) for run in new)),
        cells=max(sizes.cells, *(run.cells for run in new)),
    )


def _rounded(grains: int) -> int:
    return max(32, -(-grains // 32) * 32)


def grown(sizes: Sizes, near: int, depth: int) -> Sizes:
    """Sizes for lists of `near` neighbours and cells of `depth` grains, where these are not 0. Raises Overflow."""
    if near > MOST_NEAR:
        raise Overflow(f"a grain has {near} near neighbours, more than {MOST_NEAR}; use a thinner numerics.skin")
    wider = min(MOST_NEAR, near + 4) if near else sizes.near
    return replace(sizes, near=wider, depth=max(sizes.depth, depth + 4 if depth else 0))


def suitable(spec: Spec, sizes: Sizes, uniform: bool, lanes: int) -> ModuleType:
    """The kernels for arrays of these sizes. uniform: whether all members have the same material."""
    law, precision = spec.feature("law"), spec.feature("precision")
    assert 2 * lanes <= sizes.near, "each thread asks for its first two neighbours, whether there are any or not"
    many = lanes == 1
    if not many:
        most = REGISTERS_OF_FEW[sizes.rods][precision]
    elif sizes.rods:
        most = REGISTERS_OF_RODS[precision]
    else:
        most = REGISTERS[precision] + ROUND_WALLS[precision] * spec.feature("FRUSTUMS")
    # one launch more a step would cost more than it saves where grains are few, or walls are quickly met
    apart = WALLS_OF_RODS[precision] if many and sizes.rods and spec.feature("ANY_WALLS") else 0
    far = sizes.rows * BYTES[sizes.rods] > CACHE
    asked = ASKED[sizes.rods] if many and far and spec.feature("FRICTION") else 0
    assert not asked or asked + 2 <= sizes.near, "lines are asked for whether lists are as long or not"
    return kernels(law, precision, switches(spec), uniform, lanes, most, apart=apart, asked=asked)


def lanes(sizes: Sizes, device: wp.Device, asked: int | None) -> int:
    """Threads a grain, a power of two; unless asked for, what is fastest. They decide no bit."""
    if not device.is_cuda:
        return 1
    if asked:
        return max(asked, sizes.parts) if asked > 1 else 1
    return next((threads for rows, threads in THREADS[sizes.rods] if sizes.rows <= rows), 1)


def records_crossings(spec: Spec) -> bool:
    """Whether rows of crossings are kept."""
    return any(isinstance(probe, Crossing) for probe in spec.probes)


def largest(spec: Spec, scene: Scene) -> Sizes:
    """What one member of a scene may come to need."""
    n = scene.grains.count
    walls = len(scene.container.walls())
    return Sizes(1, _rounded(n), MOST_NEAR, walls, most_cells(n), DEPTH + 4, most_parts(dict(spec.features)))


def capacity(spec: Spec, scene: Scene, device: wp.Device) -> int | None:
    """How many members of a scene the device has memory for, at least one; None where nothing limits them."""
    free = devices.free(device)
    if free is None:
        return None
    sizes = largest(spec, scene)
    module = suitable(spec, sizes, False, 1)
    reading = 80 * sizes.contacts if any(isinstance(probe, Contacts) for probe in spec.probes) else 0
    slot = memory(module, sizes, records_crossings(spec)) + reading + 48 * sizes.rows
    return max(1, int(USED * free / slot))
