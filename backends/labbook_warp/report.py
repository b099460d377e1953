"""Report of a beat: failures, late lists, overflows and crossings by slot."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from labbook_warp.arrays import Arrays, fetch
from labbook_warp.kernels.words import NO_FAILURE, REPORTED


@dataclass(frozen=True)
class SlotReport:
    """Events of a beat in one slot.

    Attributes:
        fail: first failure as a word (`kernels.step.record_failure`), or NO_FAILURE.
        late: a grain moved farther than half of the skin before its list was rebuilt.
        near: needed entries of a neighbour list, 0 if they fitted.
        depth: needed entries of a cell, 0 if they fitted.
        walls: needed entries at walls, 0 if they fitted.
        left: grains that have left so far.
    """

    fail: int
    late: bool
    near: int
    depth: int
    walls: int
    left: int

    @property
    def crowded(self) -> bool:
        """True if lists or cells overflowed."""
        return self.near > 0 or self.depth > 0 or self.walls > 0

    @property
    def valid(self) -> bool:
        """True if the beat is valid: no failure, no late list, no overflow."""
        return self.fail == NO_FAILURE and not (self.late or self.crowded)


@dataclass(frozen=True)
class Report:
    """Events of a beat.

    Attributes:
        slots: reports of all slots.
        rows: crossings, sorted by slot: id, step, time [s], x, y, z [m], vx ... wz, and of rods qw ... qz.
        first: first row of each slot, and the end of the last.
    """

    slots: Sequence[SlotReport]
    rows: np.ndarray
    first: np.ndarray

    def __getitem__(self, slot: int) -> SlotReport:
        return self.slots[slot]

    def crossings(self, slot: int) -> np.ndarray:
        """Return the rows of crossings of a slot, sorted by step and id."""
        return self.rows[self.first[slot] : self.first[slot + 1]]

    def needed(self, slots: Iterable[int]) -> tuple[int, int, int]:
        """Return the needed entries of a neighbour list, of a cell and at walls in these slots; 0 where all fitted."""
        needed = [(report.near, report.depth, report.walls) for report in (self.slots[slot] for slot in slots)]
        near, depth, walls = np.max([(0, 0, 0), *needed], axis=0).tolist()
        return near, depth, walls


def collect(arrays: Arrays, report: Any) -> Report:
    """Read the report of the last beat. report: number of crossings, and the numbers that `finish_beat` wrote."""
    numbers = fetch(report)
    crossed = int(numbers[0])
    columns = arrays.module.COLUMNS
    rows = fetch(arrays.system.cross, 0, columns * crossed).reshape(-1, columns)
    slots = numbers[1:].reshape(-1, REPORTED).tolist()
    reports = [SlotReport(fail, bool(late), near, depth, walls, left) for fail, late, near, depth, walls, left in slots]
    rows = rows[np.lexsort((rows[:, 1], rows[:, 2], rows[:, 0]))]
    return Report(reports, rows[:, 1:], np.searchsorted(rows[:, 0], np.arange(len(reports) + 1)))
