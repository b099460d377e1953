"""The database of the index: its tables, which several processes read and one at a time writes. They are in an SQLite
file of the lab, or on a server (`labbook.lab.server`).

Tables are never migrated: another SCHEMA_VERSION means that the index is made again.
"""

import os
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Connection,
    Engine,
    Float,
    Index,
    Inspector,
    Integer,
    MetaData,
    Row,
    Select,
    String,
    Table,
    Text,
    create_engine,
    event,
    func,
    inspect,
    select,
    text,
)
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.exc import DatabaseError, DataError, IntegrityError, InterfaceError, ProgrammingError
from sqlalchemy.pool import QueuePool
from sqlalchemy.schema import CreateSchema, CreateTable, DropSchema
from sqlalchemy.sql import Executable

from labbook.commands import command
from labbook.lab import server
from labbook.lab.folder import DiskFull, LabError, LabFolder, file_system, is_network, remove
from labbook.lab.server import BUSY

SCHEMA_VERSION = 7

metadata = MetaData()

_NAME = String().with_variant(String(collation="C"), "postgresql")
"""Text that is sorted alike by all databases."""


def _only(condition: str) -> dict[str, Any]:
    """Keywords of an index that has only the rows which fulfil a condition."""
    return {f"{dialect}_where": text(condition) for dialect in ("sqlite", "postgresql")}


about = Table("about", metadata, Column("schema_version", Integer, primary_key=True))

runs = Table(
    "runs",
    metadata,
    Column("run_key", _NAME, primary_key=True),
    Column("study", _NAME, nullable=False, default=""),
    Column("label", _NAME, nullable=False, default=""),
    Column("seed", BigInteger),
    Column("discharge", BigInteger),
    Column("engine", _NAME, key="backend"),
    Column("cache_version", Integer),
    Column("outcome", _NAME, nullable=False),
    Column("grains", Integer),
    Column("discharged", Float),
    Column("duration", Float),
    Column("wall_time", Float),
    Column("rate", Float),
    Column("finished", _NAME),
    Column("device", _NAME),
    Column("machine", _NAME),
    Column("bytes", BigInteger),
    Column("experiment_key", _NAME),
    Column("scene_key", _NAME),
    Column("packing_key", _NAME),
    Column("lineage_key", _NAME),
    Column("coverage", Text),
    Column("stamp", BigInteger, nullable=False),
    Column("problem", Text),
    Column("suspect", Text, nullable=False, default=""),
    Index("runs_by_lineage", "lineage_key"),
    Index("runs_by_study", "study", "backend", "outcome", "finished"),
    Index("runs_by_finish", "finished"),
    Index("runs_by_packing", "packing_key"),
    Index("runs_damaged", "run_key", **_only("problem IS NOT NULL")),
    Index("runs_suspect", "run_key", **_only("suspect != ''")),
    sqlite_with_rowid=True,
)
"""One row a run folder. `coverage`: that of `run.json`, as JSON; `stamp`: that of the folder
(`labbook.lab.folder.stamp`) when it was read, by which changes are noticed; `outcome` is `unreadable` and `problem`
says why where a folder cannot be read; `suspect`: why the run is (`labbook.lab.suspect`), empty if it is not."""

packings = Table(
    "packings",
    metadata,
    Column("packing_key", _NAME, primary_key=True),
    Column("closed_key", _NAME),
    Column("engine", _NAME, key="backend"),
    Column("seed", BigInteger),
    Column("grains", Integer),
    Column("duration", Float),
    Column("wall_time", Float),
    Column("rate", Float),
    Column("machine", _NAME),
    Column("bytes", BigInteger),
    Column("stamp", BigInteger, nullable=False),
    Column("problem", Text),
)

measurements = Table(
    "measurements",
    metadata,
    Column("run_key", _NAME, primary_key=True),
    Column("quantity", _NAME, primary_key=True),
    Column("version", Integer, primary_key=True),
    Column("window_start", Float, primary_key=True),
    Column("window_end", Float, primary_key=True),
    Column("window_timed", Boolean, primary_key=True),
    Column("window_scales", _NAME, primary_key=True),
    Column("measure", _NAME, nullable=False),
    Column("value", Float),
    Column("error", Float),
    Column("n_effective", Float),
    Column("window", _NAME, nullable=False),
    Column("method", _NAME, nullable=False),
    Column("unit", _NAME, nullable=False),
    Column("note", _NAME, nullable=False),
)
"""What was measured in a run, by version of the measure and by window (fractions of the initial mass
discharged, or times); `window_scales`: what the window states of `labbook.measure.scales`. A measure that gives
nothing, or that failed, leaves a row with its own name as quantity, no value, and a note."""

_CHUNK = 500
"""Keys in one query, well below SQLite's limit on variables."""
DAMAGED = -1
_OUT_OF_REACH = ("locked", "full", "readonly", "unable to open", "disk I/O", "not authorized", "interrupted")


class NoCatalogue(LabError):
    """There is no catalogue, it is damaged, or of another version of labbook; the message says what to do."""

    def __init__(self, lab: LabFolder, what: str):
        place = server.address(lab)
        where = f"the index at {place.shown}" if place else lab.catalogue
        super().__init__(f"{where} {what}; make it again: {command('reindex', lab=lab.folder)}")


class NotStored(Exception):
    """A row that the database does not take; the message says why."""


def opened(lab: LabFolder, *, read_only: bool) -> Engine:
    """An SQLAlchemy engine for the index of a lab, wherever that is. Raises LabError."""
    place = server.address(lab)
    return server.engine(place) if place else connect(lab.catalogue, read_only=read_only)


def on_server(engine: Engine | Connection) -> bool:
    """Whether these tables are on a server, and not in a file."""
    return engine.dialect.name == "postgresql"


def connect(path: Path, *, read_only: bool) -> Engine:
    """An SQLAlchemy engine on an SQLite file.

    Of a file that nobody can write to, and that no log belongs to, SQLite may not make the log that it reads by: it is
    then opened as one that does not change.
    """
    mode = "ro" if read_only else "rwc"
    if read_only and not os.access(path.parent, os.W_OK) and not path.with_name(f"{path.name}-wal").exists():
        mode += "&immutable=1"
    uri = f"{_uri(path)}?mode={mode}"
    engine = create_engine(
        "sqlite://",
        creator=lambda: sqlite3.connect(uri, uri=True, timeout=BUSY, isolation_level=None, check_same_thread=False),
        poolclass=QueuePool,  # of an address like this SQLAlchemy would think that it is in memory: one each thread
    )
    if not read_only:

        @event.listens_for(engine, "connect")
        def _durable(connection, _record):
            kept = keep_journal(connection, path)
            connection.execute(f"PRAGMA synchronous={'NORMAL' if kept == 'wal' else 'FULL'}")

    return engine


def _uri(path: Path) -> str:
    """The address of a file by SQLite's rules; its path may have bytes that are no characters."""
    return f"file:{quote(os.fsencode(path.resolve()))}"


def remove_file(path: Path) -> None:
    """Remove an SQLite file with its log."""
    for suffix in ("", "-wal", "-shm"):
        remove(path.with_name(path.name + suffix))


def keep_journal(connection: sqlite3.Connection, path: Path) -> str:
    """Choose how changes of the file are kept until they are whole; the mode that SQLite then has.

    `wal`, so that nobody waits to read; `delete` where that cannot be, or where several hosts may read the file: what
    readers share of a write-ahead log is memory of one host (sqlite.org/wal.html).
    """
    mode = "DELETE" if is_network(file_system(path.parent)) else "WAL"
    return connection.execute(f"PRAGMA journal_mode={mode}").fetchone()[0]


def schema_version(engine: Engine) -> int | None:
    """Version of the index; None if it has none, DAMAGED if the file is no database at all."""
    try:
        with engine.connect() as connection:
            return connection.scalar(text("SELECT schema_version FROM about"))
    except DatabaseError as error:
        if "no such table" in str(error.orig) or 'relation "about" does not exist' in str(error.orig):
            return None
        if damaged(error):
            return DAMAGED
        raise


def whole(engine: Engine) -> bool:
    """Whether every page of the index can be read; a server sees to its own."""
    if on_server(engine):
        return True
    try:
        with engine.connect() as connection:
            return connection.scalar(text("PRAGMA quick_check(1)")) == "ok"
    except DatabaseError as error:
        if damaged(error):
            return False
        raise


def damaged(error: DatabaseError) -> bool:
    """Whether an error tells of a damaged file, and not of one that is locked, full or out of reach."""
    return isinstance(error.orig, sqlite3.Error) and not any(words in str(error.orig) for words in _OUT_OF_REACH)


def unusable(lab: LabFolder, error: DatabaseError) -> LabError:
    """What an error of the database of `lab` means to its user."""
    why, path = str(error.orig), lab.catalogue
    if place := server.address(lab):
        return LabError(
            f"{place.shown}: {server.why(error)}; check that the server can be reached, or move the index back: "
            f"{command('reindex', '--index', 'file', lab=lab.folder)}"
        )
    if damaged(error):
        return NoCatalogue(lab, f"is damaged ({why})")
    if "full" in why:
        return DiskFull(path)
    if "locked" in why:
        return LabError(f"{path}: another labbook has been writing to it for {BUSY:g} s; give the same command again")
    return LabError(
        f"{path}: {why}; get permission to read and write the files in {lab.folder}, or use a copy of the folder"
    )


@contextmanager
def storing() -> Iterator[None]:
    """Within a transaction: an error that the values of a row cause is raised as NotStored."""
    try:
        yield
    except (DataError, IntegrityError, InterfaceError, ProgrammingError) as error:
        raise NotStored(server.why(error)) from error
    except (OverflowError, UnicodeError) as error:  # a number that does not fit, half a character
        raise NotStored(str(error)) from error


@contextmanager
def asking(engine: Engine, lab: LabFolder) -> Iterator[Connection]:
    """A connection to the index of a lab. Raises LabError."""
    try:
        with engine.connect() as connection:
            yield connection
    except DatabaseError as error:
        raise unusable(lab, error) from error


_ALONE = "SELECT pg_advisory_xact_lock(hashtext(current_setting('search_path')))"
"""Begins a transaction that waits, on a server, until no other one writes to the same index."""


@contextmanager
def writing(engine: Engine, lab: LabFolder) -> Iterator[Connection]:
    """A transaction that is done as a whole or not at all. Raises LabError."""
    with asking(engine, lab) as connection:
        connection.execute(text(_ALONE if on_server(engine) else "BEGIN IMMEDIATE"))
        yield connection
        connection.commit()


def make_tables(connection: Connection) -> None:
    """Make the tables of an index, which has none."""
    metadata.create_all(connection)
    connection.execute(about.insert().values(schema_version=SCHEMA_VERSION))


@contextmanager
def beside(lab: LabFolder) -> Iterator[Engine]:
    """A second, empty index of a lab, which nobody looks at; it is gone afterwards. One process at a time may have
    it. Raises LabError."""
    place, path = server.address(lab), _path_beside(lab)
    if place is None:
        remove_file(path)  # left by a process that was killed
        engine = connect(path, read_only=False)
    else:
        engine = server.engine(place.beside)
    try:
        with writing(engine, lab) as connection:
            if place is not None:
                connection.execute(DropSchema(place.beside.schema, cascade=True, if_exists=True))
                connection.execute(CreateSchema(place.beside.schema))
            make_tables(connection)
        yield engine
    finally:
        engine.dispose()
        if place is None:
            remove_file(path)


def _path_beside(lab: LabFolder) -> Path:
    return lab.catalogue.with_name(f"{lab.catalogue.name}.new")


def exchange(engine: Engine, lab: LabFolder) -> None:
    """Put the index that was built `beside` in place of that of a lab, in one transaction. Rows that only the old one
    has are kept: they may be of runs that ended meanwhile. Raises LabError."""
    if on_server(engine):
        with writing(engine, lab) as connection:
            place = server.address(lab)
            assert place is not None
            connection.execute(CreateSchema(place.schema, if_not_exists=True))
            exchange_tables(connection, place.schema, place.beside.schema)
            connection.execute(DropSchema(place.beside.schema, cascade=True))
        return
    with asking(engine, lab) as connection:
        connection.execute(text("ATTACH DATABASE :built AS built"), {"built": _uri(_path_beside(lab))})
        try:
            connection.execute(text("BEGIN IMMEDIATE"))
            exchange_tables(connection, "main", "built")
            connection.commit()
        finally:
            connection.rollback()
            connection.execute(text("DETACH DATABASE built"))


def exchange_tables(connection: Connection, old: str, new: str) -> None:
    """`old` and `new`: names of the schemas whose tables are to change places."""
    names = {table.name: ", ".join(f'"{column.name}"' for column in table.columns) for table in metadata.sorted_tables}
    there = inspect(connection)
    if all(_has(there, table) for table in metadata.sorted_tables):
        for table, key, owner in (
            (measurements, "run_key", runs),  # before the runs that tell which of them are known
            (runs, "run_key", runs),
            (packings, "packing_key", packings),
        ):
            listed, known = names[table.name], f'SELECT {key} FROM "{new}".{owner.name}'
            only = f'SELECT {listed} FROM "{old}".{table.name} WHERE {key} NOT IN ({known})'
            connection.execute(text(f'INSERT INTO "{new}".{table.name} ({listed}) {only}'))
    for name in there.get_table_names():
        connection.execute(text(f'DROP TABLE "{old}"."{name}"'))
    if on_server(connection):
        for name in names:
            connection.execute(text(f'ALTER TABLE "{new}".{name} SET SCHEMA "{old}"'))
        return
    make_tables(connection)
    for name, listed in names.items():
        if name != about.name:
            connection.execute(text(f'INSERT INTO "{old}".{name} ({listed}) SELECT {listed} FROM "{new}".{name}'))


def _has(there: Inspector, table: Table) -> bool:
    """Whether a table is there, with all its columns."""
    if not there.has_table(table.name):
        return False
    return {column.name for column in table.columns} == {column["name"] for column in there.get_columns(table.name)}


def empty() -> Engine:
    """An index of nothing, in memory: each thread has its own."""
    engine = create_engine("sqlite://")

    @event.listens_for(engine, "connect")
    def _made(connection, _record):
        for table in metadata.sorted_tables:
            connection.execute(str(CreateTable(table).compile(engine)))

    return engine


def among(connection: Connection, query: Select, column: Column, keys: Iterable[str]) -> list[Row]:
    """The rows of `query` whose `column` is one of `keys`, however many these are."""
    keys, found = list(keys), []
    if len(keys) > _CHUNK and (connection.scalar(select(func.count()).select_from(column.table)) or 0) <= len(keys):
        keys = sorted({*keys} & {*connection.scalars(select(column))})
    for at in range(0, len(keys), _CHUNK):
        found += connection.execute(query.where(column.in_(keys[at : at + _CHUNK])))
    return found


def add_measurements(lab: LabFolder, rows: list[dict[str, Any]]) -> None:
    """Take rows of measurements of indexed runs into the index of a lab, which stays as it is if it cannot be written
    to: they are then worked out again from what is kept beside the runs. Raises LabError for a damaged one."""
    if not rows or not os.access(lab.folder, os.W_OK):
        return
    if not server.address(lab) and not os.access(lab.catalogue, os.W_OK):
        return
    engine = opened(lab, read_only=False)
    try:
        with writing(engine, lab) as connection:
            upsert(connection, measurements, rows)
    finally:
        engine.dispose()


def upsert(connection: Connection, table: Table, rows: list[dict[str, Any]]) -> None:
    """Take rows into a table, in place of those with the same key."""
    if rows:
        connection.execute(_upserting(table, on_server(connection)), rows)


@cache
def _upserting(table: Table, server: bool) -> Executable:
    """The statement of `upsert`: making it takes longer than carrying it out."""
    statement = (postgresql if server else sqlite).insert(table)
    changed = {column.key: statement.excluded[column.key] for column in table.columns if not column.primary_key}
    return statement.on_conflict_do_update(index_elements=list(table.primary_key.columns), set_=changed)
