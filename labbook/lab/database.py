"""Tables of the index, and access to them: in an SQLite file of the lab, or on a server (`labbook.lab.server`).

Several processes read them, one at a time writes. Tables are never migrated: an index with another SCHEMA_VERSION is
built again from the folders.
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

SCHEMA_VERSION = 8

metadata = MetaData()

_NAME = String().with_variant(String(collation="C"), "postgresql")
"""Text that all databases sort by the same rule."""


def _only(condition: str) -> dict[str, Any]:
    """Keywords that restrict an SQL index to the rows that fulfil a condition."""
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
    Column("device_time", Float),
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
"""Table with one row for each run folder.

`coverage`: that of `run.json`, as JSON. `stamp`: stamp of the folder (`labbook.lab.folder.stamp`) when it was read,
which shows later changes. `device_time`: absent of runs of older versions. `outcome` is `unreadable` and `problem`
gives the reason where a folder cannot be read. `suspect`: reason for which the run is suspect
(`labbook.lab.suspect`), else empty.
"""

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
    Column("device_time", Float),
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
"""Table of measured numbers, by run, version of the measure and window.

The window is in fractions of the initial mass discharged, or in times; `window_scales` has its settings of
`labbook.measure.scales`. A measure that failed, or gives no number, has a row with its own name as quantity, no value,
and a note.
"""

_CHUNK = 500
"""Keys in one query, well below SQLite's limit on variables."""
DAMAGED = -1
_OUT_OF_REACH = ("locked", "full", "readonly", "unable to open", "disk I/O", "not authorized", "interrupted")


class NoCatalogue(LabError):
    """The index is missing, damaged, or of another version of labbook; the message gives the remedy."""

    def __init__(self, lab: LabFolder, fault: str):
        address = server.address(lab)
        where = f"the index at {address.display}" if address else lab.catalogue
        super().__init__(f"{where} {fault}; make it again: {command('reindex', lab=lab.folder)}")


class NotStored(Exception):
    """The database rejects a row; the message gives the reason."""


def open_engine(lab: LabFolder, *, read_only: bool) -> Engine:
    """Open the index of a lab, in its file or on its server.

    Args:
        lab: Folder of the lab.
        read_only: Open an SQLite file for reading only.

    Raises:
        LabError: The address of the server cannot be read, or its driver is missing.
    """
    address = server.address(lab)
    return server.engine(address) if address else connect(lab.catalogue, read_only=read_only)


def on_server(engine: Engine | Connection) -> bool:
    """Return True if the tables are on a server, False if they are in a file."""
    return engine.dialect.name == "postgresql"


def connect(path: Path, *, read_only: bool) -> Engine:
    """Open an SQLAlchemy engine on an SQLite file.

    Args:
        path: The file; it is made if it is missing and `read_only` is false.
        read_only: Open it for reading. A file in a read-only folder, without a write-ahead log, is opened as immutable:
            SQLite cannot create the log through which it would read.
    """
    mode = "ro" if read_only else "rwc"
    if read_only and not os.access(path.parent, os.W_OK) and not path.with_name(f"{path.name}-wal").exists():
        mode += "&immutable=1"
    uri = f"{_uri(path)}?mode={mode}"
    # isolation_level=None: else sqlite3 would begin deferred transactions of its own (see `transaction`).
    # check_same_thread=False: the pool may lend a connection to another thread than the one that opened it.
    engine = create_engine(
        "sqlite://",
        creator=lambda: sqlite3.connect(uri, uri=True, timeout=BUSY, isolation_level=None, check_same_thread=False),
        poolclass=QueuePool,  # of an address like this SQLAlchemy would think that it is in memory: one each thread
    )
    if not read_only:

        @event.listens_for(engine, "connect")
        def _durable(connection, _record):
            mode_of_journal = keep_journal(connection, path)
            # In WAL mode NORMAL cannot corrupt the file; a power failure may undo the last transactions, which the
            # next `Index` makes again from the folders (sqlite.org/pragma.html#pragma_synchronous).
            connection.execute(f"PRAGMA synchronous={'NORMAL' if mode_of_journal == 'wal' else 'FULL'}")

    return engine


def _uri(path: Path) -> str:
    """URI of a file by SQLite's rules; a path may have bytes that are not characters."""
    return f"file:{quote(os.fsencode(path.resolve()))}"


def remove_file(path: Path) -> None:
    """Remove an SQLite file with its write-ahead log."""
    for suffix in ("", "-wal", "-shm"):  # a log that stays would be taken for that of the next file of this name
        remove(path.with_name(path.name + suffix))


def keep_journal(connection: sqlite3.Connection, path: Path) -> str:
    """Set the journal mode of an SQLite file, and return the mode that SQLite then uses.

    The mode is `wal`, with which readers never wait. It is `delete` on network file systems, and where SQLite refuses
    `wal`: readers of a write-ahead log share memory of one host (sqlite.org/wal.html).
    """
    mode = "DELETE" if is_network(file_system(path.parent)) else "WAL"
    return connection.execute(f"PRAGMA journal_mode={mode}").fetchone()[0]


def schema_version(engine: Engine) -> int | None:
    """Read the version of the index; None if it has none, DAMAGED if the file is not a database."""
    try:
        with engine.connect() as connection:
            return connection.scalar(text("SELECT schema_version FROM about"))
    except DatabaseError as error:
        if "no such table" in str(error.orig) or 'relation "about" does not exist' in str(error.orig):
            return None
        if is_damage(error):
            return DAMAGED
        raise


def is_intact(engine: Engine) -> bool:
    """Check that every page of the index can be read; an index on a server counts as intact."""
    if on_server(engine):
        return True
    try:
        with engine.connect() as connection:
            return connection.scalar(text("PRAGMA quick_check(1)")) == "ok"
    except DatabaseError as error:
        if is_damage(error):
            return False
        raise


def is_damage(error: DatabaseError) -> bool:
    """Decide whether an error means a damaged file, and not one that is locked, full or out of reach."""
    return isinstance(error.orig, sqlite3.Error) and not any(words in str(error.orig) for words in _OUT_OF_REACH)


def index_error(lab: LabFolder, error: DatabaseError) -> LabError:
    """Translate an error of the database of `lab` into a LabError with a remedy."""
    why, path = str(error.orig), lab.catalogue
    if address := server.address(lab):
        return LabError(
            f"{address.display}: {server.why(error)}; check that the server can be reached, or move the index back: "
            f"{command('reindex', '--index', 'file', lab=lab.folder)}"
        )
    if is_damage(error):
        return NoCatalogue(lab, f"is damaged ({why})")
    if "full" in why:
        return DiskFull(path)
    if "locked" in why:
        return LabError(f"{path}: another labbook has been writing to it for {BUSY:g} s; give the same command again")
    return LabError(
        f"{path}: {why}; get permission to read and write the files in {lab.folder}, or use a copy of the folder"
    )


@contextmanager
def storage_errors() -> Iterator[None]:
    """Within a transaction, raise NotStored for errors that values of a row cause."""
    try:
        yield
    except (DataError, IntegrityError, InterfaceError, ProgrammingError) as error:
        raise NotStored(server.why(error)) from error
    except (OverflowError, UnicodeError) as error:  # a number that does not fit, half a character
        raise NotStored(str(error)) from error


@contextmanager
def open_connection(engine: Engine, lab: LabFolder) -> Iterator[Connection]:
    """Connect to the index of a lab. Raises LabError."""
    try:
        with engine.connect() as connection:
            yield connection
    except DatabaseError as error:
        raise index_error(lab, error) from error


_ALONE = "SELECT pg_advisory_xact_lock(hashtext(current_setting('search_path')))"
"""First statement of a transaction on a server: wait until no other transaction writes to the same index."""


@contextmanager
def transaction(engine: Engine, lab: LabFolder) -> Iterator[Connection]:
    """Run a transaction, which is committed at the end unless an error is raised. Raises LabError."""
    with open_connection(engine, lab) as connection:
        # IMMEDIATE takes the write lock now. A deferred transaction would read first, and fail at its first write,
        # without waiting, if another process had written in between.
        connection.execute(text(_ALONE if on_server(engine) else "BEGIN IMMEDIATE"))
        yield connection
        connection.commit()


def make_tables(connection: Connection) -> None:
    """Create the tables in an index that has none."""
    metadata.create_all(connection)
    connection.execute(about.insert().values(schema_version=SCHEMA_VERSION))


@contextmanager
def shadow_index(lab: LabFolder) -> Iterator[Engine]:
    """Create a second, empty index of a lab, which no reader uses; it is removed at the end.

    The caller has to hold the lock `index` of the lab: only one process at a time may build it. Raises LabError.
    """
    address, path = server.address(lab), _shadow_path(lab)
    if address is None:
        remove_file(path)  # left by a process that was killed
        engine = connect(path, read_only=False)
    else:
        engine = server.engine(address.shadow_index)
    try:
        with transaction(engine, lab) as connection:
            if address is not None:
                connection.execute(DropSchema(address.shadow_index.schema, cascade=True, if_exists=True))
                connection.execute(CreateSchema(address.shadow_index.schema))
            make_tables(connection)
        yield engine
    finally:
        engine.dispose()
        if address is None:
            remove_file(path)


def _shadow_path(lab: LabFolder) -> Path:
    return lab.catalogue.with_name(f"{lab.catalogue.name}.new")


def replace_index(engine: Engine, lab: LabFolder) -> None:
    """Replace the index of a lab by its shadow index, in one transaction.

    Rows whose key only the old index has are kept: they may belong to runs that ended meanwhile. Raises LabError.
    """
    if on_server(engine):
        with transaction(engine, lab) as connection:
            address = server.address(lab)
            assert address is not None
            connection.execute(CreateSchema(address.schema, if_not_exists=True))
            replace_tables(connection, address.schema, address.shadow_index.schema)
            connection.execute(DropSchema(address.shadow_index.schema, cascade=True))
        return
    with open_connection(engine, lab) as connection:
        # SQLite attaches and detaches files outside of transactions only, so neither is part of the exchange.
        connection.execute(text("ATTACH DATABASE :built AS built"), {"built": _uri(_shadow_path(lab))})
        try:
            connection.execute(text("BEGIN IMMEDIATE"))
            replace_tables(connection, "main", "built")
            connection.commit()
        finally:
            connection.rollback()
            connection.execute(text("DETACH DATABASE built"))


def replace_tables(connection: Connection, old: str, new: str) -> None:
    """Replace the tables of the schema `old` by those of the schema `new`, within the caller's transaction."""
    names = {table.name: ", ".join(f'"{column.name}"' for column in table.columns) for table in metadata.sorted_tables}
    inspector = inspect(connection)
    if all(_has(inspector, table) for table in metadata.sorted_tables):
        for table, key, owner in (
            (measurements, "run_key", runs),  # before the runs that tell which of them are known
            (runs, "run_key", runs),
            (packings, "packing_key", packings),
        ):
            listed, kept_keys = names[table.name], f'SELECT {key} FROM "{new}".{owner.name}'
            extra_rows = f'SELECT {listed} FROM "{old}".{table.name} WHERE {key} NOT IN ({kept_keys})'
            connection.execute(text(f'INSERT INTO "{new}".{table.name} ({listed}) {extra_rows}'))
    for name in inspector.get_table_names():  # tables of older versions too
        connection.execute(text(f'DROP TABLE "{old}"."{name}"'))
    if on_server(connection):
        for name in names:
            connection.execute(text(f'ALTER TABLE "{new}".{name} SET SCHEMA "{old}"'))
        return
    make_tables(connection)  # SQLite cannot move a table from one file to another: rows are copied
    for name, listed in names.items():
        if name != about.name:
            connection.execute(text(f'INSERT INTO "{old}".{name} ({listed}) SELECT {listed} FROM "{new}".{name}'))


def _has(inspector: Inspector, table: Table) -> bool:
    """Check that a table exists and has exactly its present columns."""
    if not inspector.has_table(table.name):
        return False
    return {column.name for column in table.columns} == {column["name"] for column in inspector.get_columns(table.name)}


def empty() -> Engine:
    """Create an empty index in memory; each thread has its own."""
    engine = create_engine("sqlite://")

    @event.listens_for(engine, "connect")
    def create_tables(connection, _record):
        for table in metadata.sorted_tables:
            connection.execute(str(CreateTable(table).compile(engine)))

    return engine


def select_in(connection: Connection, query: Select, column: Column, keys: Iterable[str]) -> list[Row]:
    """Select the rows of `query` whose `column` is one of `keys`, for any number of keys."""
    keys, rows = list(keys), []
    # If more keys are wanted than the table has rows, its keys are read once, and queries for absent ones are saved.
    if len(keys) > _CHUNK and (connection.scalar(select(func.count()).select_from(column.table)) or 0) <= len(keys):
        keys = sorted({*keys} & {*connection.scalars(select(column))})
    for start in range(0, len(keys), _CHUNK):
        rows += connection.execute(query.where(column.in_(keys[start : start + _CHUNK])))
    return rows


def add_measurements(lab: LabFolder, rows: list[dict[str, Any]]) -> None:
    """Add rows of measurements of indexed runs to the index of a lab.

    Nothing happens if the index cannot be written to: the numbers are then derived again from the files beside the
    runs. Raises LabError for a damaged index.
    """
    if not rows or not os.access(lab.folder, os.W_OK):
        return
    if not server.address(lab) and not os.access(lab.catalogue, os.W_OK):
        return
    engine = open_engine(lab, read_only=False)
    try:
        with transaction(engine, lab) as connection:
            upsert(connection, measurements, rows)
    finally:
        engine.dispose()


def upsert(connection: Connection, table: Table, rows: list[dict[str, Any]]) -> None:
    """Insert rows into a table; a row with the same primary key is replaced."""
    if rows:
        connection.execute(_upserting(table, on_server(connection)), rows)


@cache
def _upserting(table: Table, server: bool) -> Executable:
    """The statement of `upsert`, cached: compiling it takes longer than running it."""
    statement = (postgresql if server else sqlite).insert(table)
    changed = {column.key: statement.excluded[column.key] for column in table.columns if not column.primary_key}
    return statement.on_conflict_do_update(index_elements=list(table.primary_key.columns), set_=changed)
