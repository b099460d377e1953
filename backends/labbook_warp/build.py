"""From features to compiled kernels: one generated module per specialisation; Warp caches what it compiles from it."""

from functools import lru_cache
from types import ModuleType

import warp as wp
from labbook_dem import contact, dispatch, features, generated, motion, source
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
    shape,
    step,
    sums,
    system,
    traction,
    walls,
    words,
)
from labbook_warp.shapes import SHAPES
from labbook_warp.spec import most_parts

OF_WORDS = ("PARKED", "LOOKS", "BAD_STATE", "BAD_SPEED", "BAD_FORCE", "BAD_OVERLAP", "NO_NUMBER", "REPORTED")


def _edges(parts: int) -> int:
    """Bits of the parts that lie across an edge, the third and fourth of each wall, as a signed number of 32 bits."""
    return -0x33333334 if parts == 4 else 0  # 0xCCCCCCCC


def module_text(spec: Spec, uniform: bool, lanes: int, registers: int, apart: int, asked: int) -> str:
    """Source of the kernel module of one specialisation; see `kernels`."""
    precision, grains, kinds = spec.feature("precision"), spec.feature("shape"), spec.feature("walls")
    own = SHAPES[grains]
    hold(f"the shape {grains} in labbook_warp", shape, own.kernels)
    codec, parts, turns = Codec(precision == "mixed", own.shown), most_parts(spec), spec.feature("ORIENTED")
    together = [kind for kind in kinds if dispatch.finds_edges_together(kind)]
    named: dict[str, object] = {
        **features.constants(spec),
        "FINE": precision == "double",
        "UNIFORM": uniform,
        "LANES": lanes,
        "SHARED": lanes > 1,
        "APART": bool(apart),
        "ASKED": asked,
        "WORDS": codec.words,
        "WALL_PARTS": parts,
        "WALL_NUMBERS": max(map(dispatch.how_many, kinds), default=1),
        "LISTED": spec.feature("LISTED"),
        "TOGETHER": bool(together),
        "OTHERS_TOGETHER": bool(set(together) - {"frustum"}),
        "FRUSTUM": number("frustum"),
        "EDGES": _edges(parts),
        "TORQUES": spec.feature("FRICTION") or turns,
        "REACH": own.reach,
        "COLUMNS": 17 if turns else 13,
    }
    named |= {name: getattr(words, name) for name in OF_WORDS}
    # the formulas of frustums are there for `rod_walls`, whether a scene has one or not
    physics = [WALLS[kind] for kind in dict.fromkeys((*kinds, *(("frustum",) if turns else ())))]
    physics = [contact, *modules_of(str(spec.feature("law"))), motion, *physics, *PHYSICS[grains].physics]
    modules = [
        system,
        kernel_text(codec),
        walls,
        dispatch.functions(kinds, turns, "load_wide(walls, w * WALL_NUMBERS + {k})"),
    ]
    modules += [bodies, sums, *own.kernels, forces, step, neighbours, observe, *([beside] if apart else [])]
    if any(isinstance(probe, Traction) for probe in spec.probes):
        physics, modules = [*physics, traction_sums], [*modules, traction]
        named.update(SUMS=traction_sums.SUMS, WALL_COLUMNS=traction_sums.WALL_COLUMNS)
    header = dialect.header(precision, registers, apart, own.unroll, several=lanes > 1)
    return source.generate(header, named, physics, modules)


@lru_cache(maxsize=64)
@generated.alone
def kernels(
    spec: Spec, uniform: bool = False, lanes: int = 1, registers: int = 0, apart: int = 0, asked: int = 0
) -> ModuleType:  # fmt: skip
    """The kernel module of one specialisation. Compiling happens at first use, per device.

    registers: how many a thread of the step may use, and apart: one that meets walls; 0 leaves it to the compiler, and
    meets walls in the step. asked: for how many entries of lists the step asks beforehand. Only where threads do not
    share grains can walls be met apart, or lists be asked for.
    """
    assert lanes == 1 or not (apart or asked)
    text = module_text(spec, uniform, lanes, registers, apart, asked)
    key = generated.digest(text, wp.config.version)
    return generated.load(f"labbook_warp_{key}", text, generated.cache_folder("warp") / key)
