"""Checkpoints of unfinished work on disk: an exact state and the rows up to it, always consistent.

A save writes the rows since the last one as files of their own, writes the checkpoint beside the old one, and then
replaces `progress.json`, which names them all. A process killed at any moment leaves the state of its last save. Files
that `progress.json` does not name are leftovers of an interrupted save. A finished run is continued as if it had been
saved at its end.
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
from labbook.lab.records import MAX_RECORD_BYTES, RunRecord, Session, StoredModel, Unreadable, Whole
from labbook.lab.runs import RECORDING, check_keys, film_of, read_end, read_recording, read_tables
from labbook.lab.tables import join, read_checkpoint, read_table, write_checkpoint, write_table

PROGRESS = "progress.json"
FAILURE = "failed.json"
FileName = Annotated[str, Field(pattern=r"^[a-z]+-\d+\.npz$")]


class Progress(StoredModel):
    """Content of `progress.json`: the last save.

    Args:
        number: Number of the save, from 1.
        checkpoint: File name of the checkpoint.
        chunks: File names of rows, by table.
        state: Job-specific values beside checkpoint and rows; `step` is always there.
        sessions: Sessions of the computation so far.
    """

    number: Whole
    checkpoint: FileName
    chunks: dict[str, list[FileName]]
    state: dict[str, Any]
    sessions: Annotated[tuple[Session, ...], Field(min_length=1)]

    @property
    def step(self) -> int:
        """Step of the save."""
        return self.state["step"]

    @classmethod
    def read(cls, folder: Path) -> "Progress | None":
        """Read the last save in `folder`; None if there is none. Raises Unreadable."""
        path = folder / PROGRESS
        try:
            with open_file(path) as file:
                progress = cls.model_validate_json(file.read(MAX_RECORD_BYTES + 1))
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            raise Unreadable(f"{path}: {error.strerror or error}") from error
        except ValidationError as error:
            raise Unreadable(f"{path}: {error.errors()[0]['msg']}") from error
        # `type`, not `isinstance`: true and false of JSON are integers to Python.
        if type(progress.state.get("step")) is not int or not 0 <= progress.step < 2**63:
            raise Unreadable(f"{path}: state.step: the step is missing")
        # Without a chunk the tables would have a hole. It shows now, and not after hours of continued work.
        if missing := [name for name in progress.files if not (folder / name).is_file()]:
            raise Unreadable(f"{folder / missing[0]} is missing")
        return progress

    @property
    def failed(self) -> str:
        """Reason for which the work failed, and would fail again; empty if it can go on."""
        why = self.state.get("failed", "")
        return why if isinstance(why, str) else ""

    @property
    def files(self) -> set[str]:
        """Names of all files of the save."""
        return {self.checkpoint, *(name for names in self.chunks.values() for name in names)}


class FillingFailure(StoredModel):
    """Failure of a filling, on disk; the next save of the filling, or its end, removes the file.

    Args:
        why: Reason of the failure.
        max_time: Filling time [s] that was allowed, if a longer one may succeed; None if time does not matter.
    """

    why: Annotated[str, Field(max_length=10_000)]
    max_time: float | None = None

    @classmethod
    def read(cls, folder: Path) -> "FillingFailure | None":
        """Read the failure in the work folder of a packing; None if there is none, or if it cannot be read."""
        try:
            with open_file(folder / FAILURE) as file:
                return cls.model_validate_json(file.read(MAX_RECORD_BYTES + 1))
        except (OSError, ValidationError):
            return None

    def write(self, folder: Path) -> None:
        """Write the failure to a work folder. If the disk is full only the reason is lost."""
        with suppress(OSError, LabError):
            make_folder(folder)
            # not durable: without the file the filling is tried again, which costs time and no result
            write_bytes(folder / FAILURE, self.model_dump_json().encode(), durable=False)


@dataclass(frozen=True)
class Saved:
    """State of work at its last save. `state`: job-specific values beside checkpoint and rows."""

    checkpoint: Checkpoint
    state: dict[str, Any]
    sessions: tuple[Session, ...]

    @property
    def step(self) -> int:
        """Step of the save."""
        return self.state["step"]


class Journal:
    """Checkpoints in the work folder of one key, whose claim the caller holds.

    Writing raises DiskFull if there is no room; the last save then stays valid.

    Args:
        folder: Work folder of the key.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self._number = 0
        self._chunks: dict[str, list[str]] = {}
        self._saved_files: set[str] = set()

    def restore(self) -> Saved | None:
        """Read the last save, and remove files that it does not name; None if there is none. Raises Unreadable."""
        progress = Progress.read(self.folder)
        if progress is None:
            return None
        try:
            checkpoint = read_checkpoint(self.folder / progress.checkpoint)
        except (OSError, ValueError) as error:
            raise Unreadable(f"{self.folder / progress.checkpoint}: {error}") from error
        self._number, self._chunks = progress.number, progress.chunks
        self._saved_files = progress.files
        self._sweep()
        return Saved(checkpoint, progress.state, progress.sessions)

    def save(
        self,
        checkpoint: Checkpoint,
        rows: Mapping[str, Sequence[Table]],
        state: Mapping[str, Any],
        sessions: Iterable[Session],
    ) -> None:
        """Save a checkpoint and the rows since the last save.

        Args:
            checkpoint: Exact state of the member.
            rows: Tables since the last save, by name.
            state: Job-specific values, as JSON.
            sessions: All sessions of the computation.

        Raises:
            DiskFull: The disk is full; the last save stays valid.
        """
        with room(self.folder):
            make_folder(self.folder)
            # New names for every save: the files of the last one stay valid until `progress.json` is replaced.
            number = self._number + 1
            chunks = {name: list(files) for name, files in self._chunks.items()}
            for name, tables in rows.items():
                table = join(tables)
                if table:
                    chunks.setdefault(name, []).append(f"{name}-{number}.npz")
                    # not compressed: saves are frequent, and these files last until the end of the run only
                    write_table(self.folder / chunks[name][-1], table, compress=False)
            checkpoint_file = f"checkpoint-{number}.npz"
            write_checkpoint(self.folder / checkpoint_file, checkpoint)
            sync_folder(self.folder)  # all files are on the disk before `progress.json` names them
            progress = {
                "number": number,
                "checkpoint": checkpoint_file,
                "chunks": chunks,
                "state": dict(state),
                "sessions": [session.model_dump(mode="json") for session in sessions],
            }
            write_bytes(self.folder / PROGRESS, json.dumps(progress, indent=1).encode())
        # Only now: after an error the journal still describes the save that `progress.json` names.
        self._number, self._chunks = number, chunks
        self._saved_files = {checkpoint_file, *(name for names in chunks.values() for name in names)}
        self._sweep()

    def tables(self, rows: Mapping[str, Sequence[Table]]) -> dict[str, dict[str, np.ndarray]]:
        """Return all saved rows, followed by `rows`, by table name. Raises Unreadable."""
        names = dict.fromkeys((*self._chunks, *rows))
        saved = {name: [self._chunk(file) for file in self._chunks.get(name, [])] for name in names}
        tables = {name: join([*saved[name], *rows.get(name, [])]) for name in names}
        return {name: table for name, table in tables.items() if table}

    def iter_rows(self) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
        """Yield (table name, rows) of each save. Raises Unreadable."""
        for name, files in self._chunks.items():
            yield from ((name, self._chunk(file)) for file in files)

    def _chunk(self, file: str) -> dict[str, np.ndarray]:
        try:
            return read_table(self.folder / file)
        except (OSError, ValueError) as error:
            raise Unreadable(f"{self.folder / file}: {error}") from error

    def _sweep(self) -> None:
        """Remove files that the last save does not name; folders stay."""
        for entry in os.scandir(self.folder):
            # folders stay: `done` may hold a result that is being written
            if entry.is_file() and entry.name not in self._saved_files and entry.name != PROGRESS:
                with suppress(FileNotFoundError):
                    os.unlink(entry.path)


@dataclass(frozen=True)
class Unfinished:
    """Unfinished work on one run or packing.

    Args:
        key: Key of the run or packing.
        step: Step of the last save; 0 without one.
        saved: There is a save.
        claimed: A process works on it.
        problem: Why its last save cannot be read.
        failed: Reason of its failure (`Progress.failed`).
    """

    key: str
    step: int
    saved: bool
    claimed: bool
    problem: str | None = None
    failed: str = ""


def unfinished(lab: LabFolder) -> list[Unfinished]:
    """List all unfinished work of a lab."""
    entries = []
    for key in lab.working():
        progress, problem = None, None
        try:
            progress = Progress.read(lab.work(key))
        except Unreadable as error:
            problem = str(error)
        step = progress.step if progress else 0
        filling_failure = FillingFailure.read(lab.work(key))
        failed = (progress.failed if progress else "") or (filling_failure.why if filling_failure else "")
        entries.append(Unfinished(key, step, progress is not None, lab.is_claimed(key), problem, failed))
    return entries


def at_its_end(folder: Path, record: RunRecord) -> tuple[Saved, Mapping[str, Sequence[Table]]]:
    """Return the last state of the finished run in `folder`, and its rows, in the form of a save. Raises Unreadable."""
    check_keys(folder, record)
    coverage = record.coverage
    film = film_of(record)
    state = {
        "step": coverage.steps,
        "crossed": coverage.crossed,
        "discharged": coverage.discharged,
        "last": coverage.last_crossing,
        "probes": list(coverage.probes),
        "film": describe_probe(film) if film else None,
        "restarts": [list(restart) for restart in coverage.restarts],
    }
    rows: dict[str, Sequence[Table]] = {name: [table] for name, table in read_tables(folder, record).items()}
    frames = read_recording(folder, record)
    if frames is not None:
        rows[Path(RECORDING).stem] = [frames]
    return Saved(read_end(folder, record), state, record.sessions), rows
