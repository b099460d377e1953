"""Packings in the lab: made once, shared by all runs with the same packing key."""

import hashlib
import threading
import time
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from labbook.backend.machine import memory
from labbook.backend.numerics import Numerics
from labbook.lab import identity
from labbook.lab.folder import stamp
from labbook.lab.identity import Filling
from labbook.lab.records import FolderRecord, Measure, RunLedger, StoredBackend, StoredVersions, Text, Unreadable, Whole
from labbook.lab.tables import MAX_TABLE_BYTES, read_table, write_table
from labbook.scene import Bodies, Scene
from labbook.scene.packing import Packing

ARRAYS = "packing.npz"
_BYTES_PER_GRAIN = 4096  # of a grain, at most: state, and springs of 20 contacts
MOST_GRAINS = max(500_000, int(0.05 * min(memory(), 2.0**40) / 300))
"""Maximum number of grains in packings that a process caches, 300 bytes each: 5 % of the memory, at least 150 MB."""
_CLOCK_TICK = 0.1  # s: the clocks of file systems tick more often


class PackingRecord(FolderRecord):
    """Record of a packing: identity, preparation and computation."""

    FILE = "packing.json"
    KEY = "packing_key"

    format: Literal[1] = 1
    packing_key: Annotated[str, Field(pattern="^[0-9a-f]{8,64}$")]
    closed_key: Text
    backend: StoredBackend
    cache_version: Whole
    scene: Scene
    """The closed scene, with the friction of the filling."""
    versions: StoredVersions = Field(default_factory=dict)
    """Versions of the formulas with which it was computed."""
    filling: Filling
    numerics: Numerics
    grains: Whole
    duration: Measure
    """Simulated time until it was settled [s]."""
    kinetic: Measure
    """Kinetic energy per grain at the end [m g d]."""
    ledger: Annotated[RunLedger | None, Field(exclude_if=lambda ledger: ledger is None)] = None
    """Guard extremes and mass balance; None in packings from before they were recorded."""
    arrays: Annotated[
        str | None, Field(pattern="^[0-9a-f]{32}$", exclude_if=lambda arrays: arrays is None)
    ] = None  # fmt: skip
    """Hash of the arrays; None in packings from before it was recorded, until `labbook reindex` adds it."""


def write_packing(folder: Path, record: PackingRecord, packing: Packing) -> None:
    """Write a packing and its record, with checksums, into a folder that `LabFolder.put` will make durable."""
    arrays = packing.arrays()
    write_table(folder / ARRAYS, arrays, durable=False)
    record.model_copy(update={"arrays": _hash(arrays)}).write(folder, durable=False)


def has_checksum(folder: Path) -> bool:
    """Return True if the record has the hash of the arrays, or cannot be read: `add_checksum` has nothing to do."""
    try:
        return PackingRecord.read(folder).arrays is not None
    except Unreadable:
        return True


def add_checksum(folder: Path) -> None:
    """Add the hash of its arrays to the record of an older packing, unless it cannot be read; the caller holds its
    claim."""
    try:
        record, _ = read_checked(folder, None)
    except Unreadable:
        return
    record.model_copy(update={"arrays": _hash(read_table(folder / ARRAYS))}).write(folder)


def _hash(arrays: Mapping[str, np.ndarray]) -> str:
    digest = hashlib.blake2b(digest_size=16)
    for name in sorted(arrays):  # by name: the hash does not depend on the order in the file
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode() + array.tobytes())
    return digest.hexdigest()


def load_packing(folder: Path) -> Packing:
    """Read the packing in `folder`. Raises Unreadable as `read_packing` does."""
    return read_packing(folder)[1]


def read_packing(folder: Path, key: str | None = None) -> tuple[PackingRecord, Packing]:
    """Read and check the packing in `folder`.

    The packings read last are cached, since many runs start from one packing. Their arrays are read-only.

    Args:
        folder: Folder of the packing.
        key: Key that the folder will be named by; None: its name is the key.

    Raises:
        Unreadable: A file is missing or damaged, the files do not belong together, or the key differs.
    """
    cache_key = folder, key, stamp(folder)
    with _cache_lock:
        entry = cache.get(cache_key)
        if entry is not None:
            cache.move_to_end(cache_key)
    if entry is None:
        entry = read_checked(folder, key)
        if _is_too_recent(folder):  # it might be written to again without another stamp
            return entry
        _remember(cache_key, entry)
    return entry


def remember_packing(folder: Path, folder_stamp: int, record: PackingRecord, packing: Packing) -> None:
    """Cache a packing that this process has just put into its folder, to save reading it.

    Args:
        folder: Folder of the packing.
        folder_stamp: Stamp of the folder with this content.
        record: Record of the packing.
        packing: The packing; its arrays become read-only.
    """
    _make_read_only(packing)
    _remember((folder, None, folder_stamp), (record, packing))


def _remember(cache_key: tuple[Path, str | None, int], entry: tuple[PackingRecord, Packing]) -> None:
    with _cache_lock:  # several threads read packings
        cache[cache_key] = entry
        capacity = max(1, MOST_GRAINS // max(1, len(entry[1])))  # adding up the grains of thousands would take long
        while len(cache) > capacity:
            cache.popitem(last=False)


def _make_read_only(packing: Packing) -> None:
    """Protect the arrays of a packing against writing: several runs start from them."""
    for array in vars(packing).values():
        if array is not None:
            array.flags.writeable = False


_cache_lock = threading.Lock()
cache: OrderedDict[tuple[Path, str | None, int], tuple[PackingRecord, Packing]] = OrderedDict()
"""Packings read last, by folder, key and stamp: a folder that has been written to is read again."""


def _is_too_recent(folder: Path) -> bool:
    """Decide whether a file was written less than a tick of the file system's clock ago, or is gone."""
    try:
        return time.time() - max(file.stat().st_mtime for file in folder.iterdir()) < _CLOCK_TICK
    except OSError:
        return True


def read_checked(folder: Path, key: str | None) -> tuple[PackingRecord, Packing]:
    """Read and check the packing in `folder`, past the cache. Raises Unreadable."""
    record = PackingRecord.read(folder, key)
    path = folder / PackingRecord.FILE
    if identity.scene_key(record.scene, record.versions) != record.closed_key:
        raise Unreadable(f"{path}: closed_key: it does not match the scene")
    expected_key = identity.packing_key(
        record.closed_key, record.filling, record.numerics, record.backend, record.cache_version
    )  # fmt: skip
    if expected_key != record.packing_key:
        raise Unreadable(
            f"{path}: packing_key: it does not match the scene, the filling and the numerics ({expected_key})"
        )
    path = folder / ARRAYS
    try:
        arrays = read_table(path, min(MAX_TABLE_BYTES, 2**20 + _BYTES_PER_GRAIN * record.grains))
        packing = Packing(**arrays)
    except (OSError, ValueError, TypeError) as error:
        reason = str(error).removeprefix(f"{path}: ")
        raise Unreadable(f"{path}: not a packing: {reason}") from error
    if record.arrays not in (None, _hash(arrays)):
        raise Unreadable(f"{path}: it was changed after it was written (wrong checksum)")
    if fault := fault_of(record, packing):
        raise Unreadable(f"{path}: {fault}")
    _make_read_only(packing)
    return record, packing


def fault_of(record: PackingRecord, packing: Packing) -> str | None:
    """Explain why these grains cannot be those of the packing; None if they can."""
    grains, count = record.scene.grains, record.scene.grains.count
    ids = packing.ids
    assert ids is not None
    if len(packing) != count or record.grains != count:
        return f"{len(packing)} of {count} grains: the others were lost while the container was filled"
    if not (len(np.unique(ids)) == len(ids) > 0 and ids.min() >= 0 and ids.max() < count):
        return f"the ids of the grains are not different ones of 0 to {count - 1}"
    if packing.q is None and grains.oriented:
        return f"{grains.noun}s without orientations"
    names = {wall.name for wall in record.scene.container.walls()}
    if undefined_walls := set(map(str, np.unique(packing.wall_name))) - names:
        return f"springs at walls that do not exist: {', '.join(sorted(undefined_walls))}"
    try:
        Bodies.of(grains, packing)
    except ValueError as error:
        return str(error)
    return None
