"""Index on a PostgreSQL server, for a lab that several people share.

The lab's file `catalogue.url` has the address. The server holds the index only: the folders stay the source of all
data. One database can hold the indexes of many labs, each in its own schema.
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
"""Time that a transaction waits for another process, and that a server may take for its first answer [s]."""


@dataclass(frozen=True)
class Address:
    """Address of the index of a lab. `url`: of the database, `postgresql://host/name`; `schema`: that of the lab."""

    url: str
    schema: str

    @property
    def display(self) -> str:
        """Address for messages, without a password."""
        return f"{hide_password(self.url)} (schema {self.schema})"

    @property
    def shadow_index(self) -> "Address":
        """Address at which the next index of the lab is built."""
        return replace(self, schema=f"{self.schema}_new")


def hide_password(url: str) -> str:
    """Return an address without its password."""
    from sqlalchemy import make_url

    return make_url(url).render_as_string(hide_password=True)


def address(lab: LabFolder) -> Address | None:
    """Return the address of the index of a lab; None if it is a file of the lab. Raises LabError."""
    return _read(lab.server)


def _read(path: Path) -> Address | None:
    """Read a file `catalogue.url`; None if there is none.

    The name of the schema contains the inode number (st_ino) of the file, which no copy shares. So a copied lab has no
    index until it is written to, and does not write into that of its original.
    """
    try:
        with open(path, encoding="utf-8") as file:
            content, number = json.load(file), os.fstat(file.fileno()).st_ino
        url, name = str(content["url"]), str(content["name"])
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as problem:
        raise LabError(
            f"{path} does not say where the index is ({problem}); state it again: "
            f"{command('reindex', '--index', 'postgresql://HOST/DATABASE', lab=path.parent)} (or: --index file)"
        ) from problem
    return Address(url, f"lab_{name}_{number}")


def engine(address: Address) -> "Engine":
    """Make an SQLAlchemy engine for the schema of a lab. Raises LabError if the driver is not installed."""
    from sqlalchemy import create_engine, make_url
    from sqlalchemy.pool import NullPool

    url = make_url(address.url).set(drivername="postgresql+psycopg")
    options = f"-csearch_path={address.schema} -clock_timeout={int(1000 * BUSY)}"
    try:
        return create_engine(
            url, poolclass=NullPool, connect_args={"options": options, "connect_timeout": int(BUSY)}
        )  # fmt: skip
    except ImportError as error:
        raise LabError(f"{address.display} takes psycopg: pip install 'labbook[postgres]'") from error


def move_to(lab: LabFolder, url: str) -> str | None:
    """Move the index of a lab to a server, where it is empty until it is rebuilt.

    Returns:
        Message about an old index that could not be removed, or None.

    Raises:
        LabError: The server cannot be used; the old index stays in use.
    """
    from sqlalchemy import make_url
    from sqlalchemy.exc import ArgumentError, SQLAlchemyError
    from sqlalchemy.schema import CreateSchema

    try:
        if make_url(url).get_backend_name() != "postgresql":
            raise ArgumentError("it is not an address of PostgreSQL")
    except ArgumentError as problem:
        raise LabError(f"--index {url}: {problem}; give postgresql://HOST/DATABASE, or file") from problem
    make_folder(lab.folder)
    before, fresh = _previous_address(lab), lab.server.with_name(f"{lab.server.name}.{os.getpid()}")
    try:
        fresh.write_text(json.dumps({"url": url, "name": secrets.token_hex(4)}) + "\n", encoding="utf-8")
        address = _read(fresh)
        assert address is not None
        with engine(address).connect() as connection:
            connection.execute(CreateSchema(address.schema))
            connection.commit()
        fresh.replace(lab.server)  # a rename keeps the inode number, which is in the schema's name
    except SQLAlchemyError as error:
        raise LabError(f"no index can be made at {hide_password(url)}: {why(error)}") from error
    finally:
        remove(fresh)
    for suffix in ("", "-wal", "-shm"):
        remove(lab.catalogue.with_name(lab.catalogue.name + suffix))
    return _drop(before) if before else None


def move_to_file(lab: LabFolder) -> str | None:
    """Move the index of a lab back to a file of the lab. Returns a message about an old index that could not be
    removed, or None."""
    address = _previous_address(lab)
    remove(lab.server)
    return _drop(address) if address else None


def _previous_address(lab: LabFolder) -> Address | None:
    """Address that the index of a lab had; None also if its file is invalid: choosing a new place is the remedy."""
    try:
        return _read(lab.server)
    except LabError:
        return None


def _drop(address: Address) -> str | None:
    """Remove an index from its server. Returns why it could not be removed, or None."""
    from sqlalchemy.exc import SQLAlchemyError
    from sqlalchemy.schema import DropSchema

    try:
        with engine(address).connect() as connection:
            for schema_address in (address, address.shadow_index):
                connection.execute(DropSchema(schema_address.schema, cascade=True, if_exists=True))
            connection.commit()
    except (SQLAlchemyError, LabError) as error:
        return f"the old index could not be removed: {address.display}: {why(error)}"
    return None


def why(error: Exception) -> str:
    """Return the first line of an error of a server or its driver."""
    return str(getattr(error, "orig", None) or error).strip().splitlines()[0]
