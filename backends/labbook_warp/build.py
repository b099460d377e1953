"""From features to compiled kernels: one generated module per specialisation; Warp caches what it compiles from it."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from types import ModuleType

import warp as wp
from labbook_dem import contact, features, generated, motion, rotation, segments, source
from labbook_dem import rods as rod_physics
from labbook_dem import spheres as sphere_physics
from labbook_dem.features import WALL_PARTS
from labbook_dem.laws import LAWS
from labbook_dem.walls import frustum, plane, strip

from labbook.backend import Capabilities, Spec, Unsupported
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe
from labbook.scene import Scene
from labbook_warp import dialect
from labbook_warp.codec import Codec
from labbook_warp.kernels import (
    beside,
    bodies,
    double,
    double_rods,
    forces,
    mixed,
    mixed_rods,
    neighbours,
    observe,
    rod_contacts,
    rod_walls,
    rods,
    spheres,
    step,
    sums,
    system,
    walls,
    words,
)

STATE = {
    ("mixed", False): mixed,
    ("double", False): double,
    ("mixed", True): mixed_rods,
    ("double", True): double_rods,
}
PHYSICS = {False: [sphere_physics], True: [sphere_physics, rod_physics, rotation, segments]}
SHAPE = {False: [spheres], True: [rods, rod_walls, rod_contacts]}
OF_WORDS = ("PARKED", "LOOKS", "BAD_STATE", "BAD_SPEED", "BAD_FORCE", "BAD_OVERLAP", "NO_NUMBER", "REPORTED")
REACH = {False: 1, True: 2}
"""How many cells away a neighbour may be: rods have small cells, since most of what is within a length of them is not
listed."""


def most_parts(switches: Mapping[str, int]) -> int:
    """Contacts that a grain may have with one wall."""
    if not switches["RODS"]:
        return 1
    return max([2, *(count for kind, count in WALL_PARTS.items() if switches[f"{kind.upper()}S"])])


def _edges(parts: int) -> int:
    """Bits of the parts that lie across an edge, the third and fourth of each wall, as a signed number of 32 bits."""
    return -0x33333334 if parts == 4 else 0  # 0xCCCCCCCC


def module_text(
    law: str, precision: str, switches: Mapping[str, int], uniform: bool, lanes: int, registers: int, apart: int,
    asked: int,
) -> str:  # fmt: skip
    """Source of the kernel module of one specialisation."""
    turns = bool(switches["RODS"])
    constants: dict[str, object] = dict(switches)
    constants |= {
        "FINE": precision == "double",
        "UNIFORM": uniform,
        "LANES": lanes,
        "SHARED": lanes > 1,
        "APART": bool(apart),
        "ASKED": asked,
        "WORDS": Codec(precision == "mixed", turns).words,
        "WALL_PARTS": most_parts(switches),
        "EDGES": _edges(most_parts(switches)),
        "TORQUES": switches["FRICTION"] or turns,
        "REACH": REACH[turns],
        "COLUMNS": 17 if turns else 13,
    }
    constants |= {name: getattr(words, name) for name in OF_WORDS}
    modules = [LAWS[law], contact, motion, plane, strip, frustum, *PHYSICS[turns], system, STATE[precision, turns]]
    modules += [walls, bodies, sums, *SHAPE[turns], forces, step, neighbours, observe]
    if apart:
        modules.append(beside)
    header = dialect.header(precision, registers, apart, 1 if turns else 16, several=lanes > 1)
    return source.generate(header, constants, modules)


@lru_cache(maxsize=64)
@generated.alone
def kernels(
    law: str, precision: str, switches: tuple[tuple[str, int], ...], uniform: bool = False, lanes: int = 1,
    registers: int = 0, apart: int = 0, asked: int = 0,
) -> ModuleType:  # fmt: skip
    """The kernel module of one specialisation. Compiling happens at first use, per device.

    registers: how many a thread of the step may use, and apart: one that meets walls; 0 leaves it to the compiler, and
    meets walls in the step. asked: for how many entries of lists the step asks beforehand. Only where threads do not
    share grains can walls be met apart, or lists be asked for.
    """
    assert lanes == 1 or not (apart or asked)
    text = module_text(law, precision, dict(switches), uniform, lanes, registers, apart, asked)
    key = generated.digest(text, wp.config.version)
    return generated.load(f"labbook_warp_{key}", text, generated.cache_folder("warp") / key)


MOST_CONTACTS = 32  # bits of a mask


def specialise(capabilities: Capabilities, scene: Scene, numerics: Numerics, probes: Sequence[Probe]) -> Spec:
    """Features compiled in. Raises Unsupported."""
    found = features.specialise(capabilities, scene, numerics, probes)
    walls, most = len(scene.container.walls()), MOST_CONTACTS // most_parts(dict(found.features))
    if walls > most:
        raise Unsupported("container", f"the backend {capabilities.name} takes {most} walls, not {walls}")
    return found
