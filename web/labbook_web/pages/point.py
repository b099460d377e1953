"""The page of a point of a study: its runs side by side, and their W(t)."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from labbook.lab import Unreadable
from labbook.lab.evaluations import NotEvaluated
from labbook.results import display
from labbook.results.frames import frames
from labbook.results.points import PointResult, RunResult
from labbook_web.page import Page
from labbook_web.pages.curves import caption, curve
from labbook_web.pages.sheet import with_unit
from labbook_web.store import LabStore, NotFound, StudyContents


def point_page(store: LabStore, name: str, number: int, query: Mapping[str, str]) -> Page:
    """Make the page of a point of a study on one backend.

    Args:
        store: Studies and their results.
        name: Name of the study.
        number: Number of the point, from 1.
        query: `backend`: name of the backend; without it the one with most runs.

    Raises:
        NotFound: No such study, point or backend, or no finished run of the point.
    """
    contents = store.contents(name, store.backend_of(name, query.get("backend")))
    result = point_of(contents, number)
    last = len(contents.study.points)
    lacking: list[str] = []
    curves = [trace for run in result.runs if (trace := curve_of(run, run.repeat, lacking)) is not None]
    pooled = _pooled(result, curves)

    def table() -> pd.DataFrame:
        rows = frames(contents.results, ("runs",)).get("runs", pd.DataFrame())
        return rows.loc[rows["point"] == number] if len(rows) else rows

    return Page(
        "point.html.j2",
        f"study/{name}/point/{number}",
        f"{name}, {result.label or 'the only point'}",
        lambda: {"study": name, "backend": contents.backend, "point": number, "at": dict(result.at),
                 "label": result.label, "runs": table().to_dict(orient="records")},
        table,
        {"contents": contents, "result": result, "number": number, "last": last, "runs": run_rows(result),
         "lacking": lacking, "caption": caption(curves), "quantities": quantities(result), "pooled": pooled},
        {"curves": curves, "pooled": pooled},
        {"backend": query["backend"]} if "backend" in query else {},
    )  # fmt: skip


def _pooled(result: PointResult, curves: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Pooled flow rate with its interval [SI], and the window [s], the mean over runs; None without a mean."""
    windows = [curve["window"] for curve in curves if curve["window"]]
    if result.flow_rate is None or not windows:
        return None
    flow = result.flow_rate
    return {
        "mean": [flow.value, flow.low, flow.high],
        "window": [sum(ends) / len(windows) for ends in zip(*windows, strict=True)],
        "text": with_unit(flow, display.quantity("flow_rate")),
    }


def point_of(contents: StudyContents, number: int) -> PointResult:
    """Find a point with its runs by its number, from 1. Raises NotFound."""
    for result in contents.results.points:
        if result.point.index + 1 == number:
            return result
    if 1 <= number <= len(contents.study.points):
        label = contents.study.points[number - 1].label
        raise NotFound(f"no run of point {number} ({label}) is finished on {contents.backend}")
    raise NotFound(f"{contents.study.name} has {len(contents.study.points)} points, not a point {number}")


def quantities(result: PointResult) -> list[tuple[str, str, str, int]]:
    """Rows of the table of means: name with unit, mean with error, 95 % interval, number of runs."""
    rows = []
    for name, pooled in result.pooled.items():
        unit = next(run.measured[name].unit for run in result.runs if name in run.measured)
        notation = display.quantity(name, unit)
        ends = (display.number(end, pooled.error, notation.scale) for end in (pooled.low, pooled.high))
        value = display.with_error(pooled.value, pooled.error, notation.scale)
        rows.append((notation.heading, value, " to ".join(ends) if pooled.n > 1 else "one run", pooled.n))
    return rows


def run_rows(result: PointResult) -> list[dict[str, Any]]:
    """Rows of the table of runs: the run, its flow rate with error [g/s], and notes."""
    rows = []
    for run in result.runs:
        flow = run.measured.get("flow_rate") or run.measured.get("flow_rate_flowing")
        notation = display.quantity("flow_rate")
        rows.append({
            "run": run,
            "flow": display.with_error(flow.value, flow.error, notation.scale) if flow is not None else "–",
            "note": "; ".join(filter(None, (flow.note if flow is not None else "", suspicion(run)))),
        })  # fmt: skip
    return rows


def suspicion(run: RunResult) -> str:
    """Reason why a run is suspect, and its exclusion from means; empty of other runs."""
    return f"suspect: {run.suspect}{'' if run.counted else '; left out of means'}" if run.suspect else ""


def curve_of(run: RunResult, label: str, lacking: list[str]) -> dict[str, Any] | None:
    """W(t) of a run with its window [SI]; None without any. The reason is appended to `lacking`."""
    try:
        trace = run.trace
    except (NotEvaluated, Unreadable) as problem:
        lacking.append(str(problem))
        return None
    if trace is None:
        return None
    flowing = run.measured.get("flow_rate_flowing")
    return curve(trace, run.measured.get("flow_rate"), label, flowing.note if flowing else "", run=run.run_key)
