"""From features to compiled kernels: one generated module a specialisation, which Warp compiles and caches."""

import re
from collections.abc import Iterator
from functools import lru_cache
from types import ModuleType

import warp as wp
from labbook_dem import contact, dispatch, features, generated, mesh, mesh_rods, motion, poses, source
from labbook_dem import traction as traction_sums
from labbook_dem.formulas import hold
from labbook_dem.laws import modules_of
from labbook_dem.shapes import SHAPES as PHYSICS
from labbook_dem.walls import WALLS, number

from labbook.backend import Spec
from labbook.backend.probes import Traction
from labbook_warp import dialect
from labbook_warp.codec import Codec, kernel_text
from labbook_warp.kernels import (
    beside,
    bodies,
    forces,
    neighbours,
    observe,
    parts,
    shape,
    step,
    sums,
    system,
    traction,
    walls,
    words,
)
from labbook_warp.shapes import SHAPES
from labbook_warp.spec import most_parts, plate_parts

OF_WORDS = ("PARKED", "LOOKS", "BAD_STATE", "BAD_SPEED", "BAD_FORCE", "BAD_OVERLAP", "NO_NUMBER", "REPORTED")
_UNROLL_OF_MESHES = 4  # loops over places of springs stay loops
OF_MESHES = ("CROWDED", "MESH_LISTED", "FIRST_PARTS", "MESH_NUMBER")


def _edges(parts: int) -> int:
    """Mask of the parts that lie across an edge, the third and fourth of each wall, as a signed number of 32 bits."""
    return -0x33333334 if parts == 4 else 0  # 0xCCCCCCCC


def _system_text(meshes: bool) -> str:
    """Source of `kernels.system`, without the arrays of meshes if a scene has none."""
    text = source.device_source(system)
    if not meshes:
        text = re.sub(r"    # of scenes with a mesh only.*?\n\n", "\n", text, flags=re.DOTALL)
    return f"# {system.__name__}\n{text}"


_CALLED = (
    r"@(func|kernel)\n(?=def mesh_(away|between|cell|contacts|listed|merged|near|normal|springs|within|rod_\w+)\()"
)
"""Functions of meshes that are called and not inlined, so that they give the same bits in every kernel."""


def _mesh_texts(rods: bool, poses_too: bool) -> Iterator[str]:
    """Sources of formulas of meshes, with the types of Warp's arrays."""
    for module in (mesh, *([mesh_rods] if rods else [])):
        text = re.sub(_CALLED, "@subroutine\n", source.device_source(module))
        text = text.replace("near: np.ndarray", "near: Ints").replace("np.ndarray", "Table")
        yield f"# {module.__name__}\n{text}"
    if poses_too:
        text = source.device_source(poses).replace("@func\n", "@subroutine\n").replace("np.ndarray", "Tables")
        yield f"# {poses.__name__}\n{text}"


def module_text(spec: Spec, uniform: bool, lanes: int, registers: int, apart: int, prefetch: int) -> str:
    """Source of the kernel module of one specialisation; see `kernels`."""
    precision, grains, kinds = spec.feature("precision"), spec.feature("shape"), spec.feature("walls")
    own, meshes, moves = SHAPES[grains], bool(spec.feature("MESHES")), bool(spec.feature("POSES"))
    of_shape = own.mesh_kernels if meshes else own.kernels
    hold(f"the shape {grains} in labbook_warp", shape, of_shape)
    codec, entries, turns = Codec(precision == "mixed", own.shared_fields), most_parts(spec), spec.feature("ORIENTED")
    together = [kind for kind in kinds if dispatch.finds_edges_together(kind)]
    constants: dict[str, object] = {
        **features.constants(spec),
        "FINE": precision == "double",
        "UNIFORM": uniform,
        "LANES": lanes,
        "SHARED": lanes > 1,
        "APART": bool(apart),
        "PREFETCH": prefetch,
        "WORDS": codec.words,
        "WALL_PARTS": entries,
        **({"PLATE_PARTS": plate_parts(spec)} if turns else {}),
        "WALL_NUMBERS": max(map(dispatch.how_many, kinds), default=1),
        "LISTED": spec.feature("LISTED"),
        "TOGETHER": bool(together),
        "OTHERS_TOGETHER": bool(set(together) - {"frustum"}),
        "FRUSTUM": number("frustum"),
        "EDGES": _edges(entries),
        "TORQUES": spec.feature("FRICTION") or turns,
        "REACH": own.reach,
        "COLUMNS": 17 if turns else 13,
    }
    constants |= {name: getattr(words, name) for name in OF_WORDS}
    # the formulas of frustums are there for `rod_walls`, whether a scene has one or not
    physics = [WALLS[kind] for kind in dict.fromkeys((*kinds, *(("frustum",) if turns else ())))]
    physics = [contact, *modules_of(str(spec.feature("law"))), motion, *physics, *PHYSICS[grains].physics]
    modules = [
        _system_text(meshes),
        *(_mesh_texts(turns, moves) if meshes else []),
        *([parts] if moves else []),
        kernel_text(codec),
        walls,
        dispatch.functions(kinds, turns, "load_wide(walls, w * WALL_NUMBERS + {k})"),
    ]
    modules += [bodies, sums, *of_shape, forces, step, neighbours, observe, *([beside] if apart else [])]
    if any(isinstance(probe, Traction) for probe in spec.probes):
        physics, modules = [*physics, traction_sums], [*modules, traction]
        constants.update(SUMS=traction_sums.SUMS, WALL_COLUMNS=traction_sums.WALL_COLUMNS)
    unroll = min(own.unroll, _UNROLL_OF_MESHES) if meshes else own.unroll
    if meshes:
        numbers = source.named_numbers([mesh, mesh_rods, *of_shape])
        for name, value in (numbers | {name: getattr(words, name) for name in OF_MESHES}).items():
            constants.setdefault(name, value)
    header = dialect.header(precision, registers, apart, unroll, several=lanes > 1, meshes=meshes)
    text = source.generate(header, constants, physics, modules)
    # kernels of scenes without parts that move have the text that they would have if no part could
    return text if moves else source.without(text, "POSES")


@lru_cache(maxsize=64)
@generated.alone
def kernels(
    spec: Spec, uniform: bool = False, lanes: int = 1, registers: int = 0, apart: int = 0, prefetch: int = 0
) -> ModuleType:  # fmt: skip
    """Import the kernel module of one specialisation, which is compiled at first use on a device.

    Args:
        spec: features.
        uniform: all members have the same material.
        lanes: threads that share a grain.
        registers: cap for a thread of the step; 0: the compiler's choice.
        apart: cap for a thread of a separate kernel of walls; 0: walls are part of the step. For one thread a grain.
        prefetch: entries of lists that the step prefetches. For one thread a grain.
    """
    assert lanes == 1 or not (apart or prefetch)
    text = module_text(spec, uniform, lanes, registers, apart, prefetch)
    key = generated.digest(text, wp.config.version)
    return generated.load(f"labbook_warp_{key}", text, generated.cache_folder("warp") / key)
