"""The arrays of an ensemble on a device: copied in and out slot by slot, and backed up."""

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
"""Slots from which on they are copied together, array by array: a copy takes some 30 us, however small."""
PART = 0.5
"""Part of all slots from which on arrays are read as a whole, instead of the parts of these slots."""
MIRRORED = 4_000_000_000  # bytes of arrays of which the host may have copies


def fetch(array: Any, first: int = 0, count: int | None = None) -> np.ndarray:
    """A copy on the host, of `count` entries from `first` on, after all that was launched before.

    On an H200 a few kilobytes take 27 us, and 43 us by `array[first:last].numpy()`: that makes an array of the part,
    and another stream the current one. On the CPU it would be a view, which the next launch changes.
    """
    count = array.shape[0] - first if count is None else count
    found = wp.empty(count, dtype=array.dtype, device="cpu")
    if count:
        wp.copy(found, array, 0, first, count)
        if array.device.is_cuda:
            wp.synchronize_stream(array.device.stream)
    return found.numpy()


def send(values: np.ndarray, array: Any, first: int) -> None:
    """Overwrite the entries of an array from `first` on."""
    if len(values):
        held = wp.array(np.ascontiguousarray(values), dtype=array.dtype, device="cpu", copy=False)
        wp.copy(array, held, first, 0, held.size)


class Outgoing:
    """Buffers on the host for what is written to some slots of arrays, until it is sent to the device."""

    def __init__(self, slots: int, targets: Collection[int]):
        """slots: how many the arrays have; targets: those that may be written to."""
        self._slots, self._places = slots, {slot: place for place, slot in enumerate(sorted(targets))}
        self._buffers: dict[int, tuple[Any, Any, np.ndarray, set[int]]] = {}
        """By pointer, an array on the device, the entries of all these slots for Warp and for NumPy, and the slots
        written to so far."""

    def entries(self, array: Any, slot: int) -> np.ndarray:
        """Return the entries that an array is to have for a slot: zeros at first, and to be written to."""
        size = array.shape[0] // self._slots
        if array.ptr not in self._buffers:
            buffer = wp.zeros(len(self._places) * size, dtype=array.dtype, device="cpu")
            self._buffers[array.ptr] = array, buffer, buffer.numpy(), set()
        _, _, entries, slots = self._buffers[array.ptr]
        slots.add(slot)
        first = self._places[slot] * size
        return entries[first : first + size]

    def send(self) -> None:
        """Copy all that was written to the device."""
        for array, buffer, _, slots in self._buffers.values():
            size = array.shape[0] // self._slots
            for first, count, _ in _runs(sorted(slots)):
                wp.copy(array, buffer, first * size, self._places[first] * size, count * size)


class Arrays:
    """Zeroed arrays of the given sizes, and `system`, the argument that kernels take."""

    p: Any
    q: Any

    def __init__(self, module: ModuleType, sizes: Sizes, device: wp.Device, crossings: bool):
        self.module, self.sizes, self.device = module, sizes, device
        self.codec = Codec(not module.FINE, SHAPES[sizes.shape].shown)
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
        """Copies on the host, by pointer, within `together`."""
        self._outgoing: Outgoing | None = None
        """Buffers within `written_together`."""
        self._places: dict[int, int] = {}
        """Place of each slot that is read within `gathered`."""
        self._gathered: dict[int, np.ndarray] = {}
        """Parts of arrays that belong to these slots, on the host, by pointer."""
        self._used = set[int]()
        """Slots that a member has had: the others are zero."""
        self._rows: np.ndarray | None = np.zeros(sizes.slots, np.int32)
        """What `system.rows` holds; None if kernels may have changed it."""

    def back_up(self) -> None:
        """Copy the state of all slots aside; may be captured."""
        for array, copy in self._saved:
            wp.copy(copy, array)

    def restore(self, slot: int) -> None:
        """Put back the state of one slot as it was backed up."""
        for array, copy in self._saved:
            size = array.shape[0] // self.sizes.slots
            wp.copy(array, copy, slot * size, slot * size, size)

    def set_rows(self, rows: Mapping[int, int]) -> None:
        """Let kernels work on that many rows of these slots, and on no others."""
        numbers = np.zeros(self.sizes.slots, np.int32)
        for slot, count in rows.items():
            numbers[slot] = count
        if self._rows is None or not np.array_equal(numbers, self._rows):
            self.system.rows.assign(numbers)
            self._rows = numbers

    def forget_rows(self) -> None:
        """Forget what `system.rows` holds: kernels set it to 0 for members with a failed grain or a full list."""
        self._rows = None

    # one slot, to and from the host

    @contextmanager
    def together(self) -> Iterator[None]:
        """Within this context, an array is copied to the host once, for all slots, when one slot of it is first read.
        Nothing may change it meanwhile."""
        self._whole = {}
        try:
            yield
        finally:
            self._whole = None

    @contextmanager
    def written_together(self, slots: Collection[int]) -> Iterator[None]:
        """Within this context, what is written to these slots is put together on the host, array by array, and copied
        to the device at its end. Nothing may read it meanwhile."""
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
        """Within this context, what is read of these slots is first put together on the device, array by array, and
        copied to the host at once. Nothing may change it meanwhile, but a slot after it was read."""
        self._places = {slot: place for place, slot in enumerate(sorted(slots))}
        try:
            yield
        finally:
            self._places, self._gathered = {}, {}

    def _gather(self, array: Any, size: int) -> np.ndarray:
        """Return the entries of an array that belong to the slots of `gathered`, `size` of each."""
        if array.ptr not in self._gathered:
            joined = wp.empty(len(self._places) * size, dtype=array.dtype, device=self.device)
            for first, count, place in _runs(list(self._places)):
                wp.copy(joined, array, place * size, first * size, count * size)
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

    def part(self, array: Any, slot: int, size: int, count: int) -> np.ndarray:
        """The first `count` of the `size` entries that `array` has for a slot, on the host. Read only."""
        first = slot * size
        if self._whole is None and slot in self._places:
            first = self._places[slot] * size
            return self._gather(array, size)[first : first + count]
        if self._whole is None:
            return fetch(array, first, count)
        return self._copy(array)[first : first + count]

    def read(self, name: str, slot: int, rows: int) -> np.ndarray:
        """State array `name` of the first `rows` rows of a slot: [rows, ...], or [entries, rows, ...]."""
        if name == "p":
            words = self.codec.words
            return self.part(self.p, slot, self.sizes.cap * words, rows * words).reshape(rows, -1)
        entries = self.sizes.entries[self.state[name]]
        per = self.sizes.cap * entries
        block = self.part(getattr(self.system, name), slot, per, per)
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
        """Put what `read` gave, of any number of rows and entries that fit, into a slot; the rest becomes zero."""
        self._used.add(slot)
        if name == "p":
            self._set(self.p, slot, values.reshape(-1, self.p.dtype._length_))
            return
        entries, array = self.sizes.entries[self.state[name]], getattr(self.system, name)
        values = values[None] if self.state[name] == "one" else values
        block = np.zeros((entries, self.sizes.cap, *values.shape[2:]), values.dtype)
        block[: len(values), : values.shape[1]] = values
        self._set(array, slot, block.reshape(-1, *values.shape[2:]))

    def write_rows(self, name: str, slot: int, first: int, values: np.ndarray) -> None:
        """Overwrite rows of a state array of one entry a row, from `first` on."""
        array, per = (self.p, self.codec.words) if name == "p" else (getattr(self.system, name), 1)
        if name == "p":
            values = values.reshape(-1, array.dtype._length_)
        else:
            assert self.state[name] == "one", name
        send(values, array, (slot * self.sizes.cap + first) * per)

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
        """Write what `state_of_all` gave of arrays that had room for no more; the rest becomes zero."""
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
        """Write the records of slots in an array of records."""
        if records:
            array = getattr(self.system, name)
            together = wp.array([records[slot] for slot in sorted(records)], dtype=array.dtype, device=self.device)
            for first, count, place in _runs(sorted(records)):
                wp.copy(array, together, first, place, count)

    def of_slot(self, slot: int, rows: int) -> "SlotState":
        """Return the state of the first `rows` rows of a slot; each array is read when it is asked for."""
        read = partial(self.read, slot=slot, rows=rows)
        return SlotState(self.sizes, self.state, self.codec, bool(self.module.ORIENTED), read)


@dataclass(frozen=True, eq=False)
class SlotState:
    """State arrays of the rows of one slot.

    Attributes:
        sizes: What the arrays are made for.
        kinds: Which of `Sizes.entries` each array has.
        codec: Reads the words of grains.
        oriented: Whether grains have an orientation.
        read: Gives an array by its name, as `Arrays.read` does.
    """

    sizes: Sizes
    kinds: Mapping[str, str]
    codec: Codec
    oriented: bool
    read: Callable[[str], np.ndarray]

    def stored(self) -> "SlotState":
        """Return the same with all arrays read now; it can be pickled."""
        blocks = {name: self.read(name) for name in ("p", *self.kinds)}
        return replace(self, read=blocks.__getitem__)

    def states(self) -> States:
        """States of all rows."""
        x, v, m = self.codec.decode(self.read("p"))
        if not self.oriented:
            return States(x, v, m)
        m = self.read("momentum")[:, :3].astype(np.float64)
        return States(x, v, m, self.read("turned"))


def _runs(slots: Sequence[int]) -> Iterator[tuple[int, int, int]]:
    """First slot, number of slots, and place of the first among `slots`, which ascend, of those beside each other."""
    ends = [k for k in range(1, len(slots)) if slots[k] != slots[k - 1] + 1]
    for first, end in pairwise((0, *ends, len(slots))):
        yield slots[first], end - first, first
