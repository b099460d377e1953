"""Tables of runs, and checkpoints of backends, as npz files."""

import io
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile

import numpy as np
from numpy.lib import format as npy

from labbook.backend import Checkpoint
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Above, Crossing, Dissipation, Film, Ledger, Probe, Table, columns
from labbook.lab.folder import open_file, write_bytes
from labbook.scene import Scene
from labbook.scene.quantities import format_distinct
from labbook.scene.wall_bins import all_walls

MAX_TABLE_BYTES = 2.0**34
"""Maximum unpacked size of a file, whatever it declares: it is read into memory."""
_TIME_TOLERANCE = 1.001  # steps between the time of a row and its step: crossings are interpolated within theirs
_CONTACT_ROWS = 64  # rows of a grain in one frame, at most
_LEVEL = 1  # of compression: level 6 is hardly smaller and takes twice as long
_METADATA = "_meta"
_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


def write_table(path: Path, table: Table, *, compress: bool = True, durable: bool = True) -> None:
    """Write columns by name as one npz file, atomically.

    Args:
        path: File to write.
        table: Columns by name.
        compress: Compress the columns.
        durable: Synchronise the file with the disk.
    """
    _write(path, dict(table), compress, durable)


def read_table(path: Path, max_bytes: float = MAX_TABLE_BYTES) -> dict[str, np.ndarray]:
    """Read all columns by name. Raises OSError or ValueError as `Stored` does."""
    with Stored(path, max_bytes) as stored:
        return dict(stored)


class Stored(Mapping[str, np.ndarray]):
    """Columns of an npz file, each read at its first use; a context that keeps the file open.

    Nothing is unpacked before the declared sizes have been checked: at most `max_bytes` in all, and columns of numbers
    or text whose size fits their shape.

    Raises:
        OSError: The file cannot be read.
        ValueError: It is not such a table.
    """

    def __init__(self, path: Path, max_bytes: float = MAX_TABLE_BYTES):
        self._path, self._file = path, open_file(path)
        try:
            with self._reading():
                self._archive = ZipFile(self._file)
                self._entries = {entry.filename.removesuffix(".npy"): entry for entry in self._archive.infolist()}
                declared = sum(entry.file_size for entry in self._archive.infolist())
                if declared > max_bytes:
                    size, limit = format_distinct(declared, max_bytes, of_limit=3)
                    raise ValueError(f"it declares {size} bytes, more than the allowed {limit}")
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> "Stored":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def __contains__(self, name: object) -> bool:
        return name in self._entries

    def __getitem__(self, name: str) -> np.ndarray:
        entry = self._entries[name]
        with self._reading(), self._archive.open(entry) as stream:
            version = npy.read_magic(stream)
            if version not in _HEADERS:
                raise ValueError(f"{name}: npy version {version}")
            shape, _, dtype = _HEADERS[version](stream)
            if dtype.hasobject or math.prod(shape) * dtype.itemsize != entry.file_size - stream.tell():
                raise ValueError(f"{name}: not {shape} of {dtype}")
            stream.seek(0)
            return npy.read_array(stream, allow_pickle=False)  # a pickle could run any code

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Raise ValueError for any error that unpacking damaged bytes causes."""
        try:
            yield
        except OSError:
            raise
        except Exception as error:  # zipfile, zlib and numpy raise a dozen kinds on bytes that are no table
            why = str(error) if type(error) is ValueError else type(error).__name__
            raise ValueError(f"{self._path}: not a table of numbers ({why})") from error


def fault_of_rows(table: Table, probe: Probe, scene: Scene, numerics: Numerics, steps: int) -> str | None:
    """Explain why these cannot be the rows that `probe` gave in a run; None if they can.

    Columns must have the right type, finite values and equal lengths. Steps and times must lie within the run and
    agree, ids and walls must exist in the scene. Columns are read one at a time.

    Args:
        table: Columns by name.
        probe: Probe of the run.
        scene: Scene of the run.
        numerics: Numerics of the run.
        steps: Number of steps of the run.
    """
    kinds = columns(probe, rods=scene.grains.oriented)
    del kinds["member"]
    if missing := [name for name in kinds if name not in table]:
        return f"no column {', '.join(missing)}"
    count, step = None, np.zeros(0)
    for name, kind in kinds.items():
        column = np.asarray(table[name])
        count = len(column) if count is None and column.ndim == 1 else count
        if column.shape != (count,):
            return f"column {name} has shape {column.shape}, not ({count},)"
        if not np.issubdtype(column.dtype, np.integer if kind is np.int64 else np.floating):
            return f"column {name} holds {column.dtype}"
        if not np.isfinite(column).all():
            return f"column {name} is not finite in row {int(np.argmin(np.isfinite(column)))}"
        if name in (limits := _limits(scene, steps)) and count:
            smallest, greatest = limits[name]
            if not (column.min() >= smallest and column.max() <= greatest):
                return f"column {name} is not within {smallest} to {greatest}"
        if name == "step":
            step = column
        elif name == "time" and count and np.abs(column / numerics.dt - step).max() > _TIME_TOLERANCE:
            return "column time does not match the steps"
    return None


def _limits(scene: Scene, steps: int) -> dict[str, tuple[int, int]]:
    last_id, walls = scene.grains.count - 1, len(all_walls(scene.container)) - 1
    return {"step": (0, steps), "id": (0, last_id), "i": (0, last_id), "j": (-1, last_id), "wall": (-1, walls)}


def most_bytes(probe: Probe, scene: Scene, numerics: Numerics, steps: int) -> float:
    """Upper bound of the unpacked size of the table that `probe` gave in `steps` steps [bytes]."""
    if isinstance(probe, Crossing):  # a grain that is fed passes once a beat at most
        rows = scene.grains.count * (1 if scene.feed is None else steps // numerics.steps_per_beat + 1)
    elif isinstance(probe, Film):
        rows = (steps * numerics.dt / probe.every + 2) * scene.grains.count
    else:
        frames = 2 * (steps // (probe.every * numerics.steps_per_beat) + 1)
        single = isinstance(probe, Above | Ledger | Dissipation)
        planes = len(probe.planes) if isinstance(probe, Above) else 1
        rows = frames * (planes if single else _CONTACT_ROWS * scene.grains.count)
    return min(MAX_TABLE_BYTES, 2**16 + 8 * rows * len(columns(probe, rods=True)))


def join(tables: Sequence[Table]) -> dict[str, np.ndarray]:
    """Concatenate tables; an empty sequence gives a table without columns."""
    if not tables:
        return {}
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def write_checkpoint(path: Path, checkpoint: Checkpoint, *, compress: bool = False, durable: bool = True) -> None:
    """Write the exact state of a backend.

    Args:
        path: File to write.
        checkpoint: State of one member.
        compress: Compress the arrays; checkpoints of unfinished work are written often, so they are not compressed.
        durable: Synchronise the file with the disk.
    """
    meta = json.dumps({"engine": checkpoint.backend, "cache_version": checkpoint.cache_version})
    _write(path, {**checkpoint.arrays, _METADATA: np.array(meta)}, compress, durable)


def read_checkpoint(path: Path, limit: float = MAX_TABLE_BYTES) -> Checkpoint:
    """Read a file that `write_checkpoint` wrote. Raises OSError or ValueError."""
    arrays = read_table(path, limit)
    try:
        meta = json.loads(str(arrays.pop(_METADATA)))
        backend, version = meta["engine"], meta["cache_version"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"{path}: not a checkpoint: it does not name its backend") from error
    if not isinstance(backend, str) or type(version) is not int:
        raise ValueError(f"{path}: not a checkpoint: it does not name its backend")
    return Checkpoint(backend, version, arrays)


def _write(path: Path, arrays: Mapping[str, np.ndarray], compress: bool, durable: bool = True) -> None:
    buffer = io.BytesIO()  # in memory: ZipFile seeks back in its file, and `write_bytes` replaces a file atomically
    with ZipFile(buffer, "w", ZIP_DEFLATED if compress else ZIP_STORED, compresslevel=_LEVEL) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                npy.write_array(stream, np.asanyarray(array), allow_pickle=False)
    write_bytes(path, buffer.getvalue(), durable=durable)
