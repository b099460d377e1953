"""Writing the index: short transactions by the coordinating process, and rebuilding it from the folders."""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, bindparam, delete, select
from sqlalchemy.exc import DatabaseError

from labbook.lab.database import (
    DAMAGED,
    SCHEMA_VERSION,
    NotStored,
    index_error,
    is_intact,
    measurements,
    on_server,
    open_connection,
    open_engine,
    packings,
    remove_file,
    replace_index,
    runs,
    schema_version,
    select_in,
    shadow_index,
    storage_errors,
    transaction,
    upsert,
)
from labbook.lab.evaluations import derive, expected, finite
from labbook.lab.folder import LabError, LabFolder, folders, is_derived, make_folder, remove, stamp
from labbook.lab.packings import PackingRecord, add_checksum, has_checksum, read_packing
from labbook.lab.records import UNREADABLE, Observe, RunRecord, Unreadable
from labbook.lab.runs import open_run, run_data
from labbook.lab.suspect import suspicion
from labbook.measure import RunData

Tick = Callable[[int, int], None]
"""Progress callback: number of folders that are done, and number of all."""
RunRows = tuple[dict[str, Any], list[dict[str, Any]]]
"""Row of a run, and rows of its measurements."""


@dataclass
class IndexReport:
    """Changes made while the index was opened.

    Args:
        runs: Number of run folders indexed.
        packings: Number of packing folders indexed.
        vanished: Number of rows removed because their folder is gone.
        unreadable: Problem by file or folder.
        damaged_copy: Path of a damaged index that was renamed.
    """

    runs: int = 0
    packings: int = 0
    vanished: int = 0
    unreadable: dict[Path, str] = field(default_factory=dict)
    damaged_copy: Path | None = None

    @property
    def problems(self) -> list[str]:
        """List all problems as sentences."""
        damaged = []
        if copy := self.damaged_copy:
            consequence = f"it is kept as {copy.name}, and made again from the folders"
            damaged = [f"{copy.with_suffix('')} was damaged: {consequence}"]
        return damaged + list(dict.fromkeys(self.unreadable.values()))


class Index:
    """Writer of the index of a lab.

    Opening it brings the index up to date with the folders. The index is rebuilt if it is missing, of another version,
    or damaged (the old file is renamed then), or if `again` is set. A rebuilt index is made in a second file or schema;
    readers use the old one until it is complete. `report` has the changes.

    Args:
        lab: Folder of the lab.
        again: Rebuild the index from the folders, and add the hash of their arrays to older packings (writes into their
            folders).
        tick: Progress callback.

    Raises:
        LabError: The index cannot be written, or is damaged while it is in use.
    """

    def __init__(self, lab: LabFolder, *, again: bool = False, tick: Tick | None = None):
        self.lab = lab
        if lab.folder.exists() and not lab.folder.is_dir():
            raise LabError(f"{lab.folder} is a file, not a lab folder; give another one with --lab")
        make_folder(lab.folder)
        # The order matters: folders have to be complete (`_recover`) before they are compared with the index.
        self.report = IndexReport()
        self._indexed_keys = set[str]()
        if not self._open():
            self.report.damaged_copy = self._put_aside()
            self._open()
        self._recover()
        if again:
            self._seal_packings()
        if again or not self._is_of_this_version():
            self._build(again, tick)
        self._sync(tick)

    def _recover(self) -> None:
        """Complete or undo renames that a kill or a power failure interrupted."""
        lab = self.lab
        lab.sweep("index")
        for key in lab.working():
            for kind, folder in ((RunRecord, lab.run(key)), (PackingRecord, lab.packing(key))):
                if (
                    lab.is_interrupted(key, folder)
                    and (lab.replaced(key) / kind.FILE).exists()
                    and (claim := lab.claim(key))
                ):
                    lab.recover(key, folder)
                    claim.release()

    def _open(self) -> bool:
        """Open the tables, of any version; False if their file is damaged."""
        self._engine = open_engine(self.lab, read_only=False)
        path = self.lab.catalogue
        if not on_server(self._engine) and path.exists() and not path.is_file():
            return False
        try:
            version = schema_version(self._engine)
            if version == DAMAGED or (version is not None and not is_intact(self._engine)):
                self._engine.dispose()
                return False
        except DatabaseError as error:
            raise index_error(self.lab, error) from error
        return True

    def _is_of_this_version(self) -> bool:
        try:
            return schema_version(self._engine) == SCHEMA_VERSION
        except DatabaseError as error:
            raise index_error(self.lab, error) from error

    def _build(self, again: bool, tick: Tick | None) -> None:
        """Index all folders in a shadow index, then replace the index by it."""
        with self.lab.alone("index"):
            if not again and self._is_of_this_version():  # another process has made it meanwhile
                return
            with shadow_index(self.lab) as replacement:
                previous, self._engine = self._engine, replacement
                try:
                    self._sync(tick)  # reads all folders: readers use the old index meanwhile
                finally:
                    self._engine = previous
                replace_index(self._engine, self.lab)

    def _seal_packings(self) -> None:
        """Add the hash of their arrays to older packings; those that cannot be written stay as they are."""
        for key in folders(self.lab.packings):
            with suppress(OSError):
                if not has_checksum(self.lab.packing(key)) and (claim := self.lab.claim(key)):
                    try:
                        add_checksum(self.lab.packing(key))
                    finally:
                        claim.release()

    def _put_aside(self) -> Path:
        path = self.lab.catalogue
        aside = path.with_name(f"{path.name}.damaged")
        remove(aside)
        path.rename(aside)
        remove_file(path)  # its write-ahead log: it must not be taken for that of the new file
        return aside

    def close(self) -> None:
        """Close the connections to the index."""
        self._engine.dispose()

    def add_run(self, folder: Path, observe: Observe | None = None) -> str | None:
        """Index one run folder with its measurements, in place of its old rows.

        Args:
            folder: Folder of the run in the lab.
            observe: Measures and window; None: those of its record.

        Returns:
            Why the folder cannot be read; None if it can be.
        """
        return self.put_run(folder, run_rows(folder, observe))

    def put_run(self, folder: Path, rows: RunRows) -> str | None:
        """Index one run folder from rows of `run_rows`. Returns why it cannot be read, or None."""
        return self.put_runs({folder: rows})[folder]

    def put_runs(self, ended: Mapping[Path, RunRows]) -> dict[Path, str | None]:
        """Index run folders in one transaction.

        Args:
            ended: Rows of each folder, made by `run_rows`.

        Returns:
            Why each folder cannot be read; None for readable ones.
        """
        problems: dict[Path, str | None] = {folder: row["problem"] for folder, (row, _) in ended.items()}
        try:
            with self._transaction() as connection, storage_errors():
                _replace_runs(connection, ended.values())
        except NotStored as reason:
            # One rejected row has undone the whole transaction.
            if len(ended) > 1:  # only those that are not stored have a problem
                return {folder: self.put_run(folder, rows) for folder, rows in ended.items()}
            for folder, (row, _) in ended.items():
                problems[folder] = problem = f"{folder / RunRecord.FILE}: it cannot be indexed: {reason}"
                with (
                    suppress(NotStored),
                    self._transaction() as connection,
                    storage_errors(),
                ):  # not even its name is stored
                    _replace_runs(connection, [(_blank_run(folder, row["stamp"], problem), [])])
        for folder, problem in problems.items():
            self._report(folder, problem)
        return problems

    def add_packing(self, folder: Path) -> str | None:
        """Index one packing folder, and again the runs that were unreadable without it. Returns its problem, or
        None."""
        return self.put_packings({folder: packing_row(folder)})[folder]

    def put_packings(self, ended: Mapping[Path, dict[str, Any]]) -> dict[Path, str | None]:
        """Index packing folders in one transaction, and again the runs that were unreadable without them.

        Args:
            ended: Row of each folder, made by `packing_row`.

        Returns:
            Why each folder cannot be read; None for readable ones.
        """
        problems = self._store_packings(ended)
        for folder, problem in problems.items():
            self._report(folder, problem)
        query = select(runs.c.run_key).where(runs.c.problem.is_not(None))
        with self._connection() as connection:
            readable = [folder.name for folder, problem in problems.items() if not problem]
            waiting = [row.run_key for row in select_in(connection, query, runs.c.packing_key, readable)]
        for key in waiting:  # outside the transaction: checking a run takes long
            self.add_run(self.lab.run(key))
        return problems

    def _store_packings(self, ended: Mapping[Path, dict[str, Any]]) -> dict[Path, str | None]:
        """Store rows of packings; a row that the database rejects is replaced by one with the reason. Returns the
        problem of each."""
        problems: dict[Path, str | None] = {folder: row["problem"] for folder, row in ended.items()}
        try:
            with self._transaction() as connection, storage_errors():
                upsert(connection, packings, list(ended.values()))
        except NotStored as reason:
            if len(ended) > 1:
                return {folder: self._store_packings({folder: row})[folder] for folder, row in ended.items()}
            for folder, row in ended.items():
                problems[folder] = problem = f"{folder / PackingRecord.FILE}: it cannot be indexed: {reason}"
                with suppress(NotStored), self._transaction() as connection, storage_errors():
                    upsert(
                        connection, packings, [_blank_packing(folder, row["stamp"]) | {"problem": _storable(problem)}]
                    )
        return problems

    def problem(self, folder: Path) -> str | None:
        """Return the problem of a run or packing folder that the index has; None if there is none."""
        table, key = (runs, runs.c.run_key) if folder.parent == self.lab.runs else (packings, packings.c.packing_key)
        with self._connection() as connection:
            return connection.scalar(select(table.c.problem).where(key == folder.name))

    def note(self, folder: Path, problem: str) -> None:
        """Report that something in `folder` could not be read."""
        self.report.unreadable[folder] = problem

    def _report(self, folder: Path, problem: str | None) -> None:
        if problem:
            self.note(folder, problem)
        elif folder in self.report.unreadable:
            self.report.unreadable[folder] += "; it was made again"

    def derive(self, run_keys: Iterable[str], observe: Observe) -> int:
        """Measure runs that lack measurements of `observe`.

        Returns:
            Number of runs that were measured, or that turned out to be damaged.
        """
        required, keys, measured_runs = expected(observe), list(run_keys), 0
        stored = self._measured(keys)
        for key in keys:
            if required <= stored[key]:
                continue
            folder = self.lab.run(key)
            measured_runs += 1
            current_stamp = stamp(folder)  # before it is read: a later change then differs from it
            try:
                record = RunRecord.read(folder)
                rows = derive(folder, observe, lambda folder=folder, record=record: run_data(folder, record))
                with self._transaction() as connection, storage_errors():
                    upsert(connection, measurements, rows)
            except (Unreadable, NotStored) as problem:
                self.put_run(folder, (unreadable_row(folder, current_stamp, problem), []))
        return measured_runs

    def _measured(self, run_keys: list[str]) -> dict[str, set[tuple[Any, ...]]]:
        """(measure, version, window) of all stored measurements, by run."""
        names = ("run_key", "measure", "version", "window_start", "window_end", "window_timed", "window_scales")
        query = select(*(measurements.c[name] for name in names)).distinct()
        stored: dict[str, set[tuple[Any, ...]]] = {key: set() for key in run_keys}
        with self._connection() as connection:
            for key, *measured in select_in(connection, query, measurements.c.run_key, run_keys):
                stored[key].add(tuple(measured))
        return stored

    def _sync(self, tick: Tick | None) -> None:
        """Index folders that are new or changed, and delete the rows of those that are gone."""
        # Packings first: a run cannot be read without its own, and is read again if that has changed.
        report, repacked = self.report, self._sync_packings()
        on_disk = stamps(self.lab.runs)
        with self._connection() as connection:
            rows = connection.execute(select(runs.c.run_key, runs.c.stamp, runs.c.packing_key, runs.c.problem)).all()
        indexed = {row.run_key: row.stamp for row in rows}
        # a process may have been killed between indexing a packing and the runs that could not be read for want of it
        affected = {row.run_key for row in rows if row.packing_key in repacked or (row.problem and row.packing_key)}
        new = [key for key, stamp in on_disk.items() if indexed.get(key) != stamp or key in affected]
        changed = set(new)
        for row in rows:
            if row.problem and row.run_key in on_disk and row.run_key not in changed:
                self.note(self.lab.run(row.run_key), row.problem)
        for position, key in enumerate(new, 1):
            # A transaction for each run: others can write in between, and after a kill the work so far is kept.
            self.add_run(self.lab.run(key))
            self._indexed_keys.add(key)
            if tick:
                tick(position, len(new))
        vanished = [key for key in indexed if key not in on_disk]
        with self._transaction() as connection:
            _delete_runs(connection, vanished)
        report.vanished, report.runs = len(vanished), len(self._indexed_keys)

    def _sync_packings(self) -> set[str]:
        """Index packings that are new or changed; return the keys of those that changed or are gone."""
        on_disk = stamps(self.lab.packings)
        with self._connection() as connection:
            columns = packings.c.packing_key, packings.c.stamp, packings.c.problem
            rows_stored = connection.execute(select(*columns)).all()
        indexed = {row.packing_key: row.stamp for row in rows_stored}
        new = {key for key, stamp in on_disk.items() if indexed.get(key) != stamp}
        rows = [packing_row(self.lab.packing(key)) for key in sorted(new)]
        self.report.packings += len(rows)
        problems = {row["packing_key"]: row["problem"] for row in rows}
        problems |= {row.packing_key: row.problem for row in rows_stored if row.packing_key in on_disk.keys() - new}
        for key, problem in problems.items():
            if problem:
                self.note(self.lab.packing(key), problem)
        vanished = indexed.keys() - on_disk.keys()
        self._store_packings({self.lab.packing(row["packing_key"]): row for row in rows})
        with self._transaction() as connection:
            for key in vanished:
                connection.execute(delete(packings).where(packings.c.packing_key == key))
        return new | vanished

    def _connection(self) -> AbstractContextManager[Connection]:
        return open_connection(self._engine, self.lab)

    def _transaction(self) -> AbstractContextManager[Connection]:
        return transaction(self._engine, self.lab)


def _replace_runs(connection: Connection, ended: Iterable[RunRows]) -> None:
    ended = list(ended)
    # Deleted first: measurements of the run's former content would otherwise stay under the same key.
    _delete_runs(connection, [row["run_key"] for row, _ in ended])
    upsert(connection, runs, [row for row, _ in ended])
    upsert(connection, measurements, [measured for _, rows in ended for measured in rows])


def _delete_runs(connection: Connection, keys: Sequence[str]) -> None:
    for table in (measurements, runs):
        statement = delete(table).where(table.c.run_key == bindparam("key"))
        if keys:
            connection.execute(statement, [{"key": key} for key in keys])


_LABEL_COLUMNS = ("study", "label", "seed", "discharge", "backend", "cache_version", "packing_key", "lineage_key")
_KEY_COLUMNS = ("run_key", "experiment_key", "scene_key")
_RECORD_COLUMNS = (
    *_LABEL_COLUMNS,
    *_KEY_COLUMNS,
    "outcome",
    "wall_time",
    "device_time",
    "finished",
    "device",
    "machine",
)
"""Columns that copy attributes of the record; of a damaged run only `_LABEL_COLUMNS` are filled."""


def stamps(folder: Path) -> dict[str, int]:
    """Stamp of each folder in `folder`."""
    return {name: stamp(folder / name) for name in folders(folder)}


def _size(folder: Path) -> int:
    files = (entry for entry in os.scandir(folder) if entry.is_file() and not is_derived(entry.name))
    return sum(entry.stat().st_size for entry in files)


def run_rows(folder: Path, observe: Observe | None) -> RunRows:
    """Make the row of a run and the rows of its measurements; an unreadable folder gives a row with the reason.

    It is thread-safe: it only reads the folder.
    """
    folder_stamp = stamp(folder)  # before it is read: what changes meanwhile is noticed later
    try:
        record, data = open_run(folder)
    except Unreadable as problem:
        return unreadable_row(folder, folder_stamp, problem), []
    return rows_of_run(folder, folder_stamp, record, data, observe or record.observe)


def rows_of_run(folder: Path, folder_stamp: int, record: RunRecord, data: RunData, observe: Observe) -> RunRows:
    """Make the rows of a run whose content is in memory, and evaluate its measures.

    Args:
        folder: Folder of the run in the lab.
        folder_stamp: Stamp of the folder with this content.
        record: Record of the run.
        data: Start and tables of the run.
        observe: Measures and window.
    """
    rows = derive(folder, observe, lambda: data)
    coverage = record.coverage
    row = {
        **{name: getattr(record, name) for name in _RECORD_COLUMNS},
        **{name: getattr(coverage, name) for name in ("grains", "discharged", "duration")},
        "rate": finite(record.rate),
        "bytes": _size(folder),
        "coverage": coverage.model_dump_json(),
        "stamp": folder_stamp,
        "problem": None,
        "suspect": suspicion(record.ledger),
    }
    return row, rows


def unreadable_row(folder: Path, folder_stamp: int, problem: Exception) -> dict[str, Any]:
    """Row of a run folder that cannot be read; values of its record are kept if that can be read."""
    row = _blank_run(folder, folder_stamp, str(problem))
    with suppress(Unreadable):
        record = RunRecord.read(folder)
        row |= {name: getattr(record, name) for name in _LABEL_COLUMNS}
    return row


def _blank_run(folder: Path, folder_stamp: int, problem: str) -> dict[str, Any]:
    row: dict[str, Any] = dict.fromkeys((column.key for column in runs.columns), None)
    identity = {"run_key": folder.name, "study": "", "label": "", "suspect": ""}
    return {**row, **identity, "outcome": UNREADABLE, "stamp": folder_stamp, "problem": _storable(problem)}


def _storable(text: str) -> str:
    """Text that any database can store: the path of a folder may have bytes that are not characters."""
    return text.encode("utf-8", "backslashreplace").decode().replace("\0", "\\0")  # PostgreSQL stores no NUL


def packing_row(folder: Path, record: PackingRecord | None = None) -> dict[str, Any]:
    """Make the row of a packing folder.

    Args:
        folder: Folder of the packing in the lab.
        record: Record that this process has just written; None: read and check the folder.
    """
    row = _blank_packing(folder, stamp(folder))
    try:
        record = record or read_packing(folder)[0]
    except Unreadable as problem:
        return {**row, "problem": _storable(str(problem))}
    columns = ("closed_key", "backend", "grains", "duration", "wall_time", "device_time", "machine")
    attributes = {name: getattr(record, name) for name in columns}
    return {**row, **attributes, "seed": record.filling.seed, "rate": finite(record.rate), "bytes": _size(folder)}


def _blank_packing(folder: Path, folder_stamp: int) -> dict[str, Any]:
    return {
        **dict.fromkeys(column.key for column in packings.columns),
        "packing_key": folder.name,
        "stamp": folder_stamp,
    }
