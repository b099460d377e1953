"""How large arrays have to be, how many members a device can hold, and which kernels suit them."""

from collections.abc import Collection
from dataclasses import replace
from types import ModuleType

import warp as wp
from labbook_dem.mesh import MESH_CONTACTS
from labbook_dem.shapes import SHAPES as PHYSICS

from labbook.backend import Overflow, Spec
from labbook.backend.probes import Contacts, Crossing, Dissipation
from labbook.scene import Scene
from labbook_warp import devices
from labbook_warp.build import kernels
from labbook_warp.layout import Sizes, memory, shapes
from labbook_warp.parameters import most_cells
from labbook_warp.run import Run
from labbook_warp.shapes import SHAPES
from labbook_warp.spec import most_parts

NEAR, DEPTH = 16, 8  # first guesses of neighbours a grain and grains a cell; both grow when they are too few
MOST_NEAR = 32  # bits of a mask
CACHE = 60_000_000
"""Bytes of what a step moves that stay in a large GPU's second cache, about."""
LARGE = 20_000
"""Rows of a member from which on it pays to close up those of grains that have left."""
SPARE = 8
"""Rows of a member that is fed for each spare one."""
LARGEST_INDEX = 2**31 - 1  # of an array, in kernels
USED = 0.8
"""Part of a device's free memory that members may fill; the rest is for what else goes on there."""


def empty(spec: Spec, slots: int) -> Sizes:
    """Sizes for nobody yet, in at least so many slots."""
    return Sizes(slots, 0, NEAR, 0, 0, DEPTH, most_parts(spec), spec.feature("shape"), spec.feature("LISTED"))


def with_members(sizes: Sizes, seated: int, new: Collection[Run]) -> Sizes:
    """Sizes for `seated` members that fit already, and new ones: of several, the next may be spread over more cells."""
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
    """Sizes with rows for all grains of these members, and for some that come back beside those that have left."""
    rows = max(max(run.rows, run.scene.grains.count) for run in runs)
    return replace(sizes, cap=max(sizes.cap, rounded(rows + rows // SPARE)))


_INSTEAD = "use a thinner numerics.skin, or the backend numba, whose lists are of any length"


def rounded(grains: int) -> int:
    """Rows for so many grains."""
    return max(32, -(-grains // 32) * 32)


def grown(sizes: Sizes, near: int, depth: int, walls: int) -> Sizes:
    """Sizes for lists of `near` neighbours and cells of `depth` grains, where these are not 0.

    Raises Overflow where no lists are that long: for neighbours, and for `walls` that a grain is near, if not 0.
    """
    if walls:
        unite = ", or unite meshes into one part" if sizes.parts == MESH_CONTACTS else ""
        raise Overflow(f"a grain is near {walls} walls, more than {sizes.seats}; use a thinner numerics.skin{unite}")
    if near > MOST_NEAR:
        raise Overflow(f"a grain has {near} near neighbours, more than {MOST_NEAR}; {_INSTEAD}")
    wider = min(MOST_NEAR, near + 4) if near else sizes.near
    return replace(sizes, near=wider, depth=max(sizes.depth, depth + 4 if depth else 0))


def closed_up(sizes: Sizes, runs: Collection[Run]) -> Sizes:
    """Sizes for one large member of which half of the grains have left: a row without a grain costs a part of a step,
    and threads may then share grains. Else as they are."""
    if sizes.slots > 1 or sizes.cap < LARGE:
        return sizes
    cap = max((rounded(run.grains) for run in runs), default=sizes.cap)
    return replace(sizes, cap=cap) if 2 * cap <= sizes.cap else sizes


def suitable(spec: Spec, sizes: Sizes, uniform: bool, lanes: int) -> ModuleType:
    """The kernels for arrays of these sizes. uniform: whether all members have the same material."""
    precision, shape = spec.feature("precision"), SHAPES[sizes.shape]
    assert 2 * lanes <= sizes.near, "each thread asks for its first two neighbours, whether there are any or not"
    many = lanes == 1
    most = shape.registers[precision] if many else shape.registers_of_few[precision]
    if many and "frustum" in spec.feature("walls"):
        most += shape.registers_of_rims[precision]
    # one launch more a step would cost more than it saves where grains are few, or walls are quickly met
    of_walls = shape.registers_of_meshes if spec.feature("MESHES") else shape.registers_of_walls
    apart = of_walls.get(precision, 0) if many and spec.feature("ANY_WALLS") else 0
    far = sizes.rows * shape.bytes > CACHE
    asked = shape.asked if many and far and spec.feature("FRICTION") else 0
    assert not asked or asked + 2 <= sizes.near, "lines are asked for whether lists are as long or not"
    return kernels(spec, uniform, lanes, most, apart=apart, asked=asked)


def lanes(sizes: Sizes, device: wp.Device, asked: int | None) -> int:
    """Threads a grain, a power of two; unless asked for, what is fastest. They decide no bit."""
    if not device.is_cuda:
        return 1
    if asked:
        shared = sizes.parts if PHYSICS[sizes.shape].oriented else 1
        return max(asked, shared) if asked > 1 else 1
    return next((threads for rows, threads in SHAPES[sizes.shape].threads if sizes.rows <= rows), 1)


def records_crossings(spec: Spec) -> bool:
    """Whether rows of crossings are kept."""
    return any(isinstance(probe, Crossing) for probe in spec.probes)


def largest(spec: Spec, scene: Scene) -> Sizes:
    """What one member of a scene may come to need."""
    n = scene.grains.count
    walls, rows = len(scene.container.walls()), n if scene.feed is None else n + n // SPARE
    return replace(empty(spec, 1), cap=rounded(rows), near=MOST_NEAR, walls=walls, cells=most_cells(n), depth=DEPTH + 4)


def capacity(spec: Spec, scene: Scene, device: wp.Device) -> int | None:
    """How many members of a scene the device has memory for, and kernels can index, at least one; None where nothing
    limits them."""
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
