"""What a beat left behind."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from labbook_warp.arrays import Arrays, fetch
from labbook_warp.kernels.words import NO_FAILURE


@dataclass(frozen=True)
class Said:
    """What a beat left behind in a slot. near, depth: entries of a list and of a cell that would have been needed,
    where they did not fit."""

    fail: int
    late: bool
    near: int
    depth: int
    left: int

    @property
    def crowded(self) -> bool:
        """Whether lists or cells were too short."""
        return self.near > 0 or self.depth > 0


@dataclass(frozen=True)
class Report:
    """What a beat left behind. crossings: rows slot, id, step, time, x, y, z, vx, ..., wz, and of rods qw, ..., qz."""

    slots: Sequence[Said]
    crossings: np.ndarray

    def __getitem__(self, slot: int) -> Said:
        return self.slots[slot]

    def needed(self, slots: Iterable[int]) -> tuple[int, int]:
        """Entries of a list and of a cell that these slots would have needed beyond what fits; 0 where all fitted."""
        said = [self.slots[slot] for slot in slots]
        return max((one.near for one in said), default=0), max((one.depth for one in said), default=0)


def collect(arrays: Arrays) -> Report:
    """Read what the last beat left behind, and make ready for the next one."""
    system, n = arrays.system, arrays.sizes.slots
    fail, late, left = fetch(system.fail), fetch(system.late), fetch(system.left)
    crowded = fetch(system.overflow).reshape(n, 2)
    crossed = int(fetch(system.crossed)[0])
    columns = arrays.module.COLUMNS
    rows = fetch(system.cross[: columns * crossed]).reshape(-1, columns) if crossed else np.zeros((0, columns))
    system.late.zero_()
    system.overflow.zero_()
    system.crossed.zero_()
    system.fail.fill_(NO_FAILURE)
    slots = [Said(int(fail[s]), bool(late[s]), int(crowded[s, 0]), int(crowded[s, 1]), int(left[s])) for s in range(n)]
    return Report(slots, rows[np.lexsort((rows[:, 1], rows[:, 2]))])
