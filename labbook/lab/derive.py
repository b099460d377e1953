"""Numbers from finished runs: measured once, kept in the index, measured again when a measure or window
changes."""

import math
from typing import Any

from labbook.lab.records import Observe, RunRecord
from labbook.measure import MEASURES, MeasureError, RunData


def expected(observe: Observe) -> set[tuple[str, int, float, float]]:
    """(measure, version, window) of what should have been measured."""
    known = (MEASURES[name] for name in observe.measure if name in MEASURES)
    return {(measure.name, measure.version, observe.start, observe.end) for measure in known}


def derive(record: RunRecord, data: RunData, observe: Observe) -> list[dict[str, Any]]:
    """Rows for the table of measurements, from a run.

    A measure that cannot be taken of this run, or that fails on it, leaves a row with its own name, no value, and the
    reason as note.
    """
    rows = []
    for name, version, start, end in sorted(expected(observe)):
        shared = {
            "run_key": record.run_key,
            "version": version,
            "window_start": start,
            "window_end": end,
            "measure": name,
        }
        try:
            measured = MEASURES[name].evaluate(data, observe)
        except (ValueError, ArithmeticError, LookupError, TypeError) as error:  # one odd run must not stop the others
            why = str(error) if isinstance(error, MeasureError) else f"it fails: {type(error).__name__}: {error}"
            rows.append({**shared, **_nothing(name, why)})
            continue
        rows += [{**shared, **_numbers(vars(one))} for one in measured]
        if not measured:
            rows.append({**shared, **_nothing(name, "the run gives no number")})
    return rows


def _numbers(values: dict[str, Any]) -> dict[str, Any]:
    """SQL has no NaN: what is not finite becomes NULL."""
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value for key, value in values.items()
    }


def _nothing(name: str, note: str) -> dict[str, Any]:
    return {
        "quantity": name,
        "value": None,
        "error": None,
        "n_effective": None,
        "window": "",
        "method": "",
        "unit": "",
        "note": note,
    }
