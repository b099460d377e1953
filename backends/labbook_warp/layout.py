"""Arrays of an ensemble: names, lengths and memory."""

from collections.abc import Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import warp as wp
from labbook_dem.mesh import CONTACT_COLUMNS, CONTACT_ROWS, MESH_CONTACTS, SPHERE_ROWS

from labbook_warp.kernels.words import MESH_LISTED, MOST_CONTACTS
from labbook_warp.shapes import SHAPES


@dataclass(frozen=True)
class Sizes:
    """Sizes of arrays; see `labbook_warp.kernels.system`.

    Attributes:
        slots: slots.
        cap: rows a slot.
        near: neighbours a grain.
        walls: walls a member.
        cells: cells a slot.
        depth: grains a cell.
        parts: entries a wall of each grain.
        shape: shape of the grains.
    """

    slots: int
    cap: int
    near: int
    walls: int
    cells: int
    depth: int
    parts: int
    shape: str
    listed: bool
    """True if members have more walls than a grain has entries for."""

    @property
    def seats(self) -> int:
        """Walls that a grain has entries for."""
        return min(max(self.walls, 1), MOST_CONTACTS // self.parts)

    @property
    def rows(self) -> int:
        """Rows of all slots."""
        return self.slots * self.cap

    @property
    def entries(self) -> dict[str, int]:
        """Numbers of entries a grain of the kinds of arrays below."""
        return {"one": 1, "near": self.near, "walls": self.seats * self.parts, "seats": self.seats}

    def holds(self, sizes: "Sizes") -> bool:
        """Return True if each slot has room for all that a slot of `sizes` has."""
        same_kind = (self.parts, self.shape, self.listed) == (sizes.parts, sizes.shape, sizes.listed)
        return (
            same_kind
            and self.slots >= sizes.slots
            and self.cap >= sizes.cap
            and all(self.entries[kind] >= sizes.entries[kind] for kind in sizes.entries)
        )

    @property
    def contacts(self) -> int:
        """Capacity in rows of contacts."""
        at_walls = max(6, 2 * self.parts if self.parts == MESH_CONTACTS else 0)
        return self.rows * (self.near // 2 + min(self.walls * self.parts, at_walls)) + 1


def state(shape: str, varied: bool, listed: bool, rolling: bool, meshes: bool) -> dict[str, str]:
    """Names of a member's state arrays, except its words, with their kinds of `Sizes.entries`.

    rolling: contacts have rolling springs; meshes: a wall consists of triangles.
    """
    further = dict(SHAPES[shape].state) | (OF_MIXTURES if varied else {}) | (OF_MANY_WALLS if listed else {})
    return STATE | further | (OF_ROLLING if rolling else {}) | (OF_MESHES if meshes else {})


# State arrays of grains and their kinds of entries. Their names are also those of checkpoints: they stay.
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
OF_MIXTURES = {"body": "one"}
OF_MANY_WALLS = {"wall_seat": "seats"}
OF_ROLLING = {"rolling": "near", "wall_rolling": "walls"}
OF_MESHES = {"wall_feature": "walls"}
BESIDE = ("beside", "wall_touching", "wall_force", "wall_torque", "wall_deep")
BESIDE_FINE = ("wall_fine_force", "wall_fine_torque")
SCRATCH = {"new_count": "one", "new_nbr": "near", "new_key": "near", "new_spring": "near", "bad": "one"}
SCRATCH_OF_ROLLING = {"new_rolling": "near"}
EXTREMES = ("most_deep", "most_speed2")
OF_SLOTS = ("rows", "material", "domain", "step", "flag", "late", "rebuilds", "left", "fail", *EXTREMES)
OF_WALLS = ("wall_kind", "wall_motion")
WORDS_OF_STATE = ("p", "q")
OF_SHAPES = tuple(dict.fromkeys(name for shape in SHAPES.values() for name in shape.state))
SOMETIMES = (*OF_SHAPES, *OF_MANY_WALLS, *OF_ROLLING, *OF_MESHES)
"""Optional arrays that are backed up."""
COPIED = ("p", *(name for name in STATE if name != "ids"), *SOMETIMES, "rebuilds", "left", *EXTREMES)
"""Arrays that are backed up before every beat."""


@dataclass(frozen=True)
class ArrayShape:
    """Name, type and length of one array."""

    name: str
    dtype: Any
    length: int

    @property
    def bytes(self) -> int:
        """Memory, including the backup if there is one."""
        return self.length * wp.types.type_size_in_bytes(self.dtype) * (2 if self.name in COPIED else 1)


def shapes(module: ModuleType, sizes: Sizes, crossings: bool) -> Iterator[ArrayShape]:
    """Yield all arrays. module: kernel module, which knows the types; crossings: rows of crossings are recorded."""
    rows, slots = sizes.rows, sizes.slots
    own_state = state(sizes.shape, module.VARIED, sizes.listed, module.ROLLING_SPRING, module.MESHES)
    scratch = SCRATCH | (SCRATCH_OF_ROLLING if module.ROLLING_SPRING else {})
    lengths = {name: rows * sizes.entries[of] for name, of in (own_state | scratch).items()}
    lengths |= {name: rows if module.APART else 1 for name in BESIDE}
    lengths |= {name: rows if module.APART and module.FINE else 1 for name in BESIDE_FINE} | {"beside_count": 2 * slots}
    lengths |= dict.fromkeys(OF_SLOTS, slots)
    lengths |= dict.fromkeys(OF_WALLS, max(1, slots * sizes.walls))
    lengths["wall_numbers"] = max(1, slots * sizes.walls * module.WALL_NUMBERS)
    lengths |= {"wall_c": max(1, slots * sizes.walls * module.KINDS), "pair_c": slots * module.KINDS**2}
    if module.MESHES:
        seats = rows * sizes.seats
        lengths |= {
            "pose_of": lengths["wall_kind"],
            "mesh_of": lengths["wall_kind"],
            "mesh_count": seats,
            "mesh_near": seats * MESH_LISTED,
        }
        lengths["mesh_contacts"] = (seats if module.SHARED else rows) * contact_rows(module) * CONTACT_COLUMNS
    lengths |= {"overflow": 3 * slots, "any_flag": 1, "crossed": 1, "cross": module.COLUMNS * rows if crossings else 1}
    lengths |= {"cell_count": slots * sizes.cells, "cell_rows": slots * sizes.cells * sizes.depth}
    for name in WORDS_OF_STATE:
        yield ArrayShape(name, module.word, rows * module.WORDS)
    for name, length in lengths.items():
        yield ArrayShape(name, module.System.vars[name].type.dtype, length)


def contact_rows(module: ModuleType) -> int:
    """Rows of scratch for the contacts of a grain with a mesh."""
    return CONTACT_ROWS if module.ORIENTED else SPHERE_ROWS


def memory(module: ModuleType, sizes: Sizes, crossings: bool) -> int:
    """Bytes of all arrays, backups included."""
    return sum(shape.bytes for shape in shapes(module, sizes, crossings))
