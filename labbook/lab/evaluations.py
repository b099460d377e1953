"""What measures gave of a run: evaluated once, and kept beside its files, one file a measure, version and window.

A file names the content of the run that it was made of. Of a run that went on since, or whose files were replaced, it
is made again; so is one that is damaged.
"""

import errno
import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labbook.lab.folder import EVALUATION, Lab, remove
from labbook.lab.identity import scene_key
from labbook.lab.tables import read_table, write_table
from labbook.measure import Evaluation, Measure, MeasureError, RunData, Window
from labbook.measure.packing import PackingStructure
from labbook.scene import Scene
from labbook.scene.packing import Packing
from labbook.stats import Measured

_TOLD = "_numbers"
_MOST = 2.0**30
"""Bytes that an evaluation may unpack to."""
_CANNOT_WRITE = (errno.EROFS, errno.EACCES, errno.EPERM)
_ODD = (ValueError, ArithmeticError, LookupError, TypeError)
"""What a measure raises on a run that it was not made for: one odd run must not stop the others."""


@dataclass(frozen=True, eq=False)
class Evaluated:
    """What a measure gave of a run, or `problem`: why it cannot be taken of this run."""

    evaluation: Evaluation
    problem: str = ""


def path_of(folder: Path, measure: Measure, window: Window) -> Path:
    """Where the evaluation of the run in `folder` is kept."""
    return folder / f"{EVALUATION}{measure.name}-{measure.version}-{window.start!r}-{window.end!r}.npz"


def evaluated(folder: Path, measure: Measure, window: Window, data: Callable[[], RunData]) -> Evaluated:
    """What a measure gives of the run in `folder`: as it is kept beside it, else evaluated now, by one process at a
    time, and kept.

    `data` reads the run. Where nothing can be written, nothing is kept. Raises what `data` raises, ImportError if a
    package that the measure needs is missing, OSError for a full disk.
    """
    return _once(path_of(folder, measure, window), lambda: evaluate(measure, window, data()))


def evaluated_packing(folder: Path, scene: Scene, packing: Callable[[], Packing]) -> Evaluated:
    """What is measured of the packing in `folder`, which stands in the container of `scene`, by the same rules."""
    measure = PackingStructure()
    path = folder / f"{EVALUATION}{measure.name}-{measure.version}-{scene_key(scene)}.npz"
    return _once(path, lambda: _evaluated(measure, lambda: Evaluation(measure.of(scene, packing()))))


def evaluate(measure: Measure, window: Window, data: RunData) -> Evaluated:
    """What a measure gives of a run, or why it cannot be taken. Raises ImportError if a package is missing."""
    return _evaluated(measure, lambda: measure.evaluate(data, window))


def _evaluated(measure: Measure, evaluation: Callable[[], Evaluation]) -> Evaluated:
    try:
        return Evaluated(evaluation())
    except MeasureError as error:
        return Evaluated(Evaluation(), str(error))
    except _ODD as error:
        return Evaluated(Evaluation(), f"{measure.name} fails: {type(error).__name__}: {error}")


def _once(path: Path, make: Callable[[], Evaluated]) -> Evaluated:
    if (found := _kept(path)) is not None:
        return found
    folder = path.parent
    with Lab(folder.parent.parent).alone(folder.name):
        if (found := _kept(path)) is not None:
            return found
        content, found = _content(folder), make()
        numbers = [vars(one) for one in found.evaluation.numbers]
        told = {"of": content, "numbers": numbers, "problem": found.problem}
        table = {**found.evaluation.arrays, _TOLD: np.array(json.dumps(told))}
        if path.is_dir():
            remove(path)
        try:
            write_table(path, table, durable=False)
        except OSError as error:
            if error.errno not in _CANNOT_WRITE:
                raise
    return found


def _kept(path: Path) -> Evaluated | None:
    """What is kept in a file; None if it is not there, is damaged, or is of other content than the folder has now."""
    try:
        arrays = read_table(path, _MOST)
        told = json.loads(str(arrays.pop(_TOLD)))
        if told["of"] != _content(path.parent):
            return None
        return Evaluated(Evaluation(tuple(Measured(**one) for one in told["numbers"]), arrays), told["problem"])
    except (OSError, *_ODD):
        return None


def _content(folder: Path) -> str:
    """A hash of the record in a folder and of the names and sizes of its files: what an evaluation is made of."""
    entries = [entry for entry in os.scandir(folder) if not entry.name.startswith((EVALUATION, "."))]
    files = sorted((entry.name, entry.stat().st_size) for entry in entries)
    records = [(folder / name).read_bytes() for name, _ in files if name.endswith(".json")]
    return hashlib.blake2b(b"".join([repr(files).encode(), *records]), digest_size=16).hexdigest()
