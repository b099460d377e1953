"""Which arrays an ensemble has, how long they are, and what they come to in bytes."""

from collections.abc import Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import warp as wp

from labbook_warp.codec import Codec


@dataclass(frozen=True)
class Sizes:
    """What arrays are made for; see `labbook_warp.kernels.system`."""

    slots: int
    cap: int
    near: int
    walls: int
    cells: int
    depth: int
    parts: int

    @property
    def rods(self) -> bool:
        """Whether grains have an orientation."""
        return self.parts > 1

    @property
    def rows(self) -> int:
        """Rows of all slots."""
        return self.slots * self.cap

    @property
    def entries(self) -> dict[str, int]:
        """How many entries a grain the kinds of arrays below have."""
        return {"one": 1, "near": self.near, "walls": max(self.walls, 1) * self.parts}

    @property
    def contacts(self) -> int:
        """Rows of contacts for which there is room."""
        return self.rows * (self.near // 2 + min(self.walls * self.parts, 6)) + 1


def state(rods: bool, varied: bool) -> dict[str, str]:
    """Arrays that make up a member's state, beside its words, and which of `Sizes.entries` each has."""
    return STATE | (OF_RODS if rods else {}) | (OF_MIXTURES if varied else {})


# arrays of grains that make up a member's state, and their entries a grain
STATE = {
    "ids": "one",
    "gone": "one",
    "origin": "one",
    "count": "one",
    "nbr": "near",
    "held": "one",
    "spring": "near",
    "wall_near": "one",
    "wall_held": "one",
    "wall_spring": "walls",
    "work": "one",
    "deep": "one",
}
OF_RODS = {"facing": "one", "turned": "one", "momentum": "one"}
OF_MIXTURES = {"body": "one"}
BESIDE = ("beside", "wall_touching", "wall_force", "wall_torque", "wall_deep")
BESIDE_FINE = ("wall_fine_force", "wall_fine_torque")
SCRATCH = {"found": "one", "new_nbr": "near", "new_key": "near", "new_spring": "near", "bad": "one"}
OF_SLOTS = ("rows", "material", "place", "step", "flag", "late", "rebuilds", "left", "fail")
OF_WALLS = ("wall_shape", "wall_kind", "wall_motion")
WORDS_OF_STATE = ("p", "q")
COPIED = ("p", *(name for name in STATE | OF_RODS if name != "ids"), "rebuilds", "left")
"""Arrays that are copied aside before every beat."""


@dataclass(frozen=True)
class Shape:
    """Of one array."""

    name: str
    dtype: Any
    length: int

    @property
    def bytes(self) -> int:
        """Memory that it takes, with its copy if it has one."""
        return self.length * wp.types.type_size_in_bytes(self.dtype) * (2 if self.name in COPIED else 1)


def codec(module: ModuleType) -> Codec:
    """How the kernels of `module` keep the state of a grain."""
    return Codec(not module.FINE, module.RODS)


def shapes(module: ModuleType, sizes: Sizes, crossings: bool) -> Iterator[Shape]:
    """All arrays. module: the kernels' module, which knows the types; crossings: whether they are recorded."""
    rows, slots = sizes.rows, sizes.slots
    lengths = {name: rows * sizes.entries[of] for name, of in (state(sizes.rods, module.VARIED) | SCRATCH).items()}
    lengths |= {name: rows if module.APART else 1 for name in BESIDE}
    lengths |= {name: rows if module.APART and module.FINE else 1 for name in BESIDE_FINE} | {"beside_count": 2 * slots}
    lengths |= dict.fromkeys(OF_SLOTS, slots)
    lengths |= dict.fromkeys(OF_WALLS, max(1, slots * sizes.walls))
    lengths |= {"wall_c": max(1, slots * sizes.walls * module.KINDS), "pair_c": slots * module.KINDS**2}
    lengths |= {"overflow": 2 * slots, "any_flag": 1, "crossed": 1, "cross": module.COLUMNS * rows if crossings else 1}
    lengths |= {"cell_count": slots * sizes.cells, "cell_rows": slots * sizes.cells * sizes.depth}
    for name in WORDS_OF_STATE:
        yield Shape(name, module.word, rows * codec(module).words)
    for name, length in lengths.items():
        yield Shape(name, module.System.vars[name].type.dtype, length)


def memory(module: ModuleType, sizes: Sizes, crossings: bool) -> int:
    """Bytes of all arrays, their copies included."""
    return sum(shape.bytes for shape in shapes(module, sizes, crossings))
