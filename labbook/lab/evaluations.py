"""Finished runs and their evaluations by measures: made once, stored beside a run's files, and indexed.

There is one file for each measure, version and window. It has a hash of the content of the run from which it was made.
It is made again if that content has changed since, or if the file is damaged.
"""

import errno
import hashlib
import json
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from labbook.lab.catalogue import Catalogue, Entry
from labbook.lab.database import add_measurements
from labbook.lab.folder import EVALUATION, LabFolder, is_derived, remove, stamp
from labbook.lab.identity import scene_key
from labbook.lab.records import Observe, RunRecord, Unreadable, repeat
from labbook.lab.runs import open_run, read_recording, run_data
from labbook.lab.tables import read_table, write_table
from labbook.measure import MEASURES, Evaluation, Measure, MeasureError, RunData, Window, scales
from labbook.measure.packing import PackingStructure
from labbook.plugins import ExtensionError
from labbook.scene import Scene
from labbook.scene.packing import Packing
from labbook.stats import Measured
from labbook.study import Point

NO_NUMBER = "the run gives no number"
"""Note in the row of a measure that could be taken, and gave no number."""
NAMES = tuple(field.name for field in fields(Measured))
_METADATA = "_numbers"
_MAX_BYTES = 2.0**30
"""Maximum unpacked size of an evaluation [bytes]."""
_CANNOT_WRITE = (errno.EROFS, errno.EACCES, errno.EPERM)
_MACHINE_ERRORS = (ImportError, OSError, MemoryError)
"""Errors whose cause is the machine: the measure is tried again later."""
_DAMAGED = (OSError, ValueError, ArithmeticError, LookupError, TypeError)
"""Errors that reading a damaged evaluation may raise."""
Row = Mapping[str, Any]


class NotEvaluated(LookupError):
    """A measure has not been evaluated for a run, and the caller may not evaluate."""

    def __init__(self, measure: str, run_key: str):
        super().__init__(f"{measure} was not evaluated for the run {run_key}")
        self.run_key = run_key


@dataclass(frozen=True, eq=False)
class Evaluated:
    """Result of a measure for one run.

    Args:
        evaluation: Numbers, profiles and fields; empty if there is a problem.
        problem: Why the measure cannot be taken of this run; empty if it can.
    """

    evaluation: Evaluation
    problem: str = ""


def path_of(folder: Path, measure: Measure, window: Window) -> Path:
    """Return the path of the file with the evaluation of the run in `folder`."""
    unit = "s" if window.timed else ""
    # Bounds in all their digits (repr): windows that differ in the last one have files of their own.
    scale_suffix = "".join(f"-{part}" for part in scales.in_text(window).split())
    return (
        folder / f"{EVALUATION}{measure.name}-{measure.version}-{window.start!r}-{window.end!r}{unit}{scale_suffix}.npz"
    )


def evaluated(folder: Path, measure: Measure, window: Window, data: Callable[[], RunData]) -> Evaluated:
    """Return the evaluation of the run in `folder`: read from its file, else made now and written.

    A lock of the run ensures that only one process at a time evaluates it. In a lab that cannot be written to, the
    evaluation is made and not stored.

    Args:
        folder: Folder of the run.
        measure: Measure to evaluate.
        window: Part of the run that is measured.
        data: Reads the run; called only if it is evaluated now.

    Raises:
        ImportError: A package that the measure needs is missing.
        ExtensionError: The code of another package fails.
        OSError: The disk is full.
        Exception: Any error of `data`.
    """
    return _load_or_make(path_of(folder, measure, window), lambda: evaluate(measure, window, data()))


def stored(folder: Path, measure: Measure, window: Window) -> Evaluated | None:
    """Return the stored evaluation of the run in `folder`; None without a valid one."""
    return _read_kept(path_of(folder, measure, window))


def evaluated_packing(folder: Path, scene: Scene, packing: Callable[[], Packing]) -> Evaluated:
    """Return the evaluation of the packing in `folder` by `PackingStructure`, as `evaluated` does for a run.

    Args:
        folder: Folder of the packing.
        scene: Scene in whose container it is measured.
        packing: Reads the packing; called only if it is evaluated now.
    """
    measure = PackingStructure()
    path = folder / f"{EVALUATION}{measure.name}-{measure.version}-{scene_key(scene)}.npz"
    return _load_or_make(path, lambda: _evaluated(measure, scene, lambda: Evaluation(measure.of(scene, packing()))))


def evaluate(measure: Measure, window: Window, data: RunData) -> Evaluated:
    """Evaluate a measure for one run, without storing the result.

    Raises:
        ImportError: A package that the measure needs is missing.
        ExtensionError: The code of another package fails. It is raised, not stored, so that corrected code is tried
            again.
    """

    def evaluation() -> Evaluation:
        if measure.needs_all and data.start.waiting is not None:
            late = f"{int(data.start.waiting.sum())} grains entered after the opening"
            raise MeasureError(f"{measure.name}: {late}", "use a later fill.until, or a larger fill.stream.rate")
        with MEASURES.calling(measure.name, MeasureError):
            return measure.evaluate(data, window)

    return _evaluated(measure, data.scene, evaluation)


def _evaluated(measure: Measure, scene: Scene, evaluation: Callable[[], Evaluation]) -> Evaluated:
    try:
        result = evaluation()
    except MeasureError as error:
        return Evaluated(Evaluation(), str(error))
    except (ExtensionError, *_MACHINE_ERRORS):
        raise
    except Exception as error:  # other measures and runs still count
        return Evaluated(Evaluation(), f"fails: {type(error).__name__}: {error}")
    declared = {quantity.name for quantity in (*measure.declared, *measure.quantities(scene))}
    if undeclared := [number.quantity for number in result.numbers if number.quantity not in declared]:
        return Evaluated(Evaluation(), f"fails: it gives {', '.join(undeclared)}, and does not declare it")
    return Evaluated(result)


def _load_or_make(path: Path, make: Callable[[], Evaluated]) -> Evaluated:
    """Read an evaluation from its file, else make it under the lock of the run and write the file."""
    if (result := _read_kept(path)) is not None:
        return result
    folder = path.parent
    with LabFolder(folder.parent.parent).alone(folder.name):
        if (result := _read_kept(path)) is not None:  # another process has made it while this one waited
            return result
        # Hashed before the run is read: if the folder changes meanwhile, the evaluation does not count for the new
        # content.
        content, result = _content(folder), make()
        numbers = [vars(number) for number in result.evaluation.numbers]
        metadata = {"of": content, "numbers": numbers, "problem": result.problem}
        table = {**result.evaluation.arrays, _METADATA: np.array(json.dumps(metadata))}
        if path.is_dir():  # os.replace cannot put a file in place of a folder
            remove(path)
        try:
            write_table(path, table, durable=False)  # not synchronised: a lost evaluation is made again
        except OSError as error:
            if error.errno not in _CANNOT_WRITE:
                raise
    return result


def _read_kept(path: Path) -> Evaluated | None:
    """Read an evaluation; None if the file is missing, damaged, or made from other content than the folder has now."""
    try:
        arrays = read_table(path, _MAX_BYTES)
        metadata = json.loads(str(arrays.pop(_METADATA)))
        if metadata["of"] != _content(path.parent):
            return None
        return Evaluated(
            Evaluation(tuple(Measured(**number) for number in metadata["numbers"]), arrays), metadata["problem"]
        )
    except _DAMAGED:
        return None


def _content(folder: Path) -> str:
    """Hash of the record in a folder and of the names and sizes of its data files: the content that an evaluation
    depends on."""
    entries = [entry for entry in os.scandir(folder) if not (is_derived(entry.name) or entry.name.startswith("."))]
    files = sorted((entry.name, entry.stat().st_size) for entry in entries)
    # Tables are not hashed: that would take as long as an evaluation. They change only together with the record.
    records = [(folder / name).read_bytes() for name, _ in files if name.endswith(".json")]
    return hashlib.blake2b(b"".join([repr(files).encode(), *records]), digest_size=16).hexdigest()


@dataclass(frozen=True)
class FinishedRun:
    """A run that covers what a study demands.

    Args:
        point: Point of the study.
        seed: Seed of the bed.
        folder: Folder of the run in the lab.
        entry: Its entry in the index.
        outdated: Changes of its law and walls since it was made; empty without any.
        discharge: Number of the discharge of its bed, from 1.
    """

    point: Point
    seed: int
    folder: Path
    entry: Entry
    outdated: str = ""
    discharge: int = 1

    @property
    def repeat(self) -> str:
        """Label of the run among those of its point: `seed 3, discharge 2`."""
        return repeat(self.seed, self.discharge)

    @cached_property
    def record(self) -> RunRecord:
        """Record of the run. Raises Unreadable."""
        return RunRecord.read(self.folder)

    @property
    def provenance(self) -> dict[str, Any]:
        """Commit, versions, processor, device, threads, precision, seed, times and speed."""
        return self.record.provenance

    def data(self) -> RunData:
        """Read start and tables, for measuring. Raises Unreadable.

        If the folder has changed since it was indexed, all files of the run are checked.
        """
        if stamp(self.folder) != self.entry.stamp:
            return open_run(self.folder)[1]
        return run_data(self.folder, self.record)

    def evaluated(self, measure: Measure, window: Window) -> Evaluated:
        """Return the evaluation of a measure: read from its file, or made now. Raises Unreadable, ImportError,
        ExtensionError."""
        return evaluated(self.folder, measure, window, self.data)

    def recording(self) -> dict[str, np.ndarray] | None:
        """Recorded frames (columns id, step, time, x, y, z, vx, vy, vz; single precision), or None without
        any. Raises Unreadable."""
        return read_recording(self.folder, self.record)


class ReadOnlyRun(FinishedRun):
    """A finished run for readers: nothing is evaluated."""

    def evaluated(self, measure: Measure, window: Window) -> Evaluated:
        """Return the stored evaluation of a measure. Raises NotEvaluated."""
        result = stored(self.folder, measure, window)
        if result is None:
            raise NotEvaluated(measure.name, self.entry.run_key)
        return result


def measures_of(observe: Observe) -> list[Measure]:
    """Return the measures that `observe` names; names of measures that are not installed are skipped."""
    return [MEASURES[name] for name in dict.fromkeys(observe.measure) if name in MEASURES]


def expected(observe: Observe) -> set[tuple[str, int, float, float, bool, str]]:
    """Return (measure, version, window) of each measurement that `observe` demands."""
    window = (observe.start, observe.end, observe.timed, scales.in_text(observe))
    return {(measure.name, measure.version, *window) for measure in measures_of(observe)}


def derive(folder: Path, observe: Observe, data: Callable[[], RunData]) -> list[dict[str, Any]]:
    """Make the rows of a run for the table of measurements, from stored evaluations or new ones.

    A measure that cannot be taken of this run, or fails on it, gives a row with its own name, no value, and the reason
    as note. A measure that lacks a package, or whose extension fails, gives no row, and is tried again later.

    Args:
        folder: Folder of the run.
        observe: Measures and window.
        data: Reads the run. Its errors are raised.
    """
    rows = []
    for measure in measures_of(observe):
        try:
            rows += rows_of(folder.name, measure, observe, evaluated(folder, measure, observe, data))
        except (ImportError, ExtensionError):
            continue
    return rows


def rows_of(run_key: str, measure: Measure, window: Window, result: Evaluated) -> list[dict[str, Any]]:
    """Make rows for the table of measurements from the evaluation of a measure."""
    shared = {
        "run_key": run_key,
        "version": measure.version,
        "window_start": window.start,
        "window_end": window.end,
        "window_timed": window.timed,
        "window_scales": scales.in_text(window),
        "measure": measure.name,
    }
    numbers = (vars(number) for number in result.evaluation.numbers)
    rows = [{**shared, **{name: finite(value) for name, value in number.items()}} for number in numbers]
    # a row even without numbers: without one the measure would be evaluated again at every request
    nothing = dict.fromkeys(NAMES) | {"quantity": measure.name, "window": "", "method": "", "unit": ""}
    return rows or [{**shared, **nothing, "note": result.problem or NO_NUMBER}]


def finite(value: Any) -> Any:
    """Return a value that SQL can store: None for NaN and infinities."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


@dataclass
class Numbers:
    """Measured numbers of several runs.

    Args:
        measured: Numbers by run key and quantity.
        problems: Why a run cannot be read, by run key.
        failed: Why a measure could not be taken of a run, by run key and measure; the run's other numbers are valid.
        lacking: Names of measures that have not been evaluated, by run key, where nothing is evaluated.
    """

    measured: dict[str, dict[str, Measured]] = field(default_factory=dict)
    problems: dict[str, str] = field(default_factory=dict)
    failed: dict[str, dict[str, str]] = field(default_factory=dict)
    lacking: dict[str, tuple[str, ...]] = field(default_factory=dict)


def numbers(
    catalogue: Catalogue,
    runs: Iterable[FinishedRun],
    observe: Observe,
    progress: Callable[[int], None] = lambda _: None,
) -> Numbers:
    """Return the numbers of runs; missing evaluations are made, stored and indexed.

    A run whose folder changed since it was indexed is checked completely.

    Args:
        catalogue: Index of the lab.
        runs: Runs to measure.
        observe: Measures and window.
        progress: Called with the number of runs that are done.
    """
    collected, by_key = Numbers(), {run.entry.run_key: run for run in runs}
    changed, stored = catalogue.changed(by_key), catalogue.measured(by_key, observe)
    new: list[dict[str, Any]] = []
    try:
        for done, (key, run) in enumerate(by_key.items(), 1):
            try:
                known_rows = stored.get(key, {})
                if key in changed:  # its numbers in the index are of another content
                    open_run(run.folder)
                    known_rows = {}
                collected.measured[key] = {}
                for measure in measures_of(observe):
                    rows = known_rows.get((measure.name, measure.version))
                    if rows is None:
                        try:
                            rows = rows_of(key, measure, observe, evaluated(run.folder, measure, observe, run.data))
                        except (ImportError, ExtensionError) as problem:
                            _add_failure(collected, run, measure, str(problem))
                            continue
                        new += rows
                    _add_numbers(collected, run, measure, rows)
            except Unreadable as problem:
                collected.problems[key] = str(problem)
            progress(done)
    finally:  # after an error or Ctrl-C too: evaluations can take minutes
        add_measurements(catalogue.lab, new)
    return collected


def kept_numbers(catalogue: Catalogue, runs: Iterable[FinishedRun], observe: Observe) -> Numbers:
    """Return the numbers of runs that the index has. Nothing is evaluated, and no folder is read."""
    collected, by_key = Numbers(), {run.entry.run_key: run for run in runs}
    stored = catalogue.measured(by_key, observe)
    for key, run in by_key.items():
        collected.measured[key], known_rows = {}, stored.get(key, {})
        for measure in measures_of(observe):
            if (rows := known_rows.get((measure.name, measure.version))) is not None:
                _add_numbers(collected, run, measure, rows)
            else:
                collected.lacking[key] = (*collected.lacking.get(key, ()), measure.name)
    return collected


def _add_failure(collected: Numbers, run: FinishedRun, measure: Measure, reason: str) -> None:
    message = f"run {run.entry.run_key} of {run.point.label}, {run.repeat}: {measure.name}: {reason}"
    collected.failed.setdefault(run.entry.run_key, {})[measure.name] = message


def _add_numbers(collected: Numbers, run: FinishedRun, measure: Measure, rows: Sequence[Row]) -> None:
    """Add the numbers of one measure, in the order in which the measure declares them."""
    order = {quantity.name: index for index, quantity in enumerate(measure.declared)}
    for row in sorted(rows, key=lambda row: order.get(row["quantity"], len(order))):
        if not row["method"]:  # the row stands for the measure, which gave no number
            if row["note"] != NO_NUMBER:
                _add_failure(collected, run, measure, row["note"])
            continue
        fields_of_row = {name: row[name] for name in NAMES}
        numeric_fields = {
            name: math.nan if fields_of_row[name] is None else fields_of_row[name]
            for name in ("value", "error", "n_effective")
        }
        collected.measured[run.entry.run_key][row["quantity"]] = Measured(**{**fields_of_row, **numeric_fields})
