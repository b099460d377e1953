"""Rows of the index from what was evaluated of a run."""

import math
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

from labbook.lab.evaluations import Evaluated, evaluated
from labbook.lab.records import Observe
from labbook.measure import MEASURES, Measure, RunData, Window
from labbook.stats import Measured

NO_NUMBER = "the run gives no number"
"""Note in the row of a measure that could be taken, and gave no number."""
NAMES = tuple(field.name for field in fields(Measured))


def wanted(observe: Observe) -> list[Measure]:
    """The measures that it names, as far as they are known."""
    return [MEASURES[name] for name in dict.fromkeys(observe.measure) if name in MEASURES]


def expected(observe: Observe) -> set[tuple[str, int, float, float]]:
    """(measure, version, window) of what should have been measured."""
    return {(measure.name, measure.version, observe.start, observe.end) for measure in wanted(observe)}


def derive(folder: Path, observe: Observe, data: Callable[[], RunData]) -> list[dict[str, Any]]:
    """Rows for the table of measurements of the run in `folder`: of what is kept beside it, or else evaluated now.

    A measure that cannot be taken of this run, or that fails on it, leaves a row with its own name, no value, and the
    reason as note. One that lacks a package leaves none, and is tried again. Raises what `data` raises.
    """
    rows = []
    for measure in wanted(observe):
        try:
            rows += rows_of(folder.name, measure, observe, evaluated(folder, measure, observe, data))
        except ImportError:
            continue
    return rows


def rows_of(run_key: str, measure: Measure, window: Window, found: Evaluated) -> list[dict[str, Any]]:
    """Rows for the table of measurements of what a measure gave of a run. SQL has no NaN: it becomes NULL."""
    shared = {
        "run_key": run_key,
        "version": measure.version,
        "window_start": window.start,
        "window_end": window.end,
        "measure": measure.name,
    }
    numbers = (vars(one) for one in found.evaluation.numbers)
    rows = [{**shared, **{name: _finite(value) for name, value in one.items()}} for one in numbers]
    nothing = dict.fromkeys(NAMES) | {"quantity": measure.name, "window": "", "method": "", "unit": ""}
    return rows or [{**shared, **nothing, "note": found.problem or NO_NUMBER}]


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
