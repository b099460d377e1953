"""An index on a PostgreSQL server, for a lab that several people share.

The lab's file `catalogue.url` says where. The server holds the index alone: folders of runs stay what is true. One
database serves many labs, each in a schema of its own.
"""

import json
import os
import secrets
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from labbook.commands import command
from labbook.lab.folder import LabError, LabFolder, make_folder, remove

if TYPE_CHECKING:
    from sqlalchemy import Engine

BUSY = 30.0
"""How long a transaction waits for another process's, and how long a server may take to answer the first time [s]."""


@dataclass(frozen=True)
class Address:
    """Where the index of a lab is. `url`: of the database, as `postgresql://host/name`; `schema`: the lab's own."""

    url: str
    schema: str

    @property
    def shown(self) -> str:
        """For messages: without a password."""
        return f"{url_shown(self.url)} (schema {self.schema})"

    @property
    def beside(self) -> "Address":
        """Where the next index of the lab is made."""
        return replace(self, schema=f"{self.schema}_new")


def url_shown(url: str) -> str:
    """An address without its password."""
    from sqlalchemy import make_url

    return make_url(url).render_as_string(hide_password=True)


def address(lab: LabFolder) -> Address | None:
    """Where the index of a lab is; None if it is a file of the lab. Raises LabError."""
    return _read(lab.server)


def _read(path: Path) -> Address | None:
    """What a file `catalogue.url` says; None if there is none.

    The schema carries the number of the file that names it (st_ino), which no copy has: a lab that was copied has no
    index until someone writes to it, and does not write into that of its original.
    """
    try:
        with open(path, encoding="utf-8") as file:
            told, number = json.load(file), os.fstat(file.fileno()).st_ino
        url, name = str(told["url"]), str(told["name"])
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as problem:
        raise LabError(
            f"{path} does not say where the index is ({problem}); state it again: "
            f"{command('reindex', '--index', 'postgresql://HOST/DATABASE', lab=path.parent)} (or: --index file)"
        ) from problem
    return Address(url, f"lab_{name}_{number}")


def engine(place: Address) -> "Engine":
    """An SQLAlchemy engine for the schema of a lab. Raises LabError where SQLAlchemy's driver is not installed."""
    from sqlalchemy import create_engine, make_url
    from sqlalchemy.pool import NullPool

    url = make_url(place.url).set(drivername="postgresql+psycopg")
    options = f"-csearch_path={place.schema} -clock_timeout={int(1000 * BUSY)}"
    try:
        return create_engine(
            url, poolclass=NullPool, connect_args={"options": options, "connect_timeout": int(BUSY)}
        )  # fmt: skip
    except ImportError as error:
        raise LabError(f"{place.shown} takes psycopg: pip install 'labbook[postgres]'") from error


def move_to(lab: LabFolder, url: str) -> str | None:
    """Keep the index of a lab on a server from now on, where it is empty until it is made again. What is left behind
    where it was, or None. Raises LabError, and the index is where it was."""
    from sqlalchemy import make_url
    from sqlalchemy.exc import ArgumentError, SQLAlchemyError
    from sqlalchemy.schema import CreateSchema

    try:
        if make_url(url).get_backend_name() != "postgresql":
            raise ArgumentError("it is not an address of PostgreSQL")
    except ArgumentError as problem:
        raise LabError(f"--index {url}: {problem}; give postgresql://HOST/DATABASE, or file") from problem
    make_folder(lab.folder)
    before, fresh = _left(lab), lab.server.with_name(f"{lab.server.name}.{os.getpid()}")
    try:
        fresh.write_text(json.dumps({"url": url, "name": secrets.token_hex(4)}) + "\n", encoding="utf-8")
        place = _read(fresh)
        assert place is not None
        with engine(place).connect() as connection:
            connection.execute(CreateSchema(place.schema))
            connection.commit()
        fresh.replace(lab.server)
    except SQLAlchemyError as error:
        raise LabError(f"no index can be made at {url_shown(url)}: {why(error)}") from error
    finally:
        remove(fresh)
    for suffix in ("", "-wal", "-shm"):
        remove(lab.catalogue.with_name(lab.catalogue.name + suffix))
    return _dropped(before) if before else None


def move_home(lab: LabFolder) -> str | None:
    """Keep the index of a lab in a file of the lab again. What is left behind on a server that cannot be reached, or
    None."""
    place = _left(lab)
    remove(lab.server)
    return _dropped(place) if place else None


def _left(lab: LabFolder) -> Address | None:
    """Where the index of a lab was; None also where its file does not say so: choosing a place anew is the remedy."""
    try:
        return _read(lab.server)
    except LabError:
        return None


def _dropped(place: Address) -> str | None:
    """Remove an index from its server; why it is still there, or None."""
    from sqlalchemy.exc import SQLAlchemyError
    from sqlalchemy.schema import DropSchema

    try:
        with engine(place).connect() as connection:
            for each in (place, place.beside):
                connection.execute(DropSchema(each.schema, cascade=True, if_exists=True))
            connection.commit()
    except (SQLAlchemyError, LabError) as error:
        return f"the old index could not be removed: {place.shown}: {why(error)}"
    return None


def why(error: Exception) -> str:
    """The first line of what a server or its driver says."""
    return str(getattr(error, "orig", None) or error).strip().splitlines()[0]
