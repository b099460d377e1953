"""Arrays of an ensemble on a device: copies to and from the host slot by slot, and backups."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from types import ModuleType
from typing import Any

import numpy as np
import warp as wp
from labbook_dem.mesh import CONTACT_COLUMNS

from labbook_warp.codec import Codec, States
from labbook_warp.kernels.words import NO_FAILURE
from labbook_warp.layout import COPIED, SOMETIMES, WORDS_OF_STATE, Sizes, contact_rows, memory, shapes, state
from labbook_warp.shapes import SHAPES

SEVERAL = 2
"""Number of slots from which on they are copied together, array by array: a copy takes some 30 us, however small."""
PART = 0.5
"""Part of all slots above which arrays are read as a whole."""
MIRRORED = 4_000_000_000  # bytes of arrays of which the host may have copies


def fetch(array: Any, first: int = 0, count: int | None = None) -> np.ndarray:
    """Copy `count` entries of an array from `first` on to the host, after all launches before.

    On an H200 a few kilobytes take 27 us, but 43 us by `array[first:last].numpy()`, which makes an array of the part
    and another stream the current one. On the CPU the latter would be a view, which the next launch changes.

    Args:
        array: Warp array of one dimension.
        first: first entry.
        count: number of entries; None: all.

    Returns:
        Array of shape [count], or [count, ...] for vectors.
    """
    count = array.shape[0] - first if count is None else count
    values = wp.empty(count, dtype=array.dtype, device="cpu")
    if count:
        wp.copy(values, array, 0, first, count)
        if array.device.is_cuda:
            wp.synchronize_stream(array.device.stream)
    return values.numpy()


def send(values: np.ndarray, array: Any, first: int) -> None:
    """Overwrite the entries of an array from `first` on with `values` from the host."""
    if len(values):
        source = wp.array(np.ascontiguousarray(values), dtype=array.dtype, device="cpu", copy=False)
        wp.copy(array, source, first, 0, source.size)


class Outgoing:
    """Host buffers for values of some slots, until they are sent to the device together."""

    def __init__(self, slots: int, targets: Collection[int]):
        """slots: number of slots of the arrays; targets: slots that may be written to."""
        self._slots, self._indices = slots, {slot: index for index, slot in enumerate(sorted(targets))}
        self._buffers: dict[int, tuple[Any, Any, np.ndarray, set[int]]] = {}
        """By pointer: an array on the device, its buffer for Warp and as a NumPy view, and the slots written to."""

    def entries(self, array: Any, slot: int) -> np.ndarray:
        """Return the buffer of an array for a slot: zeros at first, to be written to."""
        size = array.shape[0] // self._slots
        if array.ptr not in self._buffers:
            buffer = wp.zeros(len(self._indices) * size, dtype=array.dtype, device="cpu")
            self._buffers[array.ptr] = array, buffer, buffer.numpy(), set()
        _, _, entries, slots = self._buffers[array.ptr]
        slots.add(slot)
        first = self._indices[slot] * size
        return entries[first : first + size]

    def send(self) -> None:
        """Copy the buffers to the device."""
        for array, buffer, _, slots in self._buffers.values():
            size = array.shape[0] // self._slots
            for first, count, _ in _runs(sorted(slots)):
                wp.copy(array, buffer, first * size, self._indices[first] * size, count * size)


class Arrays:
    """Zeroed arrays of the given sizes, and `system`, the argument that kernels take.

    Args:
        module: kernel module, which knows the types of the arrays.
        sizes: capacities.
        device: Warp device.
        crossings: allocate rows of crossings.
    """

    p: Any
    q: Any

    def __init__(self, module: ModuleType, sizes: Sizes, device: wp.Device, crossings: bool):
        self.module, self.sizes, self.device = module, sizes, device
        self.codec = Codec(not module.FINE, SHAPES[sizes.shape].shared_fields)
        self.state = state(sizes.shape, module.VARIED, sizes.listed, module.ROLLING_SPRING, module.MESHES)
        self.system = system = module.System()
        system.cap, system.near, system.walls = sizes.cap, sizes.near, sizes.walls
        system.seats = sizes.seats
        system.cells, system.depth = sizes.cells, sizes.depth
        self.bytes = memory(module, sizes, crossings)
        for shape in shapes(module, sizes, crossings):
            owner = self if shape.name in WORDS_OF_STATE else system
            array = wp.zeros(shape.length, dtype=shape.dtype, device=device)
            if shape.name == "mesh_contacts":
                array = array.reshape((-1, contact_rows(module), CONTACT_COLUMNS))
            setattr(owner, shape.name, array)
        system.fail.fill_(NO_FAILURE)
        missing = set(SOMETIMES) - set(self.state)
        copied = (self.p if name == "p" else getattr(system, name) for name in COPIED if name not in missing)
        self._saved = [(array, wp.clone(array)) for array in copied]
        self._whole: dict[int, np.ndarray] | None = None
        """Host copies of whole arrays by pointer, within `together`."""
        self._outgoing: Outgoing | None = None
        """Buffers within `written_together`."""
        self._indices: dict[int, int] = {}
        """Position of each slot in the gathered parts, within `gathered`."""
        self._gathered: dict[int, np.ndarray] = {}
        """Host copies of the parts of arrays that belong to these slots, by pointer."""
        self._used = set[int]()
        """Slots that a member has used: the others are zero."""
        self._rows: np.ndarray | None = np.zeros(sizes.slots, np.int32)
        """Copy of `system.rows`; None if kernels may have changed it."""

    def back_up(self) -> None:
        """Copy the state of all slots aside. May be captured in a graph."""
        for array, copy in self._saved:
            wp.copy(copy, array)

    def restore(self, slot: int) -> None:
        """Restore the backup of one slot."""
        for array, copy in self._saved:
            size = array.shape[0] // self.sizes.slots
            wp.copy(array, copy, slot * size, slot * size, size)

    def set_rows(self, rows: Mapping[int, int]) -> None:
        """Let kernels work on these numbers of rows by slot, and on no other slot."""
        numbers = np.zeros(self.sizes.slots, np.int32)
        for slot, count in rows.items():
            numbers[slot] = count
        # Most beats have the rows of the one before, and need no copy to the device.
        if self._rows is None or not np.array_equal(numbers, self._rows):
            self.system.rows.assign(numbers)
            self._rows = numbers

    def forget_rows(self) -> None:
        """Drop the copy of `system.rows`: kernels set it to 0 for members with a failed grain or a full list."""
        self._rows = None

    # one slot, to and from the host

    @contextmanager
    def together(self) -> Iterator[None]:
        """Return a context in which an array is copied to the host once, for all slots, at its first reading.

        Nothing may change the array meanwhile.
        """
        self._whole = {}
        try:
            yield
        finally:
            self._whole = None

    @contextmanager
    def written_together(self, slots: Collection[int]) -> Iterator[None]:
        """Return a context in which values for these slots are collected on the host, and sent at its end.

        Nothing may read these slots meanwhile.
        """
        if len(slots) < SEVERAL or len(slots) / self.sizes.slots * self.bytes > MIRRORED:
            yield
            return
        self._outgoing = Outgoing(self.sizes.slots, slots)
        try:
            yield
            self._outgoing.send()
        finally:
            self._outgoing = None

    def reading(self, slots: Collection[int]) -> AbstractContextManager[None]:
        """Return a context for reading these slots, in which each array is copied to the host once."""
        if len(slots) < SEVERAL:
            return nullcontext()
        whole = len(slots) > PART * self.sizes.slots and self.bytes <= MIRRORED
        return self.together() if whole else self.gathered(slots)

    @contextmanager
    def gathered(self, slots: Collection[int]) -> Iterator[None]:
        """Return a context in which the parts of an array that belong to these slots are copied to the host at once.

        They are first gathered on the device. Nothing may change a slot before it was read.
        """
        self._indices = {slot: index for index, slot in enumerate(sorted(slots))}
        try:
            yield
        finally:
            self._indices, self._gathered = {}, {}

    def _gather(self, array: Any, size: int) -> np.ndarray:
        """Return the entries of an array that belong to the slots of `gathered`, `size` of each."""
        if array.ptr not in self._gathered:
            joined = wp.empty(len(self._indices) * size, dtype=array.dtype, device=self.device)
            for first, count, index in _runs(list(self._indices)):
                wp.copy(joined, array, index * size, first * size, count * size)
            self._gathered[array.ptr] = fetch(joined)
        return self._gathered[array.ptr]

    def _copy(self, array: Any) -> np.ndarray:
        assert self._whole is not None
        if array.ptr not in self._whole:
            self._whole[array.ptr] = fetch(array)
        return self._whole[array.ptr]

    def _set(self, array: Any, slot: int, values: np.ndarray) -> None:
        """Overwrite the first entries that `array` has for a slot."""
        if self._outgoing is None:
            send(values, array, slot * (array.shape[0] // self.sizes.slots))
        else:
            self._outgoing.entries(array, slot)[: len(values)] = values

    def fetched(self, array: Any, slot: int, size: int, count: int) -> np.ndarray:
        """Return the first `count` of the `size` entries of `array` for a slot, on the host. Read only."""
        first = slot * size
        if self._whole is None and slot in self._indices:
            first = self._indices[slot] * size
            return self._gather(array, size)[first : first + count]
        if self._whole is None:
            return fetch(array, first, count)
        return self._copy(array)[first : first + count]

    def read(self, name: str, slot: int, rows: int) -> np.ndarray:
        """Return state array `name` of the first `rows` rows of a slot: shape [rows, ...], or [entries, rows, ...]."""
        if name == "p":
            words = self.codec.words
            return self.fetched(self.p, slot, self.sizes.cap * words, rows * words).reshape(rows, -1)
        entries = self.sizes.entries[self.state[name]]
        per = self.sizes.cap * entries
        block = self.fetched(getattr(self.system, name), slot, per, per)
        block = block.reshape(entries, self.sizes.cap, *block.shape[1:])[:, :rows]
        return block[0] if self.state[name] == "one" else block

    def clear(self, slot: int) -> None:
        """Set the state of a slot to zero on the device, except `p`, if anything was written to it."""
        if slot not in self._used:
            return
        for name in self.state:
            array = getattr(self.system, name)
            if self._outgoing is None:
                per = array.shape[0] // self.sizes.slots
                array[slot * per : (slot + 1) * per].zero_()
            else:
                self._outgoing.entries(array, slot)[:] = 0

    def write(self, name: str, slot: int, values: np.ndarray) -> None:
        """Write values of `read`, of any number of rows and entries that fit, into a slot; the rest becomes zero."""
        self._used.add(slot)
        if name == "p":
            self._set(self.p, slot, values.reshape(-1, self.p.dtype._length_))
            return
        entries, array = self.sizes.entries[self.state[name]], getattr(self.system, name)
        values = values[None] if self.state[name] == "one" else values
        block = np.zeros((entries, self.sizes.cap, *values.shape[2:]), values.dtype)
        block[: len(values), : values.shape[1]] = values
        self._set(array, slot, block.reshape(-1, *values.shape[2:]))

    def state_of_all(self) -> dict[str, np.ndarray]:
        """Return copies of the state arrays of all slots, each of shape [slots, entries, cap, ...]."""
        slots, cap = self.sizes.slots, self.sizes.cap
        words = fetch(self.p).reshape(slots, 1, cap, -1)
        blocks = {name: fetch(getattr(self.system, name)) for name in self.state}
        entries = {name: self.sizes.entries[kind] for name, kind in self.state.items()}
        return {"p": words} | {
            name: block.reshape(slots, entries[name], cap, *block.shape[1:]) for name, block in blocks.items()
        }

    def take_up(self, state: Mapping[str, np.ndarray]) -> None:
        """Write the arrays of `state_of_all` from smaller arrays; the rest becomes zero."""
        slots, cap = self.sizes.slots, self.sizes.cap
        for name, block in state.items():
            entries = 1 if name == "p" else self.sizes.entries[self.state[name]]
            wider = np.zeros((slots, entries, cap, *block.shape[3:]), block.dtype)
            wider[: len(block), : block.shape[1], : block.shape[2]] = block
            array = self.p if name == "p" else getattr(self.system, name)
            numbers = getattr(array.dtype, "_length_", 0)  # of an entry, if it is a vector
            send(wider.reshape(-1, numbers) if numbers else wider.ravel(), array, 0)
        self._used.update(range(slots))

    def put(self, name: str, slot: int, values: np.ndarray) -> None:
        """Write the entries of a slot in an array of slots or of walls."""
        self._set(getattr(self.system, name), slot, values)

    def put_records(self, name: str, records: Mapping[int, Any]) -> None:
        """Write the records of some slots in an array of records."""
        if records:
            array = getattr(self.system, name)
            together = wp.array([records[slot] for slot in sorted(records)], dtype=array.dtype, device=self.device)
            for first, count, index in _runs(sorted(records)):
                wp.copy(array, together, first, index, count)

    def of_slot(self, slot: int, rows: int) -> "SlotState":
        """Return the state of the first `rows` rows of a slot; each array is read on access."""
        read = partial(self.read, slot=slot, rows=rows)
        return SlotState(self.sizes, self.state, self.codec, bool(self.module.ORIENTED), read)


@dataclass(frozen=True, eq=False)
class SlotState:
    """State arrays of the rows of one slot.

    Attributes:
        sizes: capacities of the arrays.
        kinds: key of `Sizes.entries` for each array.
        codec: decoder of the shared state of grains.
        oriented: True if grains have an orientation.
        read: function that returns an array by its name, as `Arrays.read` does.
    """

    sizes: Sizes
    kinds: Mapping[str, str]
    codec: Codec
    oriented: bool
    read: Callable[[str], np.ndarray]

    def stored(self) -> "SlotState":
        """Return a copy with all arrays read now, which can be pickled."""
        blocks = {name: self.read(name) for name in ("p", *self.kinds)}
        return replace(self, read=blocks.__getitem__)

    def states(self) -> States:
        """Return the states of all rows."""
        x, v, m = self.codec.decode(self.read("p"))
        if not self.oriented:
            return States(x, v, m)
        m = self.read("momentum")[:, :3].astype(np.float64)
        return States(x, v, m, self.read("turned"))


def _runs(slots: Sequence[int]) -> Iterator[tuple[int, int, int]]:
    """Yield first slot, number of slots, and position of the first in `slots` (ascending), of each run of consecutive
    slots."""
    ends = [k for k in range(1, len(slots)) if slots[k] != slots[k - 1] + 1]
    for first, end in pairwise((0, *ends, len(slots))):
        yield slots[first], end - first, first
