"""Grains that return to members: reading of the top of all beds, and rows written for all members at once.

Kernels here read and copy words of any precision, so that they are compiled once for all scenes.
"""

# arguments of kernels have the types of Warp
# pyright: reportInvalidTypeForm=false, reportOperatorIssue=false, reportIndexIssue=false, reportArgumentType=false

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from labbook_warp.arrays import Arrays, fetch
from labbook_warp.kernels.words import PARKED

_COLUMNS = 8  # row, x, y, z, and of rods qw, qx, qy, qz, as `_read` writes them


@dataclass(frozen=True, eq=False)
class Tops:
    """Rows of all slots as they are between two beats.

    Attributes:
        left: mask of the rows whose grain has left, shape [slots, cap].
        rows: rows of the grains above the height of their slot, ascending, counted through all slots.
        first: first of `rows` of each slot, and the end of the last.
        x: centres [m] of these grains, shape [m, 3].
        q: their orientations, shape [m, 4]; of spheres without a meaning.
    """

    left: np.ndarray
    rows: np.ndarray
    first: np.ndarray
    x: np.ndarray
    q: np.ndarray


def read_tops(arrays: Arrays, heights: Mapping[int, float]) -> Tops:
    """Read which grains of all awake members have left, and those above a height, with one launch.

    Args:
        arrays: arrays of the members.
        heights: height z [m] by slot; of other slots no grain is read.
    """
    sizes, device, oriented = arrays.sizes, arrays.device, bool(arrays.module.ORIENTED)
    low = np.full(sizes.slots, np.inf)
    for slot, height in heights.items():
        low[slot] = height
    words = _as(arrays.p, wp.float64)
    turned = _as(arrays.system.turned, wp.float64) if oriented else words
    left = wp.zeros(sizes.rows, dtype=wp.int8, device=device)
    counter = wp.zeros(1, dtype=wp.int32, device=device)
    out = wp.empty(_COLUMNS * sizes.rows if heights else 1, dtype=wp.float64, device=device)
    heights_there = wp.array(low, dtype=wp.float64, device=device)
    stride = words.shape[0] // sizes.rows
    inputs = [words, stride, sizes.cap, arrays.system.rows, 0.5 * PARKED, heights_there, turned, oriented]
    wp.launch(_read, sizes.rows, [*inputs, left, counter, out], device=device)
    records = fetch(out, 0, _COLUMNS * int(fetch(counter)[0])).reshape(-1, _COLUMNS)
    rows = records[:, 0].astype(np.int64)
    order = np.argsort(rows)
    rows, records = rows[order], records[order]
    first = np.searchsorted(rows, sizes.cap * np.arange(sizes.slots + 1))
    return Tops(fetch(left).reshape(sizes.slots, sizes.cap) > 0, rows, first, records[:, 1:4], records[:, 4:])


@wp.kernel(enable_backward=False)
def _read(
    words: wp.array(dtype=wp.float64),
    stride: int,
    cap: int,
    rows: wp.array(dtype=wp.int32),
    parked: wp.float64,
    low: wp.array(dtype=wp.float64),
    turned: wp.array(dtype=wp.float64),
    oriented: bool,
    left: wp.array(dtype=wp.int8),
    counter: wp.array(dtype=wp.int32),
    out: wp.array(dtype=wp.float64),
):
    """Mark the rows whose grain has left; append those above `low` of their slot, in any order.

    The first three doubles of a row are the position, in either precision (`labbook_warp.codec`).
    """
    i = wp.tid()
    s = i // cap
    if i - s * cap < rows[s]:
        z = words[i * stride + 2]
        if z > parked:
            if z > low[s]:
                at = 8 * wp.atomic_add(counter, 0, 1)
                out[at] = wp.float64(i)
                for c in range(3):
                    out[at + 1 + c] = words[i * stride + c]
                if oriented:
                    for c in range(4):
                        out[at + 4 + c] = turned[4 * i + c]
        else:
            left[i] = wp.int8(1)


def write_rows(arrays: Arrays, rows: np.ndarray, values: Mapping[str, np.ndarray]) -> None:
    """Overwrite rows of state arrays with one entry a row, with one copy to the device.

    Args:
        arrays: arrays of the members.
        rows: rows, counted through all slots, shape [n].
        values: values by the name of the array, shape [n, ...]; all other such arrays become zero.
    """
    names = ("p", *(name for name, entries in arrays.state.items() if entries == "one"))
    targets = {name: arrays.p if name == "p" else getattr(arrays.system, name) for name in names}
    zeros = {name: np.zeros((len(rows), getattr(array.dtype, "_length_", 1))) for name, array in targets.items()}
    values = zeros | dict(values)
    blocks = [np.ascontiguousarray(block, _numbers(targets[name])) for name, block in values.items()]
    blocks_of_words = [rows.astype(np.int32), *(block.view(np.int32).ravel() for block in blocks)]
    source = wp.array(np.concatenate(blocks_of_words), dtype=wp.int32, device=arrays.device)
    first = len(rows)
    for target, block_of_words in zip(targets.values(), blocks_of_words[1:], strict=True):
        wp.launch(
            _write,
            len(block_of_words),
            [source, first, len(block_of_words) // len(rows), _as(target, wp.int32)],
            device=arrays.device,
        )
        first += len(block_of_words)


@wp.kernel(enable_backward=False)
def _write(
    source: wp.array(dtype=wp.int32),
    first: int,
    width: int,
    target: wp.array(dtype=wp.int32),
):
    """Copy words to rows of `width` words; `source` begins with the rows, and has the words from `first` on."""
    k = wp.tid()
    target[source[k // width] * width + k % width] = source[first + k]


def read_rows(array: Any, rows: np.ndarray) -> np.ndarray:
    """Read rows, counted through all slots, of a device array with one number in double precision a row."""
    if not len(rows):
        return np.zeros(0)
    out = wp.empty(len(rows), dtype=wp.float64, device=array.device)
    wp.launch(
        _gather, len(rows), [array, wp.array(rows, dtype=wp.int32, device=array.device), out], device=array.device
    )
    return fetch(out)


@wp.kernel(enable_backward=False)
def _gather(
    source: wp.array(dtype=wp.float64), rows: wp.array(dtype=wp.int32), out: wp.array(dtype=wp.float64)
):  # fmt: skip
    """Copy the numbers in these rows."""
    k = wp.tid()
    out[k] = source[rows[k]]


def _numbers(array: Any) -> Any:
    """NumPy's type of the numbers of a device array, also of one of vectors."""
    return wp.dtype_to_numpy(getattr(array.dtype, "_wp_scalar_type_", array.dtype))


def _as(array: Any, dtype: Any) -> Any:
    """View of the memory of a device array as numbers of another type."""
    size = array.shape[0] * wp.types.type_size_in_bytes(array.dtype) // wp.types.type_size_in_bytes(dtype)
    return wp.array(ptr=array.ptr, dtype=dtype, shape=size, device=array.device)
