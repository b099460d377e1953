"""Unfinished work on disk: an exact checkpoint and the rows up to it, which always belong together.

A save adds the rows since the last one as files of their own, writes the checkpoint beside the old one, and
then replaces `progress.json`, which names them all. A process killed at any moment leaves the state of its
last save; files that `progress.json` does not name are leftovers of a save that was cut short. A finished run is taken
up again as if it had been saved at its end.
"""

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ValidationError

from labbook.backend import Checkpoint
from labbook.backend.probes import Table, describe_probe
from labbook.lab.folder import LabError, LabFolder, make_folder, open_file, room, sync_folder, write_bytes
from labbook.lab.records import LONGEST, Part, RunRecord, Session, Unreadable, Whole
from labbook.lab.runs import RECORDING, check_keys, film_of, read_end, read_recording, read_tables
from labbook.lab.tables import join, read_checkpoint, read_table, write_checkpoint, write_table

PROGRESS = "progress.json"
FAILURE = "failed.json"
FileName = Annotated[str, Field(pattern=r"^[a-z]+-\d+\.npz$")]


class Progress(Part):
    """What a save wrote: its number, the files of checkpoint and rows, by table, and what the job needs to know."""

    number: Whole
    checkpoint: FileName
    chunks: dict[str, list[FileName]]
    state: dict[str, Any]
    sessions: Annotated[tuple[Session, ...], Field(min_length=1)]

    @property
    def step(self) -> int:
        """At which it was saved."""
        return self.state["step"]

    @classmethod
    def read(cls, folder: Path) -> "Progress | None":
        """The last save in `folder`, None without any. Raises Unreadable."""
        path = folder / PROGRESS
        try:
            with open_file(path) as file:
                found = cls.model_validate_json(file.read(LONGEST + 1))
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            raise Unreadable(f"{path}: {error.strerror or error}") from error
        except ValidationError as error:
            raise Unreadable(f"{path}: {error.errors()[0]['msg']}") from error
        if type(found.state.get("step")) is not int or not 0 <= found.step < 2**63:
            raise Unreadable(f"{path}: state.step: the step is missing")
        if missing := [name for name in found.files if not (folder / name).is_file()]:
            raise Unreadable(f"{folder / missing[0]} is missing")
        return found

    @property
    def failed(self) -> str:
        """Why it came to nothing, and would again; empty for one that goes on."""
        why = self.state.get("failed", "")
        return why if isinstance(why, str) else ""

    @property
    def files(self) -> set[str]:
        """Names of all files that belong to it."""
        return {self.checkpoint, *(name for names in self.chunks.values() for name in names)}


class FillingFailure(Part):
    """Why a filling came to nothing; the next save of it, or its end, removes the file.

    `max_time`: the longest filling time [s] that it was allowed, if a longer one may cure it; None if time does not.
    """

    why: Annotated[str, Field(max_length=10_000)]
    max_time: float | None = None

    @classmethod
    def read(cls, folder: Path) -> "FillingFailure | None":
        """What is noted in the work folder of a packing; None without it, or if it cannot be read."""
        try:
            with open_file(folder / FAILURE) as file:
                return cls.model_validate_json(file.read(LONGEST + 1))
        except (OSError, ValidationError):
            return None

    def write(self, folder: Path) -> None:
        """Note it. A disk that does not take it loses the reason and nothing else."""
        with suppress(OSError, LabError):
            make_folder(folder)
            write_bytes(folder / FAILURE, self.model_dump_json().encode(), durable=False)


@dataclass(frozen=True)
class Saved:
    """Where work stood at its last save. `state`: what its job needs to know beside checkpoint and rows."""

    checkpoint: Checkpoint
    state: dict[str, Any]
    sessions: tuple[Session, ...]

    @property
    def step(self) -> int:
        """At which it was saved."""
        return self.state["step"]


class Journal:
    """The work folder of one key, whose claim is held. Writing raises DiskFull, and keeps the last save."""

    def __init__(self, folder: Path):
        self.folder = folder
        self._number = 0
        self._chunks: dict[str, list[str]] = {}
        self._written: set[str] = set()

    def restore(self) -> Saved | None:
        """The last save, or None if there is none. Raises Unreadable if it is damaged."""
        progress = Progress.read(self.folder)
        if progress is None:
            return None
        try:
            checkpoint = read_checkpoint(self.folder / progress.checkpoint)
        except (OSError, ValueError) as error:
            raise Unreadable(f"{self.folder / progress.checkpoint}: {error}") from error
        self._number, self._chunks = progress.number, progress.chunks
        self._written = progress.files
        self._sweep()
        return Saved(checkpoint, progress.state, progress.sessions)

    def save(
        self,
        checkpoint: Checkpoint,
        rows: Mapping[str, Sequence[Table]],
        state: Mapping[str, Any],
        sessions: Iterable[Session],
    ) -> None:
        """Save `checkpoint`, and `rows` by table name since the last save."""
        with room(self.folder):
            make_folder(self.folder)
            number = self._number + 1
            chunks = {name: list(files) for name, files in self._chunks.items()}
            for name, tables in rows.items():
                table = join(tables)
                if table:
                    chunks.setdefault(name, []).append(f"{name}-{number}.npz")
                    write_table(self.folder / chunks[name][-1], table, compress=False)
            saved = f"checkpoint-{number}.npz"
            write_checkpoint(self.folder / saved, checkpoint)
            sync_folder(self.folder)
            progress = {
                "number": number,
                "checkpoint": saved,
                "chunks": chunks,
                "state": dict(state),
                "sessions": [session.model_dump(mode="json") for session in sessions],
            }
            write_bytes(self.folder / PROGRESS, json.dumps(progress, indent=1).encode())
        self._number, self._chunks = number, chunks
        self._written = {saved, *(name for names in chunks.values() for name in names)}
        self._sweep()

    def tables(self, rows: Mapping[str, Sequence[Table]]) -> dict[str, dict[str, np.ndarray]]:
        """All rows that were saved, followed by `rows`, by table name. Raises Unreadable."""
        names = dict.fromkeys((*self._chunks, *rows))
        saved = {name: [self._chunk(file) for file in self._chunks.get(name, [])] for name in names}
        tables = {name: join([*saved[name], *rows.get(name, [])]) for name in names}
        return {name: table for name, table in tables.items() if table}

    def each(self) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
        """The rows of every save, with the name of their table. Raises Unreadable."""
        for name, files in self._chunks.items():
            yield from ((name, self._chunk(file)) for file in files)

    def _chunk(self, file: str) -> dict[str, np.ndarray]:
        try:
            return read_table(self.folder / file)
        except (OSError, ValueError) as error:
            raise Unreadable(f"{self.folder / file}: {error}") from error

    def _sweep(self) -> None:
        """Remove files that no save names any more; folders are left alone."""
        for entry in os.scandir(self.folder):
            if entry.is_file() and entry.name not in self._written and entry.name != PROGRESS:
                with suppress(FileNotFoundError):
                    os.unlink(entry.path)


@dataclass(frozen=True)
class Unfinished:
    """Work on one key of a run or packing."""

    key: str
    step: int
    """Of the last save."""
    saved: bool
    held: bool
    """Whether a process is working on it."""
    problem: str | None = None
    """Why its last save cannot be read."""
    failed: str = ""
    """Why it came to nothing; see `Progress`."""


def unfinished(lab: LabFolder) -> list[Unfinished]:
    """All unfinished work."""
    found = []
    for key in lab.working():
        last, problem = None, None
        try:
            last = Progress.read(lab.work(key))
        except Unreadable as error:
            problem = str(error)
        step = last.step if last else 0
        noted = FillingFailure.read(lab.work(key))
        failed = (last.failed if last else "") or (noted.why if noted else "")
        found.append(Unfinished(key, step, last is not None, lab.held(key), problem, failed))
    return found


def at_its_end(folder: Path, record: RunRecord) -> tuple[Saved, Mapping[str, Sequence[Table]]]:
    """The run in `folder` as its job would have saved it at its end, and its rows. Raises Unreadable."""
    check_keys(folder, record)
    had = record.coverage
    film = film_of(record)
    state = {
        "step": had.steps,
        "crossed": had.crossed,
        "discharged": had.discharged,
        "last": had.last_crossing,
        "probes": list(had.probes),
        "film": describe_probe(film) if film else None,
        "restarts": [list(restart) for restart in had.restarts],
    }
    rows: dict[str, Sequence[Table]] = {name: [table] for name, table in read_tables(folder, record).items()}
    frames = read_recording(folder, record)
    if frames is not None:
        rows[Path(RECORDING).stem] = [frames]
    return Saved(read_end(folder, record), state, record.sessions), rows
