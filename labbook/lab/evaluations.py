"""Finished runs, and what measures gave of them: evaluated once, kept beside a run's files, and taken into the index.

There is one file a measure, version and window, which names the content of the run that it was made of. Of a run that
went on since, or whose files were replaced, it is made again; so is one that is damaged.
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
from labbook.lab.folder import EVALUATION, LabFolder, is_beside, remove, stamp
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
_TOLD = "_numbers"
_MOST = 2.0**30
"""Bytes that an evaluation may unpack to."""
_CANNOT_WRITE = (errno.EROFS, errno.EACCES, errno.EPERM)
_NOT_OF_THE_MEASURE = (ImportError, OSError, MemoryError)
"""What ends an evaluation for reasons of the machine: the measure is tried again later."""
_DAMAGED = (OSError, ValueError, ArithmeticError, LookupError, TypeError)
"""What reading a damaged file of an evaluation raises."""
Row = Mapping[str, Any]


class NotEvaluated(LookupError):
    """A measure was not evaluated of a run yet, and who asks for it evaluates nothing."""

    def __init__(self, measure: str, run_key: str):
        super().__init__(f"{measure} was not evaluated for the run {run_key}")
        self.run_key = run_key


@dataclass(frozen=True, eq=False)
class Evaluated:
    """What a measure gave of a run, or `problem`: why it cannot be taken of this run."""

    evaluation: Evaluation
    problem: str = ""


def path_of(folder: Path, measure: Measure, window: Window) -> Path:
    """Where the evaluation of the run in `folder` is kept."""
    unit = "s" if window.timed else ""
    stated = "".join(f"-{part}" for part in scales.in_text(window).split())
    return folder / f"{EVALUATION}{measure.name}-{measure.version}-{window.start!r}-{window.end!r}{unit}{stated}.npz"


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
    return _once(path, lambda: _evaluated(measure, scene, lambda: Evaluation(measure.of(scene, packing()))))


def evaluate(measure: Measure, window: Window, data: RunData) -> Evaluated:
    """What a measure gives of a run, or why it cannot be taken.

    Raises ImportError if a package is missing, ExtensionError if the code of another package fails: nothing is kept
    then, so that the corrected code is tried again.
    """

    def evaluation() -> Evaluation:
        with MEASURES.calling(measure.name, MeasureError):
            return measure.evaluate(data, window)

    return _evaluated(measure, data.scene, evaluation)


def _evaluated(measure: Measure, scene: Scene, evaluation: Callable[[], Evaluation]) -> Evaluated:
    try:
        result = evaluation()
    except MeasureError as error:
        return Evaluated(Evaluation(), str(error))
    except (ExtensionError, *_NOT_OF_THE_MEASURE):
        raise
    except Exception as error:  # other measures and runs still count
        return Evaluated(Evaluation(), f"fails: {type(error).__name__}: {error}")
    declared = {quantity.name for quantity in (*measure.declared, *measure.quantities(scene))}
    if unknown := [number.quantity for number in result.numbers if number.quantity not in declared]:
        return Evaluated(Evaluation(), f"fails: it gives {', '.join(unknown)}, and does not declare it")
    return Evaluated(result)


def _once(path: Path, make: Callable[[], Evaluated]) -> Evaluated:
    if (found := _kept(path)) is not None:
        return found
    folder = path.parent
    with LabFolder(folder.parent.parent).alone(folder.name):
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
    except _DAMAGED:
        return None


def _content(folder: Path) -> str:
    """A hash of the record in a folder and of the names and sizes of its data: what an evaluation is made of."""
    entries = [entry for entry in os.scandir(folder) if not (is_beside(entry.name) or entry.name.startswith("."))]
    files = sorted((entry.name, entry.stat().st_size) for entry in entries)
    records = [(folder / name).read_bytes() for name, _ in files if name.endswith(".json")]
    return hashlib.blake2b(b"".join([repr(files).encode(), *records]), digest_size=16).hexdigest()


@dataclass(frozen=True)
class FinishedRun:
    """A run that covers what a study asks for.

    `entry`: its attributes, from the index; `outdated`: changes of its law and walls since it was made, empty without
    any.
    """

    point: Point
    seed: int
    folder: Path
    entry: Entry
    outdated: str = ""
    discharge: int = 1
    """Number of the discharge of its bed."""

    @property
    def repeat(self) -> str:
        """The number of a run among those of its point, for people: `seed 3, discharge 2`."""
        return repeat(self.seed, self.discharge)

    @cached_property
    def record(self) -> RunRecord:
        """All that the run says of itself. Raises Unreadable."""
        return RunRecord.read(self.folder)

    @property
    def provenance(self) -> dict[str, Any]:
        """Commit, versions, processor, device, threads, precision, seed, times and speed."""
        return self.record.provenance

    def data(self) -> RunData:
        """Start and tables, for measuring. Raises Unreadable, where the folder changed also for what is not read."""
        if stamp(self.folder) != self.entry.stamp:
            return open_run(self.folder)[1]
        return run_data(self.folder, self.record)

    def evaluated(self, measure: Measure, window: Window) -> Evaluated:
        """What a measure gave of the run: kept beside it, or evaluated now. Raises Unreadable; ImportError;
        ExtensionError."""
        return evaluated(self.folder, measure, window, self.data)

    def recording(self) -> dict[str, np.ndarray] | None:
        """Recorded frames (columns id, step, time, x, y, z, vx, vy, vz; single precision), or None without
        any. Raises Unreadable."""
        return read_recording(self.folder, self.record)


class ReadOnlyRun(FinishedRun):
    """A finished run for those who only look: what was not evaluated of it stays so."""

    def evaluated(self, measure: Measure, window: Window) -> Evaluated:
        """What a measure gave of the run, as it is kept beside it. Raises NotEvaluated."""
        found = _kept(path_of(self.folder, measure, window))
        if found is None:
            raise NotEvaluated(measure.name, self.entry.run_key)
        return found


def wanted(observe: Observe) -> list[Measure]:
    """The measures that it names, as far as they are known."""
    return [MEASURES[name] for name in dict.fromkeys(observe.measure) if name in MEASURES]


def expected(observe: Observe) -> set[tuple[str, int, float, float, bool, str]]:
    """(measure, version, window) of what should have been measured."""
    window = (observe.start, observe.end, observe.timed, scales.in_text(observe))
    return {(measure.name, measure.version, *window) for measure in wanted(observe)}


def derive(folder: Path, observe: Observe, data: Callable[[], RunData]) -> list[dict[str, Any]]:
    """Rows for the table of measurements of the run in `folder`: of what is kept beside it, or else evaluated now.

    A measure that cannot be taken of this run, or that fails on it, leaves a row with its own name, no value, and the
    reason as note. One that lacks a package, or an extension whose code fails, leaves none, and is tried again. Raises
    what `data` raises.
    """
    rows = []
    for measure in wanted(observe):
        try:
            rows += rows_of(folder.name, measure, observe, evaluated(folder, measure, observe, data))
        except (ImportError, ExtensionError):
            continue
    return rows


def rows_of(run_key: str, measure: Measure, window: Window, found: Evaluated) -> list[dict[str, Any]]:
    """Rows for the table of measurements of what a measure gave of a run."""
    shared = {
        "run_key": run_key,
        "version": measure.version,
        "window_start": window.start,
        "window_end": window.end,
        "window_timed": window.timed,
        "window_scales": scales.in_text(window),
        "measure": measure.name,
    }
    numbers = (vars(one) for one in found.evaluation.numbers)
    rows = [{**shared, **{name: finite(value) for name, value in one.items()}} for one in numbers]
    nothing = dict.fromkeys(NAMES) | {"quantity": measure.name, "window": "", "method": "", "unit": ""}
    return rows or [{**shared, **nothing, "note": found.problem or NO_NUMBER}]


def finite(value: Any) -> Any:
    """A value as SQL can hold it: None for NaN and infinities."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


@dataclass
class Numbers:
    """What was measured of runs, by run key: numbers by quantity, or why the run cannot be read."""

    measured: dict[str, dict[str, Measured]] = field(default_factory=dict)
    problems: dict[str, str] = field(default_factory=dict)
    failed: dict[str, dict[str, str]] = field(default_factory=dict)
    """Measures that could not be taken of a run, and why; its other numbers stand."""
    lacking: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Measures that were not evaluated of a run yet, where nothing is evaluated."""


def numbers(
    catalogue: Catalogue,
    runs: Iterable[FinishedRun],
    observe: Observe,
    progress: Callable[[int], None] = lambda _: None,
) -> Numbers:
    """What `observe` asks for of each run; what was not evaluated yet is evaluated, kept, and taken into the index.

    A run whose folder changed since it was indexed is read as a whole. `progress` is told how many runs are done.
    """
    found, every = Numbers(), {run.entry.run_key: run for run in runs}
    changed, stored = catalogue.changed(every), catalogue.measured(every, observe)
    new: list[dict[str, Any]] = []
    try:
        for done, (key, run) in enumerate(every.items(), 1):
            try:
                had = stored.get(key, {})
                if key in changed:
                    open_run(run.folder)
                    had = {}
                found.measured[key] = {}
                for measure in wanted(observe):
                    rows = had.get((measure.name, measure.version))
                    if rows is None:
                        try:
                            rows = rows_of(key, measure, observe, evaluated(run.folder, measure, observe, run.data))
                        except (ImportError, ExtensionError) as problem:
                            _note(found, run, measure, str(problem))
                            continue
                        new += rows
                    _take(found, run, measure, rows)
            except Unreadable as problem:
                found.problems[key] = str(problem)
            progress(done)
    finally:
        add_measurements(catalogue.lab, new)
    return found


def kept_numbers(catalogue: Catalogue, runs: Iterable[FinishedRun], observe: Observe) -> Numbers:
    """What the index has of each run, of what `observe` asks for. Nothing is evaluated, and no folder is looked at."""
    found, every = Numbers(), {run.entry.run_key: run for run in runs}
    stored = catalogue.measured(every, observe)
    for key, run in every.items():
        found.measured[key], had = {}, stored.get(key, {})
        for measure in wanted(observe):
            if (rows := had.get((measure.name, measure.version))) is not None:
                _take(found, run, measure, rows)
            else:
                found.lacking[key] = (*found.lacking.get(key, ()), measure.name)
    return found


def _note(found: Numbers, run: FinishedRun, measure: Measure, why: str) -> None:
    said = f"run {run.entry.run_key} of {run.point.label}, {run.repeat}: {measure.name}: {why}"
    found.failed.setdefault(run.entry.run_key, {})[measure.name] = said


def _take(found: Numbers, run: FinishedRun, measure: Measure, rows: Sequence[Row]) -> None:
    """Numbers from rows of a measure, in the order in which it declares them."""
    order = {one.name: place for place, one in enumerate(measure.declared)}
    for row in sorted(rows, key=lambda row: order.get(row["quantity"], len(order))):
        if not row["method"]:
            if row["note"] != NO_NUMBER:
                _note(found, run, measure, row["note"])
            continue
        told = {name: row[name] for name in NAMES}
        known = {name: math.nan if told[name] is None else told[name] for name in ("value", "error", "n_effective")}
        found.measured[run.entry.run_key][row["quantity"]] = Measured(**{**told, **known})
