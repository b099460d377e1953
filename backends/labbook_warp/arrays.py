"""The arrays of an ensemble on a device: how they are laid out, copied in and out slot by slot, and backed up."""

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
import warp as wp

from labbook_warp.build import WORDS
from labbook_warp.kernels.words import NO_FAILURE


@dataclass(frozen=True)
class Sizes:
    """What arrays are made for; see `labbook_warp.kernels.system`."""

    slots: int
    cap: int
    near: int
    walls: int
    cells: int
    depth: int


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
SCRATCH = {"new_nbr": "near", "new_key": "near", "new_spring": "near", "bad": "one"}
OF_SLOTS = ("step", "flag", "late", "rebuilds", "left", "fail")
OF_WALLS = ("wall_c", "wall_shape", "wall_kind", "wall_motion")


def fetch(array: Any) -> np.ndarray:
    """A copy on the host. (Of an array on the CPU, `numpy` alone would be a view, which the next launch changes.)"""
    found = array.numpy()
    return found.copy() if array.device.is_cpu else found


class Arrays:
    """Zeroed arrays of the given sizes, and `system`, the argument that kernels take."""

    def __init__(self, module: ModuleType, precision: str, sizes: Sizes, device: wp.Device, crossings: bool):
        self.module, self.sizes, self.device = module, sizes, device
        self.words = WORDS[precision]
        self.entries = {"one": 1, "near": sizes.near, "walls": max(sizes.walls, 1)}
        rows = sizes.slots * sizes.cap
        self.p, self.q = (self._zeros(rows * self.words, module.word) for _ in range(2))
        self.system = system = module.System()
        system.cap, system.near, system.walls = sizes.cap, sizes.near, sizes.walls
        system.cells, system.depth = sizes.cells, sizes.depth
        lengths = {name: rows * self.entries[of] for name, of in (STATE | SCRATCH).items()}
        lengths |= dict.fromkeys(OF_SLOTS, sizes.slots)
        lengths |= dict.fromkeys(OF_WALLS, max(1, sizes.slots * sizes.walls))
        lengths |= {"rows": sizes.slots, "material": sizes.slots, "place": sizes.slots, "any_flag": 1, "crossed": 1}
        lengths |= {"cell_count": sizes.slots * sizes.cells, "overflow": 2 * sizes.slots}
        lengths |= {"cell_rows": sizes.slots * sizes.cells * sizes.depth, "cross": 13 * rows if crossings else 1}
        types = {name: variable.type.dtype for name, variable in module.System.vars.items() if name in lengths}
        for name, length in lengths.items():
            setattr(system, name, self._zeros(length, types[name]))
        system.fail.fill_(NO_FAILURE)
        self._saved = [(array, wp.clone(array)) for array in self._backed_up()]

    def _zeros(self, length: int, dtype: Any):
        return wp.zeros(length, dtype=dtype, device=self.device)

    def _backed_up(self) -> list:
        changing = [getattr(self.system, name) for name in STATE if name != "ids"]
        return [self.p, *changing, self.system.rebuilds, self.system.left]

    def back_up(self) -> None:
        """Copy the state of all slots aside; may be captured."""
        for array, copy in self._saved:
            wp.copy(copy, array)

    def restore(self, slot: int) -> None:
        """Put back the state of one slot as it was backed up."""
        for array, copy in self._saved:
            size = array.shape[0] // self.sizes.slots
            wp.copy(array, copy, slot * size, slot * size, size)

    # one slot, to and from the host

    def read(self, name: str, slot: int, rows: int) -> np.ndarray:
        """State array `name` of the first `rows` rows of a slot: [rows, ...], or [entries, rows, ...]."""
        if name == "p":
            per, array = self.sizes.cap * self.words, self.p
            return fetch(array[slot * per : slot * per + rows * self.words]).reshape(rows, -1)
        entries = self.entries[STATE[name]]
        per, array = self.sizes.cap * entries, getattr(self.system, name)
        block = fetch(array[slot * per : (slot + 1) * per])
        block = block.reshape(entries, self.sizes.cap, *block.shape[1:])[:, :rows]
        return block[0] if STATE[name] == "one" else block

    def write(self, name: str, slot: int, values: np.ndarray) -> None:
        """Put what `read` gave, of any number of rows and entries that fit, into a slot; the rest becomes zero."""
        if name == "p":
            per, array = self.sizes.cap * self.words, self.p
            array[slot * per : slot * per + len(values) * self.words].assign(values.reshape(-1, array.dtype._length_))
            return
        entries, array = self.entries[STATE[name]], getattr(self.system, name)
        values = values[None] if STATE[name] == "one" else values
        block = np.zeros((entries, self.sizes.cap, *values.shape[2:]), values.dtype)
        block[: len(values), : values.shape[1]] = values
        per = self.sizes.cap * entries
        array[slot * per : (slot + 1) * per].assign(block.reshape(-1, *values.shape[2:]))

    def put(self, name: str, slot: int, values: np.ndarray) -> None:
        """Write the entries of a slot in an array of slots or of walls."""
        array = getattr(self.system, name)
        per = array.shape[0] // self.sizes.slots
        array[slot * per : slot * per + len(values)].assign(values)

    def put_record(self, name: str, slot: int, record: Any) -> None:
        """Write the record of a slot in an array of records."""
        array = getattr(self.system, name)
        wp.copy(array, wp.array([record], dtype=array.dtype, device=self.device), slot, 0, 1)

    def encode(self, x: np.ndarray, v: np.ndarray, w: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Words of states: arrays [n, 3] -> [n, numbers]; see the kernels `mixed` and `double`."""
        if self.words == 4:
            single = [a.astype(np.float32) for a in (v, w, u, np.zeros((len(x), 1)))]
            return np.hstack([np.ascontiguousarray(x).view(np.float32), *single])
        return np.hstack([x, v, w, u])

    def decode(self, words: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, velocities and spins half a step before, in double."""
        if self.words == 4:
            x = np.ascontiguousarray(words[:, :6]).view(np.float64)
            return x, words[:, 6:9].astype(np.float64), words[:, 9:12].astype(np.float64)
        return words[:, :3].copy(), words[:, 3:6].copy(), words[:, 6:9].copy()
