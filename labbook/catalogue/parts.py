"""What records of runs and of packings share."""

from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from labbook.catalogue.lab import open_file, write_bytes

Whole = Annotated[int, Field(ge=0, lt=2**63)]
"""A count, or another number that SQLite can hold."""
Measure = Annotated[float, Field(ge=0, allow_inf_nan=False)]
"""A time, a length or a fraction."""
LONGEST = 2**26
"""Bytes that a record may have: those of some 10^4 sessions."""


class Unreadable(Exception):
    """A folder that holds nothing that can be read; the message names file and reason."""


class Part(BaseModel):
    """A frozen piece of a record; an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="constants")


class Session(Part):
    """A stretch of one computation within one process."""

    from_step: Whole
    to_step: Whole
    started: str
    """UTC, ISO 8601."""
    wall_time: Measure
    """Spent stepping [s]."""
    process_time: Measure
    """Share of the process's processor time while stepping [s]."""
    grain_steps: Measure
    provenance: dict[str, Any] = {}


class Record(Part):
    """A folder's account of how its content was computed, in one or more sessions."""

    FILE: ClassVar[str]
    KEY: ClassVar[str]

    sessions: Annotated[tuple[Session, ...], Field(min_length=1)]

    @property
    def wall_time(self) -> float:
        """Time spent stepping [s], over all sessions."""
        return sum(session.wall_time for session in self.sessions)

    @property
    def process_time(self) -> float:
        """Processor time spent stepping [s], over all sessions."""
        return sum(session.process_time for session in self.sessions)

    @property
    def rate(self) -> float:
        """Grain-steps per second of wall time; NaN if nothing was stepped."""
        wall = self.wall_time
        return sum(session.grain_steps for session in self.sessions) / wall if wall else float("nan")

    def write(self, folder: Path) -> None:
        """Write into `folder`."""
        write_bytes(folder / self.FILE, (self.model_dump_json(indent=1) + "\n").encode())

    @classmethod
    def read(cls, folder: Path, key: str | None = None) -> Self:
        """Read the record in `folder`, which is named by its key, or has yet to be named `key`. Raises Unreadable."""
        path, key = folder / cls.FILE, key or folder.name
        try:
            with open_file(path) as file:
                text = file.read(LONGEST + 1)
            record = cls.model_validate_json(text)
        except OSError as error:
            raise Unreadable(f"{path}: {error.strerror or error}") from error
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"])) or "the file"
            raise Unreadable(f"{path}: {where}: {first['msg']}") from error
        if getattr(record, cls.KEY) != key:
            raise Unreadable(f"{path}: it belongs to {getattr(record, cls.KEY)}: the folder was renamed or copied")
        return record
