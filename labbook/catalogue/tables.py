"""Tables of a run as npz files, and an engine's checkpoint likewise."""

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from labbook.backend import Checkpoint
from labbook.catalogue.lab import write_bytes
from labbook.probes import Table

_META = "_meta"


def write_table(path: Path, table: Table, *, compress: bool = True) -> None:
    """Write columns by name as one npz, whole or not at all."""
    _write(path, dict(table), compress)


def read_table(path: Path) -> dict[str, np.ndarray]:
    """Columns by name. Raises OSError or ValueError on a file that is none."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except (BadZipFile, EOFError, KeyError, AttributeError) as error:
        raise ValueError(f"{path}: not a table of numbers ({type(error).__name__})") from error


def join(tables: Sequence[Table]) -> dict[str, np.ndarray]:
    """One table below the other; none gives a table without columns."""
    if not tables:
        return {}
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def write_checkpoint(path: Path, checkpoint: Checkpoint, *, compress: bool = False) -> None:
    """Write an engine's exact state; while work goes on it is written often, so not compressed."""
    meta = json.dumps({"engine": checkpoint.engine, "cache_version": checkpoint.cache_version})
    _write(path, {**checkpoint.arrays, _META: np.array(meta)}, compress)


def read_checkpoint(path: Path) -> Checkpoint:
    """Read what `write_checkpoint` wrote. Raises OSError or ValueError on a file that is none."""
    arrays = read_table(path)
    if _META not in arrays:
        raise ValueError(f"{path}: not a checkpoint")
    meta = json.loads(str(arrays.pop(_META)))
    return Checkpoint(meta["engine"], meta["cache_version"], arrays)


def _write(path: Path, arrays: Mapping[str, np.ndarray], compress: bool) -> None:
    buffer = io.BytesIO()
    save = np.savez_compressed if compress else np.savez
    save(buffer, **arrays)  # pyright: ignore[reportArgumentType]
    write_bytes(path, buffer.getvalue())
