"""Writing the index: short transactions by the one process that coordinates; and making it again from the folders."""

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
    among,
    asking,
    beside,
    exchange,
    measurements,
    on_server,
    opened,
    packings,
    remove_file,
    runs,
    schema_version,
    storing,
    unusable,
    upsert,
    whole,
    writing,
)
from labbook.lab.evaluations import derive, expected, finite
from labbook.lab.folder import LabError, LabFolder, folders, is_beside, make_folder, remove, stamp
from labbook.lab.packings import PackingRecord, is_sealed, read_packing, seal
from labbook.lab.records import UNREADABLE, Observe, RunRecord, Unreadable
from labbook.lab.runs import open_run, run_data
from labbook.lab.suspect import suspicion
from labbook.measure import RunData

Tick = Callable[[int, int], None]
"""Told how many folders of how many are done."""
RunRows = tuple[dict[str, Any], list[dict[str, Any]]]
"""Row of a run, and rows of its measurements."""


@dataclass
class Indexed:
    """What was found: folders indexed, rows dropped because their folder is gone, what could not be read, by file or
    folder, and where a damaged index was put aside."""

    runs: int = 0
    packings: int = 0
    gone: int = 0
    unreadable: dict[Path, str] = field(default_factory=dict)
    aside: Path | None = None

    @property
    def problems(self) -> list[str]:
        """All that was wrong, in words."""
        lost = [f"{self.aside.with_suffix('')} was damaged: it is kept as {self.aside.name}, and made again from the "
                "folders"] if self.aside else []  # fmt: skip
        return lost + list(dict.fromkeys(self.unreadable.values()))


class Index:
    """The writer's side of a catalogue.

    Opening it brings the index up to date with the folders; it is made again if there is none, if it is of another
    version, if `again` says so, or if it is damaged, in which case the old file is put aside. It is made again beside
    the old one, which others read until the new one is whole. `found` has what that gave. Raises LabError if it cannot
    be written, or is damaged while it is in use.
    """

    def __init__(self, lab: LabFolder, *, again: bool = False, tick: Tick | None = None):
        self.lab = lab
        if lab.folder.exists() and not lab.folder.is_dir():
            raise LabError(f"{lab.folder} is a file, not a lab folder; give another one with --lab")
        make_folder(lab.folder)
        self.found = Indexed()
        self._indexed = set[str]()
        if not self._open():
            self.found.aside = self._put_aside()
            self._open()
        self._mend()
        if again:
            self._seal_packings()
        if again or not self._is_of_this_version():
            self._build(again, tick)
        self._sync(tick)

    def _mend(self) -> None:
        """Put back what a process that was killed, or a power failure, left between two names."""
        lab = self.lab
        lab.sweep("index")
        for key in lab.working():
            for kind, place in ((RunRecord, lab.run(key)), (PackingRecord, lab.packing(key))):
                if lab.is_torn(key, place) and (lab.replaced(key) / kind.FILE).exists() and (claim := lab.claim(key)):
                    lab.mend(key, place)
                    claim.release()

    def _open(self) -> bool:
        """Open the tables, whatever version they are of; False if their file is damaged."""
        self._engine = opened(self.lab, read_only=False)
        path = self.lab.catalogue
        if not on_server(self._engine) and path.exists() and not path.is_file():
            return False
        try:
            version = schema_version(self._engine)
            if version == DAMAGED or (version is not None and not whole(self._engine)):
                self._engine.dispose()
                return False
        except DatabaseError as error:
            raise unusable(self.lab, error) from error
        return True

    def _is_of_this_version(self) -> bool:
        try:
            return schema_version(self._engine) == SCHEMA_VERSION
        except DatabaseError as error:
            raise unusable(self.lab, error) from error

    def _build(self, again: bool, tick: Tick | None) -> None:
        """Index all folders beside the index, then put that in its place."""
        with self.lab.alone("index"):
            if not again and self._is_of_this_version():  # another process has made it meanwhile
                return
            with beside(self.lab) as built:
                old, self._engine = self._engine, built
                try:
                    self._sync(tick)
                finally:
                    self._engine = old
                exchange(self._engine, self.lab)

    def _seal_packings(self) -> None:
        """Give packings from before there were seals of arrays one. Where that cannot be, they stay as they are."""
        for key in folders(self.lab.packings):
            with suppress(OSError):
                if not is_sealed(self.lab.packing(key)) and (claim := self.lab.claim(key)):
                    try:
                        seal(self.lab.packing(key))
                    finally:
                        claim.release()

    def _put_aside(self) -> Path:
        path = self.lab.catalogue
        aside = path.with_name(f"{path.name}.damaged")
        remove(aside)
        path.rename(aside)
        remove_file(path)
        return aside

    def close(self) -> None:
        """Let go of the file."""
        self._engine.dispose()

    def add_run(self, folder: Path, observe: Observe | None = None) -> str | None:
        """Index one run folder with its measurements, replacing what was known; `observe` overrides its
        own. Why it cannot be read, or None."""
        return self.put_run(folder, run_rows(folder, observe))

    def put_run(self, folder: Path, rows: RunRows) -> str | None:
        """Index one run folder by what `run_rows` gives of it. Returns why it cannot be read, or None."""
        return self.put_runs({folder: rows})[folder]

    def put_runs(self, ended: Mapping[Path, RunRows]) -> dict[Path, str | None]:
        """Index run folders in one transaction.

        Args:
            ended: What `run_rows` gives of each folder.

        Returns:
            Why each folder cannot be read; None for one that can.
        """
        problems: dict[Path, str | None] = {folder: row["problem"] for folder, (row, _) in ended.items()}
        try:
            with self._transaction() as connection, storing():
                _replace_runs(connection, ended.values())
        except NotStored as why:
            if len(ended) > 1:  # only those that are not stored have a problem
                return {folder: self.put_run(folder, rows) for folder, rows in ended.items()}
            for folder, (row, _) in ended.items():
                problems[folder] = problem = f"{folder / RunRecord.FILE}: it cannot be indexed: {why}"
                with suppress(NotStored), self._transaction() as connection, storing():  # not even its name is stored
                    _replace_runs(connection, [(_blank_row(folder, row["stamp"], problem), [])])
        for folder, problem in problems.items():
            self._tell(folder, problem)
        return problems

    def add_packing(self, folder: Path) -> str | None:
        """Index one packing folder, and the runs that could not be read for want of it. Why it cannot be read, or
        None."""
        return self.put_packings({folder: packing_row(folder)})[folder]

    def put_packings(self, ended: Mapping[Path, dict[str, Any]]) -> dict[Path, str | None]:
        """Index packing folders in one transaction, and the runs that could not be read for want of them.

        Args:
            ended: What `packing_row` gives of each folder.

        Returns:
            Why each folder cannot be read; None for one that can.
        """
        problems = self._store_packings(ended)
        for folder, problem in problems.items():
            self._tell(folder, problem)
        query = select(runs.c.run_key).where(runs.c.problem.is_not(None))
        with self._asking() as connection:
            whole = [folder.name for folder, problem in problems.items() if not problem]
            waiting = [row.run_key for row in among(connection, query, runs.c.packing_key, whole)]
        for key in waiting:
            self.add_run(self.lab.run(key))
        return problems

    def _store_packings(self, ended: Mapping[Path, dict[str, Any]]) -> dict[Path, str | None]:
        """Take the rows of packings into the index, or in the place of one that cannot be stored a row that says why.
        Returns the problem of each, or None."""
        problems: dict[Path, str | None] = {folder: row["problem"] for folder, row in ended.items()}
        try:
            with self._transaction() as connection, storing():
                upsert(connection, packings, list(ended.values()))
        except NotStored as why:
            if len(ended) > 1:
                return {folder: self._store_packings({folder: row})[folder] for folder, row in ended.items()}
            for folder, row in ended.items():
                problems[folder] = problem = f"{folder / PackingRecord.FILE}: it cannot be indexed: {why}"
                with suppress(NotStored), self._transaction() as connection, storing():
                    upsert(connection, packings, [_blank_packing(folder, row["stamp"]) | {"problem": _kept(problem)}])
        return problems

    def problem(self, folder: Path) -> str | None:
        """Why a run or packing folder cannot be read, as far as it was looked at; None if it can be."""
        table, key = (runs, runs.c.run_key) if folder.parent == self.lab.runs else (packings, packings.c.packing_key)
        with self._asking() as connection:
            return connection.scalar(select(table.c.problem).where(key == folder.name))

    def note(self, folder: Path, problem: str) -> None:
        """Take down that something in `folder` could not be read."""
        self.found.unreadable[folder] = problem

    def _tell(self, folder: Path, problem: str | None) -> None:
        if problem:
            self.note(folder, problem)
        elif folder in self.found.unreadable:
            self.found.unreadable[folder] += "; it was made again"

    def derive(self, run_keys: Iterable[str], observe: Observe) -> int:
        """Measure whatever of `observe` is not there for these runs; the number of runs that were measured, or
        turned out to be damaged."""
        wanted, keys, done = expected(observe), list(run_keys), 0
        had = self._measured(keys)
        for key in keys:
            if wanted <= had[key]:
                continue
            folder = self.lab.run(key)
            done += 1
            seen = stamp(folder)
            try:
                record = RunRecord.read(folder)
                rows = derive(folder, observe, lambda folder=folder, record=record: run_data(folder, record))
                with self._transaction() as connection, storing():
                    upsert(connection, measurements, rows)
            except (Unreadable, NotStored) as problem:
                self.put_run(folder, (unreadable_row(folder, seen, problem), []))
        return done

    def _measured(self, run_keys: list[str]) -> dict[str, set[tuple[Any, ...]]]:
        """(measure, version, window) of what is there, by run."""
        names = ("run_key", "measure", "version", "window_start", "window_end", "window_timed", "window_scales")
        query = select(*(measurements.c[name] for name in names)).distinct()
        found: dict[str, set[tuple[Any, ...]]] = {key: set() for key in run_keys}
        with self._asking() as connection:
            for key, *measured in among(connection, query, measurements.c.run_key, run_keys):
                found[key].add(tuple(measured))
        return found

    def _sync(self, tick: Tick | None) -> None:
        """Index folders that are new or changed, and forget those that are gone."""
        found, repacked = self.found, self._sync_packings()
        there = stamps(self.lab.runs)
        with self._asking() as connection:
            rows = connection.execute(select(runs.c.run_key, runs.c.stamp, runs.c.packing_key, runs.c.problem)).all()
        known = {row.run_key: row.stamp for row in rows}
        # a process may have been killed between indexing a packing and the runs that could not be read for want of it
        moved = {row.run_key for row in rows if row.packing_key in repacked or (row.problem and row.packing_key)}
        new = [key for key, stamp in there.items() if known.get(key) != stamp or key in moved]
        changed = set(new)
        for row in rows:
            if row.problem and row.run_key in there and row.run_key not in changed:
                self.note(self.lab.run(row.run_key), row.problem)
        for at, key in enumerate(new, 1):
            self.add_run(self.lab.run(key))
            self._indexed.add(key)
            if tick:
                tick(at, len(new))
        gone = [key for key in known if key not in there]
        with self._transaction() as connection:
            _forget(connection, gone)
        found.gone, found.runs = len(gone), len(self._indexed)

    def _sync_packings(self) -> set[str]:
        """The same of packings; the keys of those that changed or are gone."""
        there = stamps(self.lab.packings)
        with self._asking() as connection:
            columns = packings.c.packing_key, packings.c.stamp, packings.c.problem
            found = connection.execute(select(*columns)).all()
        known = {row.packing_key: row.stamp for row in found}
        new = {key for key, stamp in there.items() if known.get(key) != stamp}
        rows = [packing_row(self.lab.packing(key)) for key in sorted(new)]
        self.found.packings += len(rows)
        lost = {row["packing_key"]: row["problem"] for row in rows}
        lost |= {row.packing_key: row.problem for row in found if row.packing_key in there.keys() - new}
        for key, problem in lost.items():
            if problem:
                self.note(self.lab.packing(key), problem)
        gone = known.keys() - there.keys()
        self._store_packings({self.lab.packing(row["packing_key"]): row for row in rows})
        with self._transaction() as connection:
            for key in gone:
                connection.execute(delete(packings).where(packings.c.packing_key == key))
        return new | gone

    def _asking(self) -> AbstractContextManager[Connection]:
        return asking(self._engine, self.lab)

    def _transaction(self) -> AbstractContextManager[Connection]:
        return writing(self._engine, self.lab)


def _replace_runs(connection: Connection, ended: Iterable[RunRows]) -> None:
    ended = list(ended)
    _forget(connection, [row["run_key"] for row, _ in ended])
    upsert(connection, runs, [row for row, _ in ended])
    upsert(connection, measurements, [measured for _, rows in ended for measured in rows])


def _forget(connection: Connection, keys: Sequence[str]) -> None:
    for table in (measurements, runs):
        of_key = delete(table).where(table.c.run_key == bindparam("key"))
        if keys:
            connection.execute(of_key, [{"key": key} for key in keys])


_KNOWN = ("study", "label", "seed", "discharge", "backend", "cache_version", "packing_key", "lineage_key")
_KEYS = ("run_key", "experiment_key", "scene_key")
_OF_RECORD = (*_KNOWN, *_KEYS, "outcome", "wall_time", "finished", "device", "machine")
"""What of a run's record is in its row; of a damaged run only what is known by the first names."""


def stamps(folder: Path) -> dict[str, int]:
    """Folders in `folder`, each with its stamp."""
    return {name: stamp(folder / name) for name in folders(folder)}


def _size(folder: Path) -> int:
    files = (entry for entry in os.scandir(folder) if entry.is_file() and not is_beside(entry.name))
    return sum(entry.stat().st_size for entry in files)


def run_rows(folder: Path, observe: Observe | None) -> RunRows:
    """Row of a run, and of its measurements, taken now; of a folder that cannot be read, a row that says so. Any thread
    may ask for them."""
    seen = stamp(folder)  # before it is read: what changes meanwhile is noticed later
    try:
        record, data = open_run(folder)
    except Unreadable as problem:
        return unreadable_row(folder, seen, problem), []
    return rows_of_run(folder, seen, record, data, observe or record.observe)


def rows_of_run(folder: Path, seen: int, record: RunRecord, data: RunData, observe: Observe) -> RunRows:
    """Row of a run whose content is known, and of its measurements, taken now.

    Args:
        folder: Folder of the run in the lab.
        seen: Stamp of the folder with this content.
        record: Record of the run.
        data: Start and tables of the run.
        observe: What is measured.
    """
    rows = derive(folder, observe, lambda: data)
    coverage = record.coverage
    row = {
        **{name: getattr(record, name) for name in _OF_RECORD},
        **{name: getattr(coverage, name) for name in ("grains", "discharged", "duration")},
        "rate": finite(record.rate),
        "bytes": _size(folder),
        "coverage": coverage.model_dump_json(),
        "stamp": seen,
        "problem": None,
        "suspect": suspicion(record.ledger),
    }
    return row, rows


def unreadable_row(folder: Path, seen: int, problem: Exception) -> dict[str, Any]:
    """Row of a run folder with the stamp `seen` that cannot be read; what its record says of it is kept."""
    row = _blank_row(folder, seen, str(problem))
    with suppress(Unreadable):
        record = RunRecord.read(folder)
        row |= {name: getattr(record, name) for name in _KNOWN}
    return row


def _blank_row(folder: Path, seen: int, problem: str) -> dict[str, Any]:
    row: dict[str, Any] = dict.fromkeys((column.key for column in runs.columns), None)
    named = {"run_key": folder.name, "study": "", "label": "", "suspect": ""}
    return {**row, **named, "outcome": UNREADABLE, "stamp": seen, "problem": _kept(problem)}


def _kept(text: str) -> str:
    """Text as any database keeps it: the path of a folder may have bytes that are no characters."""
    return text.encode("utf-8", "backslashreplace").decode().replace("\0", "\\0")


def packing_row(folder: Path, record: PackingRecord | None = None) -> dict[str, Any]:
    """Row of a packing folder. `record`: that of the packing, where this process has just written it; None reads and
    checks the folder."""
    row = _blank_packing(folder, stamp(folder))
    try:
        record = record or read_packing(folder)[0]
    except Unreadable as problem:
        return {**row, "problem": _kept(str(problem))}
    known = ("closed_key", "backend", "grains", "duration", "wall_time", "machine")
    told = {name: getattr(record, name) for name in known}
    return {**row, **told, "seed": record.filling.seed, "rate": finite(record.rate), "bytes": _size(folder)}


def _blank_packing(folder: Path, seen: int) -> dict[str, Any]:
    return {**dict.fromkeys(column.key for column in packings.columns), "packing_key": folder.name, "stamp": seen}
