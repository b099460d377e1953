"""The numbers of finished runs: from the index, else from what is kept beside a run, else evaluated now, once."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from labbook.lab.catalogue import Catalogue
from labbook.lab.derive import NAMES, NO_NUMBER, rows_of, wanted
from labbook.lab.evaluations import evaluated
from labbook.lab.index import add_measurements
from labbook.lab.records import Observe, Unreadable
from labbook.lab.runs import FinishedRun, open_run
from labbook.measure import Measure
from labbook.stats import Measured

Row = Mapping[str, Any]


@dataclass
class Numbers:
    """What was measured of runs, by run key: numbers by quantity, or why they cannot be had."""

    measured: dict[str, dict[str, Measured]] = field(default_factory=dict)
    problems: dict[str, str] = field(default_factory=dict)


def numbers(
    catalogue: Catalogue,
    runs: Iterable[FinishedRun],
    observe: Observe,
    progress: Callable[[int], None] = lambda _: None,
) -> Numbers:
    """What `observe` asks for of each run; what was not evaluated yet is evaluated, kept, and taken into the index.

    A run whose folder changed since it was indexed is read as a whole. `progress` is told how many runs are done.
    """
    found, every = Numbers(), {run.run_key: run for run in runs}
    changed, stored = catalogue.changed(list(every)), catalogue.measured(list(every), observe)
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
                        rows = rows_of(key, measure, observe, evaluated(run.folder, measure, observe, run.data))
                        new += rows
                    _take(found, run, measure, rows)
            except ImportError as missing:
                found.problems[key] = _said(run, f"{measure.name}: {missing}")
            except Unreadable as problem:
                found.problems[key] = str(problem)
            progress(done)
    finally:
        add_measurements(catalogue.lab, new)
    return found


def _said(run: FinishedRun, problem: str) -> str:
    return f"run {run.run_key} of {run.point.label}, seed {run.seed}: {problem}"


def _take(found: Numbers, run: FinishedRun, measure: Measure, rows: Sequence[Row]) -> None:
    """Numbers from rows of a measure, in the order in which it declares them."""
    order = {one.name: place for place, one in enumerate(measure.declared)}
    for row in sorted(rows, key=lambda row: order.get(row["quantity"], len(order))):
        if not row["method"]:
            if row["note"] != NO_NUMBER:
                found.problems[run.run_key] = _said(run, row["note"])
            continue
        told = {name: row[name] for name in NAMES}
        known = {name: math.nan if told[name] is None else told[name] for name in ("value", "error", "n_effective")}
        found.measured[run.run_key][row["quantity"]] = Measured(**{**told, **known})
