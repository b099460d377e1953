"""Finished runs on disk: record, tables, recording, checkpoint and picture, with their checks."""

import math
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from labbook.backend import Checkpoint
from labbook.backend.probes import Crossing, Film, Probe, film_probe, parse_probe, table_name
from labbook.lab import identity
from labbook.lab.folder import PICTURE, LabFolder, open_file
from labbook.lab.packings import PackingRecord, read_packing
from labbook.lab.records import RunRecord, Unreadable
from labbook.lab.tables import MAX_TABLE_BYTES, Stored, fault_of_rows, most_bytes, read_checkpoint
from labbook.measure import RunData

RECORDING = "recording.npz"
CHECKPOINT = "checkpoint.npz"
_SIGNATURE, _END = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", b"\0\0\0\0IEND\xaeB`\x82"
_WIDEST, _LARGEST = 1024, 2**20  # pixels along either side, and bytes, of a picture
_BYTES_PER_GRAIN = 2**16  # of a grain in a checkpoint, at most


def open_run(folder: Path, *, key: str | None = None, lab: LabFolder | None = None) -> tuple[RunRecord, RunData]:
    """Read the run in `folder` and check everything in it: record, keys, tables, recording, checkpoint.

    Args:
        folder: Folder of the run.
        key: Key that the folder will be named by; None: its name is the key.
        lab: Lab that has its packing; None: the lab around the folder.

    Returns:
        Record of the run, and its start and tables.

    Raises:
        Unreadable: A file is missing or damaged; the message names it.
    """
    record = RunRecord.read(folder, key)
    check_keys(folder, record)
    data = run_data(folder, record, lab)
    read_end(folder, record)
    if (film := film_of(record)) is not None:
        with _opened_recording(folder, record) as stored:
            _check_rows(folder / RECORDING, stored, film, record)
    return record, data


def run_data(folder: Path, record: RunRecord, lab: LabFolder | None = None) -> RunData:
    """Read the start and the tables of the run in `folder`.

    Args:
        folder: Folder of the run.
        record: Its record.
        lab: Lab that has its packing; None: the lab around the folder.

    Raises:
        Unreadable: A table or the packing is missing or damaged.
    """

    packed, start = read_packing((lab or LabFolder(folder.parent.parent)).packing(record.packing_key))
    _check_start(folder, record, packed)
    return RunData(
        scene=record.scene,
        numerics=record.numerics,
        seed=record.seed,
        start=start,
        outcome=record.outcome,
        duration=record.coverage.duration,
        tables={**read_tables(folder, record), **record.coverage.restart_table},
        recorded=lambda: read_recording(folder, record),
    )


def read_tables(folder: Path, record: RunRecord) -> dict[str, dict[str, np.ndarray]]:
    """Read the rows of every probe of the run, by table name. Raises Unreadable for a missing or invalid table."""
    tables = {}
    for probe in map(parse_probe, record.coverage.probes):
        path = folder / f"{table_name(probe)}.npz"
        limit = most_bytes(probe, record.scene, record.numerics, record.coverage.steps)
        with _opened(path, limit) as stored:
            tables[table_name(probe)] = table = _columns(path, stored)
        _check_rows(path, table, probe, record)
    return tables


def check_tables(folder: Path, record: RunRecord, tables: Mapping[str, Mapping[str, np.ndarray]]) -> None:
    """Check rows in memory of all probes of a run, and of its recording, instead of reading them from its folder.

    Raises:
        Unreadable: A table is missing or has impossible values.
    """
    film = film_of(record)
    probes = {table_name(probe): probe for probe in map(parse_probe, record.coverage.probes)}
    for name, probe in (probes | ({} if film is None else {Path(RECORDING).stem: film})).items():
        if name not in tables:
            raise Unreadable(f"{folder / f'{name}.npz'} is missing")
        _check_rows(folder / f"{name}.npz", tables[name], probe, record)


def read_recording(folder: Path, record: RunRecord) -> dict[str, np.ndarray] | None:
    """Read the recorded frames of the run; None if it was not recorded. Raises Unreadable."""
    film = film_of(record)
    if film is None:
        return None
    with _opened_recording(folder, record) as stored:
        table = _columns(folder / RECORDING, stored)
    _check_rows(folder / RECORDING, table, film, record)
    return table


def read_end(folder: Path, record: RunRecord) -> Checkpoint:
    """Read the exact last state of the run, whose content only its backend can check. Raises Unreadable."""
    path = folder / CHECKPOINT
    try:
        # a limit by the number of grains: a small damaged file may claim to unpack to any size
        checkpoint = read_checkpoint(path, min(MAX_TABLE_BYTES, 2**20 + _BYTES_PER_GRAIN * record.scene.grains.count))
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from error
    if (checkpoint.backend, checkpoint.cache_version) != (record.backend, record.cache_version):
        raise Unreadable(f"{path}: it was made by {checkpoint.backend} version {checkpoint.cache_version}")
    return checkpoint


def picture(folder: Path) -> Path | None:
    """Return the path of the picture (PNG) of the run's bed.

    None if there is none, as in older runs, or if the file is a link, is not a small PNG, or is incomplete.
    """
    return None if picture_content(folder) is None else folder / PICTURE


def picture_content(folder: Path) -> bytes | None:
    """Return the bytes of the picture; None where `picture` gives None."""
    try:
        with open_file(folder / PICTURE) as file:
            content = file.read(_LARGEST + 1)
    except OSError:
        return None
    sides = struct.unpack(">2I", content[16:24].ljust(8, b"\0"))
    whole = content.startswith(_SIGNATURE) and content.endswith(_END) and len(content) <= _LARGEST
    return content if whole and max(sides) <= _WIDEST else None


def _opened(path: Path, limit: float) -> Stored:
    try:
        return Stored(path, limit)
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from error


def _columns(path: Path, stored: Stored) -> dict[str, np.ndarray]:
    try:
        return dict(stored)
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: OSError | ValueError) -> Unreadable:
    if isinstance(error, FileNotFoundError):
        return Unreadable(f"{path} is missing")
    return Unreadable(f"{path}: {error.strerror or error}" if isinstance(error, OSError) else str(error))


def _check_rows(path: Path, table: Mapping[str, np.ndarray], probe: Probe, record: RunRecord) -> None:
    coverage = record.coverage
    try:
        fault = fault_of_rows(table, probe, record.scene, record.numerics, coverage.steps)
        if fault is None and isinstance(probe, Crossing) and probe.plane == record.scene.container.outlet_plane:
            again = record.scene.feed is not None
            fault = fault_of_crossings(table, coverage.crossed, coverage.last_crossing, again)
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from error
    if fault:
        raise Unreadable(f"{path}: {fault}")


def fault_of_crossings(table: Mapping[str, np.ndarray], crossed: int, last: float, again: bool = False) -> str | None:
    """Explain why these rows contradict the record of crossings; None if they do not.

    Args:
        table: Rows of the probe at the outlet plane.
        crossed: Recorded number of grains that have crossed.
        last: Recorded time of the last crossing [s].
        again: A grain may have crossed several times.
    """
    if len(table["id"]) != crossed:
        return f"{len(table['id'])} grains have crossed the outlet, but {crossed} are recorded"
    if not again and len(np.unique(table["id"])) != crossed:
        return "a grain has crossed the outlet twice"
    if float(np.max(table["time"], initial=0.0)) != last:
        return f"the last grain did not leave at {last:g} s, as is recorded"
    return None


def check_keys(folder: Path, record: RunRecord) -> None:
    """Check that the keys are those of the recorded content. Raises Unreadable."""
    expected_keys = {
        "scene_key": identity.scene_key(record.scene, record.versions),
        "experiment_key": identity.experiment_key(record.scene_key, record.packing_key, record.kick),
        "run_key": identity.run_key(record.experiment_key, record.numerics, record.backend, record.cache_version),
    }
    for name, key in expected_keys.items():
        if getattr(record, name) != key:
            raise Unreadable(f"{folder / RunRecord.FILE}: {name}: it does not match the record ({key})")
    count = record.scene.grains.count
    if record.coverage.grains != count:
        raise Unreadable(f"{folder / RunRecord.FILE}: coverage.grains: the scene has {count}")
    if record.ledger is not None and record.ledger.started < count:
        mismatch = f"the run began with {record.ledger.started} of {count} grains: its packing had lost the others"
        raise Unreadable(f"{folder / RunRecord.FILE}: ledger.started: {mismatch}")


def _check_start(folder: Path, record: RunRecord, packed: PackingRecord) -> None:
    """Check that the run can have started from a packing. Raises Unreadable."""
    path = folder / RunRecord.FILE
    if packed.scene.grains != record.scene.grains:
        raise Unreadable(f"{path}: packing_key: the packing {packed.packing_key} has other grains")
    scene = identity.lineage_scene(record.scene, record.versions, record.scene_key)
    closed = identity.lineage_scene(packed.scene, packed.versions, packed.closed_key)
    filling = packed.filling, packed.numerics, packed.backend
    lineage = identity.lineage_from(scene, closed, *filling, record.numerics, record.backend, record.kick)
    if record.lineage_key != lineage:
        raise Unreadable(f"{path}: lineage_key: it does not match the record ({lineage})")


def film_of(record: RunRecord) -> Film | None:
    """Return the probe that gives the frames of the recording; None without a recording."""
    every = record.coverage.frame_interval
    return None if every is None else film_probe(every, record.scene.grains)


def _opened_recording(folder: Path, record: RunRecord) -> Stored:
    closest = film_probe(record.coverage.recording or math.inf, record.scene.grains)
    return _opened(folder / RECORDING, most_bytes(closest, record.scene, record.numerics, record.coverage.steps))
