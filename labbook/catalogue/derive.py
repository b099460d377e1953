"""Numbers from finished runs: measured once, kept in the index, measured again when a measure or window
changes."""

import math
from pathlib import Path
from typing import Any

from labbook.catalogue.finished import run_data
from labbook.catalogue.record import Observe, RunRecord
from labbook.measure import MEASURES, MeasureError


def expected(observe: Observe) -> set[tuple[str, int, float, float]]:
    """(measure, version, window) of what should have been measured."""
    known = (MEASURES[name] for name in observe.measure if name in MEASURES)
    return {(measure.name, measure.version, observe.start, observe.end) for measure in known}


def derive(folder: Path, record: RunRecord, observe: Observe) -> list[dict[str, Any]]:
    """Rows for the table of measurements, from the run in `folder`. Raises Unreadable.

    A measure that cannot be taken of this run leaves a row with its own name, no value, and the reason as
    note.
    """
    data = run_data(folder, record)
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
        except MeasureError as error:
            rows.append({**shared, **_nothing(name, str(error))})
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
