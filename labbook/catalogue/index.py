"""Writing the index: short transactions by the one process that coordinates; and making it again from the
folders."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Table, delete, inspect, select, text
from sqlalchemy.dialects.sqlite import insert
from sqlalchemy.exc import OperationalError

from labbook.catalogue.connect import DAMAGED, connect, schema_version
from labbook.catalogue.derive import derive, expected
from labbook.catalogue.lab import DiskFull, Lab
from labbook.catalogue.parts import Unreadable
from labbook.catalogue.record import Observe, RunRecord
from labbook.catalogue.rows import packing_row, run_rows, stamps, unreadable_row
from labbook.catalogue.schema import SCHEMA_VERSION, about, measurements, metadata, packings, runs

Tick = Callable[[int, int], None]
"""Told how many folders of how many are done."""


@dataclass
class Indexed:
    """What was found: folders indexed, rows dropped because their folder is gone, and what could not be
    read."""

    runs: int = 0
    packings: int = 0
    gone: int = 0
    problems: list[str] = field(default_factory=list)


class Index:
    """The writer's side of a catalogue.

    Opening it brings the index up to date with the folders; it is made again if it is of another version or damaged,
    or if `again` says so. `found` has what that gave.
    """

    def __init__(self, lab: Lab, *, again: bool = False, tick: Tick | None = None):
        self.lab = lab
        lab.folder.mkdir(parents=True, exist_ok=True)
        self._engine = connect(lab.catalogue, read_only=False)
        version = schema_version(self._engine)
        if version == DAMAGED:
            self._engine.dispose()
            for suffix in ("", "-wal", "-shm"):
                lab.catalogue.with_name(lab.catalogue.name + suffix).unlink(missing_ok=True)
        if again or version != SCHEMA_VERSION:
            self._clear()
        self.found = self._sync(tick)

    def close(self) -> None:
        """Let go of the file."""
        self._engine.dispose()

    def add_run(self, folder: Path, observe: Observe | None = None) -> None:
        """Index one run folder with its measurements, replacing what was known; `observe` overrides its
        own."""
        row, rows = run_rows(folder, observe)
        with self._transaction() as connection:
            _replace_run(connection, row, rows)

    def add_packing(self, folder: Path) -> None:
        """Index one packing folder."""
        with self._transaction() as connection:
            _upsert(connection, packings, [packing_row(folder)])

    def derive(self, run_keys: Iterable[str], observe: Observe) -> int:
        """Measure whatever of `observe` is not there for these runs; the number of runs that were
        measured."""
        wanted = expected(observe)
        columns = (
            measurements.c.measure,
            measurements.c.version,
            measurements.c.window_start,
            measurements.c.window_end,
        )
        done = 0
        for key in run_keys:
            with self._engine.connect() as connection:
                had = {tuple(row) for row in connection.execute(select(*columns).where(measurements.c.run_key == key))}
            if wanted <= had:
                continue
            folder = self.lab.run(key)
            try:
                rows = derive(folder, RunRecord.read(folder), observe)
            except Unreadable as problem:
                with self._transaction() as connection:
                    _upsert(connection, runs, [unreadable_row(folder, problem)])
                continue
            with self._transaction() as connection:
                _upsert(connection, measurements, rows)
            done += 1
        return done

    def _sync(self, tick: Tick | None) -> Indexed:
        """Index folders that are new or replaced, and forget those that are gone."""
        found = Indexed()
        self._sync_packings(found)
        there = stamps(self.lab.runs)
        with self._engine.connect() as connection:
            known = {key: stamp for key, stamp in connection.execute(select(runs.c.run_key, runs.c.stamp))}
        new = [key for key, stamp in there.items() if known.get(key) != stamp]
        for at, key in enumerate(new, 1):
            row, rows = run_rows(self.lab.run(key), None)
            if row["problem"]:
                found.problems.append(row["problem"])
            with self._transaction() as connection:
                _replace_run(connection, row, rows)
            found.runs += 1
            if tick:
                tick(at, len(new))
        gone = [key for key in known if key not in there]
        with self._transaction() as connection:
            for key in gone:
                _forget(connection, key)
        found.gone = len(gone)
        return found

    def _sync_packings(self, found: Indexed) -> None:
        there = stamps(self.lab.packings)
        with self._engine.connect() as connection:
            known = {key: stamp for key, stamp in connection.execute(select(packings.c.packing_key, packings.c.stamp))}
        rows = [packing_row(self.lab.packing(key)) for key, stamp in there.items() if known.get(key) != stamp]
        found.packings = len(rows)
        found.problems += [row["problem"] for row in rows if row["problem"]]
        with self._transaction() as connection:
            _upsert(connection, packings, rows)
            for key in known.keys() - there.keys():
                connection.execute(delete(packings).where(packings.c.packing_key == key))

    def _clear(self) -> None:
        """Forget everything."""
        with self._transaction() as connection:
            for name in inspect(connection).get_table_names():
                connection.execute(text(f'DROP TABLE "{name}"'))
            metadata.create_all(connection)
            connection.execute(about.insert().values(schema_version=SCHEMA_VERSION))

    @contextmanager
    def _transaction(self) -> Iterator[Connection]:
        try:
            with self._engine.connect() as connection:
                connection.execute(text("BEGIN IMMEDIATE"))
                yield connection
                connection.commit()
        except OperationalError as error:
            if "full" in str(error.orig):
                raise DiskFull(self.lab.catalogue) from error
            raise


def _upsert(connection: Connection, table: Table, rows: list[dict[str, Any]]) -> None:
    if not rows:
        return
    statement = insert(table)
    changed = {column.name: statement.excluded[column.name] for column in table.columns if not column.primary_key}
    connection.execute(
        statement.on_conflict_do_update(index_elements=list(table.primary_key.columns), set_=changed), rows
    )


def _replace_run(connection: Connection, row: dict[str, Any], rows: list[dict[str, Any]]) -> None:
    _forget(connection, row["run_key"])
    _upsert(connection, runs, [row])
    _upsert(connection, measurements, rows)


def _forget(connection: Connection, key: str) -> None:
    connection.execute(delete(measurements).where(measurements.c.run_key == key))
    connection.execute(delete(runs).where(runs.c.run_key == key))
