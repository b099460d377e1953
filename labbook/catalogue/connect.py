"""Opening the index: an SQLite file that several processes read and one at a time writes."""

import sqlite3
from pathlib import Path
from urllib.parse import quote

from sqlalchemy import Engine, create_engine, event, text
from sqlalchemy.exc import DatabaseError, OperationalError

from labbook.catalogue.schema import metadata

BUSY = 30.0
"""How long a transaction waits for another process's [s]."""
DAMAGED = -1


def connect(path: Path, *, read_only: bool) -> Engine:
    """An SQLAlchemy engine on an SQLite file."""
    mode = "ro" if read_only else "rwc"
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
    except OperationalError as error:
        if "no such" in str(error.orig):
            return None
        raise
    except DatabaseError:
        return DAMAGED


def empty() -> Engine:
    """An index of nothing, in memory."""
    engine = create_engine("sqlite://")
    metadata.create_all(engine)
    return engine


def _quoted(path: Path) -> str:
    return quote(str(path.resolve()))
