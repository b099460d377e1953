"""Packings kept in the lab: made once, shared by all runs with the same packing key."""

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
from labbook.lab.tables import MOST, read_table, write_table
from labbook.scene import Bodies, Scene, Spheres
from labbook.scene.packing import Packing

ARRAYS = "packing.npz"
_BYTES = 4096  # of a grain, at most: state, and springs of 20 contacts
MOST_GRAINS = max(500_000, int(0.05 * min(memory(), 2.0**40) / 300))
"""Grains of packings that a process keeps in memory, each with some 300 bytes: a twentieth of it, or 150 MB."""
_SETTLED = 0.1  # s: the clocks of file systems tick more often


class PackingRecord(FolderRecord):
    """How a packing was made."""

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
    """By which it was computed."""
    filling: Filling
    numerics: Numerics
    grains: Whole
    duration: Measure
    """Simulated time until it was at rest [s]."""
    kinetic: Measure
    """Kinetic energy per grain at the end [m g d]."""
    ledger: Annotated[RunLedger | None, Field(exclude_if=lambda ledger: ledger is None)] = None
    """None of packings from before it was kept."""
    arrays: Annotated[
        str | None, Field(pattern="^[0-9a-f]{32}$", exclude_if=lambda arrays: arrays is None)
    ] = None  # fmt: skip
    """Hash of the arrays of the packing. None of packings from before it was kept, until `labbook reindex`."""


def write_packing(folder: Path, record: PackingRecord, packing: Packing) -> None:
    """Write a packing and its record, with seals, into a `folder` that `LabFolder.put` will make durable."""
    arrays = packing.arrays()
    write_table(folder / ARRAYS, arrays, durable=False)
    record.model_copy(update={"arrays": _hash(arrays)}).write(folder, durable=False)


def is_sealed(folder: Path) -> bool:
    """Whether nothing is to be done by `seal`: the arrays of a packing have a seal, or its record cannot be read."""
    try:
        return PackingRecord.read(folder).arrays is not None
    except Unreadable:
        return True


def seal(folder: Path) -> None:
    """Give the record of an older packing, whose claim is held, the hash of its arrays, unless it cannot be read."""
    try:
        record, _ = read_checked(folder, None)
    except Unreadable:
        return
    record.model_copy(update={"arrays": _hash(read_table(folder / ARRAYS))}).write(folder)


def _hash(arrays: Mapping[str, np.ndarray]) -> str:
    found = hashlib.blake2b(digest_size=16)
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        found.update(f"{name} {array.dtype.str} {array.shape}\n".encode() + array.tobytes())
    return found.hexdigest()


def load_packing(folder: Path) -> Packing:
    """The packing in `folder`. Raises Unreadable as `read_packing` does."""
    return read_packing(folder)[1]


def read_packing(folder: Path, key: str | None = None) -> tuple[PackingRecord, Packing]:
    """What is in the folder of a packing, which is named by its key, or has yet to be named `key`.

    Those read last are kept, as the runs that start from one begin one after another: their arrays cannot be written
    to. Raises Unreadable for anything that is missing or damaged, does not belong together, or has another key.
    """
    asked = folder, key, stamp(folder)
    with _reading:
        found = recent.get(asked)
        if found is not None:
            recent.move_to_end(asked)
    if found is None:
        found = read_checked(folder, key)
        if _only_just_written(folder):  # it might be written to again without another stamp
            return found
        _remember(asked, found)
    return found


def just_made(folder: Path, folder_stamp: int, record: PackingRecord, packing: Packing) -> None:
    """Remember a packing that this process has just put into its folder, which then had the stamp
    `folder_stamp`: it need not be read to start runs from it."""
    _protect(packing)
    _remember((folder, None, folder_stamp), (record, packing))


def _remember(asked: tuple[Path, str | None, int], found: tuple[PackingRecord, Packing]) -> None:
    with _reading:
        recent[asked] = found
        capacity = max(1, MOST_GRAINS // max(1, len(found[1])))  # adding up the grains of thousands would take long
        while len(recent) > capacity:
            recent.popitem(last=False)


def _protect(packing: Packing) -> None:
    """Its arrays cannot be written to: several runs start from them."""
    for array in vars(packing).values():
        if array is not None:
            array.flags.writeable = False


_reading = threading.Lock()
recent: OrderedDict[tuple[Path, str | None, int], tuple[PackingRecord, Packing]] = OrderedDict()
"""By folder, key and stamp: a folder that was written to since is read anew."""


def _only_just_written(folder: Path) -> bool:
    """Whether files were written so lately that the clock of their file system may not have ticked since; also of a
    folder that is gone by now."""
    try:
        return time.time() - max(file.stat().st_mtime for file in folder.iterdir()) < _SETTLED
    except OSError:
        return True


def read_checked(folder: Path, key: str | None) -> tuple[PackingRecord, Packing]:
    record = PackingRecord.read(folder, key)
    path = folder / PackingRecord.FILE
    if identity.scene_key(record.scene, record.versions) != record.closed_key:
        raise Unreadable(f"{path}: closed_key: it does not match the scene")
    whose = identity.packing_key(
        record.closed_key, record.filling, record.numerics, record.backend, record.cache_version
    )  # fmt: skip
    if whose != record.packing_key:
        raise Unreadable(f"{path}: packing_key: it does not match the scene, the filling and the numerics ({whose})")
    path = folder / ARRAYS
    try:
        arrays = read_table(path, min(MOST, 2**20 + _BYTES * record.grains))
        packing = Packing(**arrays)
    except (OSError, ValueError, TypeError) as error:
        why = str(error).removeprefix(f"{path}: ")
        raise Unreadable(f"{path}: not a packing: {why}") from error
    if record.arrays not in (None, _hash(arrays)):
        raise Unreadable(f"{path}: it was changed after it was written (wrong checksum)")
    if fault := fault_of(record, packing):
        raise Unreadable(f"{path}: {fault}")
    _protect(packing)
    return record, packing


def fault_of(record: PackingRecord, packing: Packing) -> str | None:
    """Return why these cannot be the grains of the packing; None if they can."""
    grains, count = record.scene.grains, record.scene.grains.count
    ids = packing.ids
    assert ids is not None
    if len(packing) != count or record.grains != count:
        return f"{len(packing)} of {count} grains: the others were lost while the container was filled"
    if not (len(np.unique(ids)) == len(ids) > 0 and ids.min() >= 0 and ids.max() < count):
        return f"the ids of the grains are not different ones of 0 to {count - 1}"
    if packing.q is None and not isinstance(grains, Spheres):
        return "rods without orientations"
    names = {wall.name for wall in record.scene.container.walls()}
    if unknown := set(map(str, np.unique(packing.wall_name))) - names:
        return f"springs at walls that do not exist: {', '.join(sorted(unknown))}"
    try:
        Bodies.of(grains, packing)
    except ValueError as error:
        return str(error)
    return None
