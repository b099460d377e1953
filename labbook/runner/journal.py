"""Unfinished work on disk: an exact checkpoint and the rows up to it, which always belong together.

A save adds the rows since the last one as files of their own, writes the checkpoint beside the old one, and
then replaces `progress.json`, which names them all. A process killed at any moment leaves the state of its
last save; files that `progress.json` does not name are leftovers of a save that was cut short.
"""

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labbook.backend import Checkpoint
from labbook.catalogue.lab import room, sync_folder, write_bytes
from labbook.catalogue.parts import Session
from labbook.catalogue.tables import join, read_checkpoint, read_table, write_checkpoint, write_table
from labbook.probes import Table

PROGRESS = "progress.json"


@dataclass(frozen=True)
class Saved:
    """Where work stood at its last save. `state`: what its job needs to know beside checkpoint and rows."""

    checkpoint: Checkpoint
    state: dict[str, Any]
    sessions: tuple[Session, ...]


class Journal:
    """The work folder of one key, whose claim is held. Writing raises DiskFull, and keeps the last save."""

    def __init__(self, folder: Path):
        self.folder = folder
        self._number = 0
        self._chunks: dict[str, list[str]] = {}
        self._written: set[str] = set()

    def restore(self) -> Saved | None:
        """The last save, or None if there is none that can be read."""
        try:
            progress = json.loads((self.folder / PROGRESS).read_bytes())
            checkpoint = read_checkpoint(self.folder / progress["checkpoint"])
            sessions = tuple(Session.model_validate(session) for session in progress["sessions"])
            self._number, self._chunks = progress["number"], progress["chunks"]
            if not all((self.folder / name).exists() for names in self._chunks.values() for name in names):
                raise FileNotFoundError
        except (OSError, ValueError, KeyError, TypeError):
            self._number, self._chunks = 0, {}
            return None
        self._written = {progress["checkpoint"], *(name for names in self._chunks.values() for name in names)}
        self._sweep()
        return Saved(checkpoint, progress["state"], sessions)

    def save(
        self,
        checkpoint: Checkpoint,
        rows: Mapping[str, Sequence[Table]],
        state: Mapping[str, Any],
        sessions: Iterable[Session],
    ) -> None:
        """Save `checkpoint`, and `rows` by table name since the last save."""
        with room(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
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
        """All rows that were saved, followed by `rows`, by table name."""
        names = dict.fromkeys((*self._chunks, *rows))
        saved = {name: [read_table(self.folder / file) for file in self._chunks.get(name, [])] for name in names}
        tables = {name: join([*saved[name], *rows.get(name, [])]) for name in names}
        return {name: table for name, table in tables.items() if table}

    def _sweep(self) -> None:
        """Remove files that no save names any more; folders are left alone."""
        for entry in os.scandir(self.folder):
            if entry.is_file() and entry.name not in self._written and entry.name != PROGRESS:
                with suppress(FileNotFoundError):
                    os.unlink(entry.path)
