"""What records of runs and of packings share."""

from pathlib import Path
from typing import Any, ClassVar, Self

from pydantic import BaseModel, ConfigDict, ValidationError

from labbook.catalogue.lab import write_bytes


class Unreadable(Exception):
    """A folder that holds nothing that can be read; the message names file and reason."""


class Part(BaseModel):
    """A frozen piece of a record; an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="constants")


class Session(Part):
    """A stretch of one computation within one process."""

    from_step: int
    to_step: int
    started: str
    """UTC, ISO 8601."""
    wall_time: float
    """Spent stepping [s]."""
    process_time: float
    """Share of the process's processor time while stepping [s]."""
    grain_steps: float
    provenance: dict[str, Any] = {}


class Record(Part):
    """A folder's account of how its content was computed, in one or more sessions."""

    FILE: ClassVar[str]
    KEY: ClassVar[str]

    sessions: tuple[Session, ...]

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
    def read(cls, folder: Path) -> Self:
        """Read the record in `folder`. Raises Unreadable."""
        path = folder / cls.FILE
        try:
            record = cls.model_validate_json(path.read_bytes())
        except OSError as error:
            raise Unreadable(f"{path}: {error.strerror or error}") from error
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"])) or "the file"
            raise Unreadable(f"{path}: {where}: {first['msg']}") from error
        if getattr(record, cls.KEY) != folder.name:
            raise Unreadable(f"{path}: it belongs to {getattr(record, cls.KEY)}: the folder was renamed or copied")
        return record
