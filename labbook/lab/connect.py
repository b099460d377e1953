"""Opening the index: an SQLite file that several processes read and one at a time writes."""

import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

from sqlalchemy import Connection, Engine, create_engine, event, text
from sqlalchemy.exc import DatabaseError

from labbook.lab.folder import DiskFull, Lab, LabError
from labbook.lab.schema import metadata

BUSY = 30.0
"""How long a transaction waits for another process's [s]."""
CHUNK = 500
"""Keys in one query, well below SQLite's limit on variables."""
DAMAGED = -1
_OUT_OF_REACH = ("locked", "full", "readonly", "unable to open", "disk I/O", "not authorized", "interrupted")


class NoCatalogue(LabError):
    """There is no catalogue, it is damaged, or of another version of labbook; the message says what to do."""


def connect(path: Path, *, read_only: bool) -> Engine:
    """An SQLAlchemy engine on an SQLite file.

    Of a file that nobody can write to, and that no log belongs to, SQLite may not make the log that it reads by: it is
    then opened as one that does not change.
    """
    mode = "ro" if read_only else "rwc"
    if read_only and not os.access(path.parent, os.W_OK) and not path.with_name(f"{path.name}-wal").exists():
        mode += "&immutable=1"
    uri = f"file:{_quoted(path)}?mode={mode}"
    engine = create_engine(
        "sqlite://", creator=lambda: sqlite3.connect(uri, uri=True, timeout=BUSY, isolation_level=None)
    )
    if not read_only:

        @event.listens_for(engine, "connect")
        def _durable(connection, _record):
            connection.execute("PRAGMA journal_mode=WAL")
            connection.execute("PRAGMA synchronous=NORMAL")

    return engine


def schema_version(engine: Engine) -> int | None:
    """Version of the index; None if it has none, DAMAGED if the file is no database at all."""
    try:
        with engine.connect() as connection:
            return connection.scalar(text("SELECT schema_version FROM about"))
    except DatabaseError as error:
        if "no such table" in str(error.orig):
            return None
        if damaged(error):
            return DAMAGED
        raise


def whole(engine: Engine) -> bool:
    """Whether every page of the index can be read."""
    try:
        with engine.connect() as connection:
            return connection.scalar(text("PRAGMA quick_check(1)")) == "ok"
    except DatabaseError as error:
        if damaged(error):
            return False
        raise


def damaged(error: DatabaseError) -> bool:
    """Whether an error tells of a damaged file, and not of one that is locked, full or out of reach."""
    return not any(words in str(error.orig) for words in _OUT_OF_REACH)


def unusable(lab: Lab, error: DatabaseError) -> LabError:
    """What an error of the database of `lab` means to its user."""
    why, path = str(error.orig), lab.catalogue
    if damaged(error):
        return NoCatalogue(f"{path} is damaged ({why}); make it again: labbook reindex --lab {lab.folder}")
    if "full" in why:
        return DiskFull(path)
    if "locked" in why:
        return LabError(f"{path}: another labbook has been writing to it for {BUSY:g} s; give the same command again")
    return LabError(
        f"{path}: {why}; see to it that you may read and write the files in {lab.folder}, or use a copy of the folder"
    )


@contextmanager
def asking(engine: Engine, lab: Lab) -> Iterator[Connection]:
    """A connection to the index of a lab. Raises LabError."""
    try:
        with engine.connect() as connection:
            yield connection
    except DatabaseError as error:
        raise unusable(lab, error) from error


@contextmanager
def writing(engine: Engine, lab: Lab) -> Iterator[Connection]:
    """A transaction that is done as a whole or not at all. Raises LabError."""
    with asking(engine, lab) as connection:
        connection.execute(text("BEGIN IMMEDIATE"))
        yield connection
        connection.commit()


def empty() -> Engine:
    """An index of nothing, in memory."""
    engine = create_engine("sqlite://")
    metadata.create_all(engine)
    return engine


def _quoted(path: Path) -> str:
    return quote(str(path.resolve()))
