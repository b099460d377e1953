"""What a beat left behind."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from labbook_warp.arrays import Arrays, fetch
from labbook_warp.kernels.words import NO_FAILURE, REPORTED


@dataclass(frozen=True)
class Said:
    """What a beat left behind in a slot. near, depth, walls: entries of a list, of a cell and at walls that would have
    been needed, where they did not fit."""

    fail: int
    late: bool
    near: int
    depth: int
    walls: int
    left: int

    @property
    def crowded(self) -> bool:
        """Whether lists or cells were too short."""
        return self.near > 0 or self.depth > 0 or self.walls > 0

    @property
    def well(self) -> bool:
        """Whether the beat is valid: no failure, no late list, no overflow."""
        return self.fail == NO_FAILURE and not (self.late or self.crowded)


@dataclass(frozen=True)
class Report:
    """What a beat left behind. rows: of crossings, id, step, time, x, y, z, vx, ..., wz, and of rods qw, ..., qz, those
    of each slot together; first: where those of a slot begin, and where the last end."""

    slots: Sequence[Said]
    rows: np.ndarray
    first: np.ndarray

    def __getitem__(self, slot: int) -> Said:
        return self.slots[slot]

    def crossings(self, slot: int) -> np.ndarray:
        """Rows of crossings of a slot, in the order of steps and ids."""
        return self.rows[self.first[slot] : self.first[slot + 1]]

    def needed(self, slots: Iterable[int]) -> tuple[int, int, int]:
        """Entries of a list, of a cell and at walls that these slots would have needed beyond what fits; 0 where all
        fitted."""
        said = [(one.near, one.depth, one.walls) for one in (self.slots[slot] for slot in slots)]
        near, depth, walls = np.max([(0, 0, 0), *said], axis=0).tolist()
        return near, depth, walls


def collect(arrays: Arrays, told: Any) -> Report:
    """Read what the last beat left behind. told: how many grains crossed, and what `end` has written of each slot."""
    numbers = fetch(told)
    crossed = int(numbers[0])
    columns = arrays.module.COLUMNS
    rows = fetch(arrays.system.cross, 0, columns * crossed).reshape(-1, columns)
    slots = numbers[1:].reshape(-1, REPORTED).tolist()
    said = [Said(fail, bool(late), near, depth, walls, left) for fail, late, near, depth, walls, left in slots]
    rows = rows[np.lexsort((rows[:, 1], rows[:, 2], rows[:, 0]))]
    return Report(said, rows[:, 1:], np.searchsorted(rows[:, 0], np.arange(len(said) + 1)))
