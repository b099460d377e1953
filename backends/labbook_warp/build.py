"""From features to compiled kernels: one generated module per specialisation; Warp caches what it compiles from it."""

from functools import lru_cache
from types import ModuleType

import warp as wp
from labbook_dem import contact, generated, motion, source, spheres
from labbook_dem.describe import LAWS
from labbook_dem.walls import plane, strip

from labbook_warp import dialect
from labbook_warp.kernels import (
    bodies,
    contacts,
    double,
    forces,
    mixed,
    neighbours,
    observe,
    step,
    system,
    walls,
    words,
)

SWITCHES = (
    "FRICTION",
    "ROLLING",
    "VARIED",
    "KINDS",
    "TWIST",
    "MOVING",
    "PLANES",
    "STRIPS",
    "OUTLET",
    "CROSSING",
    "LEDGER",
    "ANY_WALLS",
)
STATE = {"mixed": mixed, "double": double}
WORDS = {"mixed": 4, "double": 6}


def module_text(
    law: str, precision: str, switches: dict[str, int], uniform: bool, lanes: int, registers: int
) -> str:  # fmt: skip
    """Source of the kernel module of one specialisation."""
    constants: dict[str, object] = dict(switches)
    constants |= {
        "FINE": precision == "double",
        "UNIFORM": uniform,
        "LANES": lanes,
        "SHARED": lanes > 1,
    }
    constants |= {name: getattr(words, name) for name in ("PARKED", "BAD_STATE", "BAD_SPEED", "BAD_OVERLAP")}
    modules = [LAWS[law], contact, motion, plane, strip, spheres, system, STATE[precision]]
    modules += [walls, bodies, contacts, forces, step, neighbours, observe]
    return source.generate(dialect.header(precision, registers), constants, modules)


@lru_cache(maxsize=64)
def kernels(
    law: str, precision: str, switches: tuple[tuple[str, int], ...], uniform: bool = False, lanes: int = 1,
    registers: int = 0,
) -> ModuleType:  # fmt: skip
    """The kernel module of one specialisation. Compiling happens at first use, per device."""
    text = module_text(law, precision, dict(switches), uniform, lanes, registers)
    key = generated.digest(text, wp.config.version)
    return generated.load(f"labbook_warp_{key}", text, generated.cache_folder("warp") / key)
