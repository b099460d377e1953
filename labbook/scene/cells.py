"""Grids over boxes: which of many boxes may hold a point."""

from dataclasses import dataclass

import numpy as np

_MOST_CELLS = 1_000_000
_AT_ONCE = 2_000_000  # pairs of a cell and a box


@dataclass(frozen=True, eq=False)
class Cells:
    """Grid whose cells list the boxes that reach into them.

    Attributes:
        low: Lower corner [m], shape [d].
        size: Side of a cell [m].
        shape: Numbers of cells along the axes, shape [d].
        first: First entry of each cell in `listed`, and behind the last, shape [cells + 1]; the last axis runs first.
        listed: Boxes, ascending in each cell.
    """

    low: np.ndarray
    size: float
    shape: np.ndarray
    first: np.ndarray
    listed: np.ndarray

    @classmethod
    def over(cls, low: np.ndarray, high: np.ndarray, size: float, owner: np.ndarray | None = None) -> "Cells":
        """Build the grid of n boxes.

        Args:
            low: Lower corners [m], shape [n, d].
            high: Upper corners [m], shape [n, d].
            size: Side of a cell [m]; larger if there would be more than a million.
            owner: Number to list in place of that of a box, shape [n]; a cell lists each once.
        """
        corner, far = low.min(axis=0), high.max(axis=0)
        while np.prod(np.ceil((far - corner) / size) + 1) > _MOST_CELLS:
            size *= 1.25
        shape = (np.ceil((far - corner) / size) + 1).astype(np.int64)
        start, end = (((x - corner) / size).astype(np.int64) for x in (low, high))
        owner = np.arange(len(low)) if owner is None else owner
        stride = int(owner.max()) + 1
        sides, steps = end - start + 1, np.append(np.cumprod(shape[:0:-1])[::-1], 1)
        counts = np.prod(sides, axis=1)
        pairs, begin = list[np.ndarray](), 0
        while begin < len(low):
            last = begin + max(1, int(np.searchsorted(np.cumsum(counts[begin:]), _AT_ONCE)))
            box = np.repeat(np.arange(begin, min(last, len(low))), counts[begin:last])
            k = ranges(np.zeros_like(counts[begin:last]), counts[begin:last])
            cell = np.zeros(len(box), np.int64)
            for axis in reversed(range(len(shape))):
                k, along = np.divmod(k, sides[box, axis])
                cell += (start[box, axis] + along) * steps[axis]
            pairs.append(cell * stride + owner[box])
            begin = last
        pair = np.sort(np.concatenate(pairs))
        cell, listed = np.divmod(pair[np.diff(pair, prepend=-1) > 0], stride)
        entries = np.bincount(cell, minlength=int(np.prod(shape)))
        return cls(corner, size, shape, np.concatenate([[0], np.cumsum(entries)]), listed)

    def near(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """List the boxes that may hold points.

        Args:
            x: Points [m], shape [k, d].

        Returns:
            Pairs of a point and what its cell lists, in the order of points, each of shape [pairs].
        """
        at = (x - self.low) / self.size
        within = np.flatnonzero(((at >= 0) & (at < self.shape)).all(axis=1))
        cell = np.ravel_multi_index(tuple(at[within].astype(np.int64).T), tuple(self.shape))
        first = self.first[cell]
        counts = self.first[cell + 1] - first
        return np.repeat(within, counts), self.listed[ranges(first, counts)]


def ranges(first: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Numbers first, first + 1, ..., `count` of them, of one range after another, shape [count.sum()]."""
    return np.arange(count.sum()) + np.repeat(first - (np.cumsum(count) - count), count)
