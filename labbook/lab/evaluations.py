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

from labbook.lab.folder import EVALUATION, Lab
from labbook.lab.records import RunRecord
from labbook.lab.tables import read_table, write_table
from labbook.measure import Evaluation, Measure, MeasureError, RunData, Window
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


def kept(folder: Path, measure: Measure, window: Window) -> Evaluated | None:
    """The evaluation that is kept beside a run; None if there is none, or none of the run as it is now."""
    try:
        arrays = read_table(path_of(folder, measure, window), _MOST)
        told = json.loads(str(arrays.pop(_TOLD)))
        if told["of"] != _content(folder):
            return None
        return Evaluated(Evaluation(tuple(Measured(**one) for one in told["numbers"]), arrays), told["problem"])
    except (OSError, *_ODD):  # not there, or damaged: it is made again
        return None


def evaluated(folder: Path, measure: Measure, window: Window, data: Callable[[], RunData]) -> Evaluated:
    """The evaluation that is kept beside the run in `folder`; if there is none it is made, by one process at a time.

    `data` reads the run. Where nothing can be written, the evaluation is not kept. Raises what `data` raises,
    ImportError if a package that the measure needs is missing, OSError for a full disk.
    """
    if (found := kept(folder, measure, window)) is not None:
        return found
    with Lab(folder.parent.parent).alone(folder.name):
        if (found := kept(folder, measure, window)) is not None:
            return found
        content, found = _content(folder), evaluate(measure, window, data())
        told = {
            "of": content,
            "numbers": [vars(one) for one in found.evaluation.numbers],
            "problem": found.problem,
        }
        table = {**found.evaluation.arrays, _TOLD: np.array(json.dumps(told))}
        try:
            write_table(path_of(folder, measure, window), table, durable=False)
        except OSError as error:
            if error.errno not in _CANNOT_WRITE:
                raise
    return found


def evaluate(measure: Measure, window: Window, data: RunData) -> Evaluated:
    """What a measure gives of a run, or why it cannot be taken. Raises ImportError if a package is missing."""
    try:
        return Evaluated(measure.evaluate(data, window))
    except MeasureError as error:
        return Evaluated(Evaluation(), str(error))
    except _ODD as error:
        return Evaluated(Evaluation(), f"{measure.name} fails: {type(error).__name__}: {error}")


def _content(folder: Path) -> str:
    """A hash of the record of a run and of the names and sizes of its files: what an evaluation is made of."""
    entries = (entry for entry in os.scandir(folder) if not entry.name.startswith((EVALUATION, ".")))
    files = sorted((entry.name, entry.stat().st_size) for entry in entries)
    record = (folder / RunRecord.FILE).read_bytes()
    return hashlib.blake2b(repr(files).encode() + record, digest_size=16).hexdigest()
