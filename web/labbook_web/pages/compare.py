"""Studies, points or runs side by side: in what they differ, their curves in one chart, their numbers, two viewers."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import pandas as pd

from labbook.export.recording import SIDE_BY_SIDE
from labbook.lab import RunRecord, Unreadable
from labbook.report.setting import differences
from labbook.results import display
from labbook.results.against import ratio_of
from labbook.results.points import PointResult
from labbook.stats import Pooled
from labbook.study import Point
from labbook_web.page import Page
from labbook_web.pages.curves import caption
from labbook_web.pages.point import curve_of, point_of
from labbook_web.pages.run import curve, key_of, point_of_run
from labbook_web.pages.sheet import leading
from labbook_web.pages.study import chart_data, verdicts
from labbook_web.store import BackendComparison, LabStore, NotFound, StudyContents

ITEM_LIMIT = 6
_ITEM = re.compile(r"(?P<kind>study|point|run):(?P<name>[A-Za-z][\w-]{0,79}|[0-9a-f]{4,64})(?::(?P<number>\d{1,6}))?"
                   r"(?:@(?P<backend>[\w-]{1,40}))?")  # fmt: skip


class Malformed(ValueError):
    """Error in the form of a request; the message has the right form."""


@dataclass(frozen=True, eq=False)
class ComparedItem:
    """A study, point or run of a comparison.

    Attributes:
        text: The item in the address, such as `run:4f0c`.
        label: Title of its column.
        address: Path of its page.
        point: Its point; None of a study.
        result: Results of the point; None of a study or a run.
        contents: Its study with all results; None of a run.
        curves: W(t) of its runs [SI].
        run: Key of the run whose bed is shown; None of a study.
        recorded: The run has frames.
        backend: Backend of its runs.
    """

    text: str
    label: str
    address: str
    point: Point | None
    result: PointResult | None
    contents: StudyContents | None
    curves: Sequence[Mapping[str, Any]]
    run: str | None
    recorded: bool
    backend: str


def compare_page(store: LabStore, items: Sequence[str]) -> Page:
    """Compare studies, points or runs.

    Args:
        store: Studies and their results.
        items: `run:KEY`, `point:STUDY:3` or `study:STUDY`, the last two also with `@BACKEND`.

    Raises:
        Malformed: An item of another form, or too many.
        NotFound: A study, point or run that the lab lacks.
    """
    if len(items) > ITEM_LIMIT:
        raise Malformed(f"{len(items)} items are too many to compare; choose at most {ITEM_LIMIT}")
    lacking: list[str] = []
    entries = _with_backends([_item(store, text, lacking) for text in dict.fromkeys(items)])
    labels = [item.label for item in entries]
    pairs = _differences(entries)
    curves = [{**curve, "title": item.label, "group": index,
               "label": f"{item.label}: {curve['label']}" if len(item.curves) > 1 else item.label}
              for index, item in enumerate(entries) for curve in item.curves]  # fmt: skip
    beds = [item for item in entries if item.run]
    recorded = list(dict.fromkeys(item.run[:16] for item in beds if item.run and item.recorded))[:SIDE_BY_SIDE]
    studies = bool(entries) and all(item.point is None and item.contents is not None for item in entries)
    numbers = _means(entries) if studies else _numbers(entries)
    return Page(
        "compare.html.j2",
        "compare",
        "Compare",
        lambda: {"items": [item.text for item in entries], "labels": labels, "differences": pairs, "numbers": numbers},
        lambda: pd.DataFrame(
            [{"key": name, **dict(zip(labels, values, strict=True))} for name, values in pairs]
            + [{"key": row["name"], **dict(zip(labels, row["values"], strict=True))} for row in numbers]
        ),
        {"items": entries, "compared": verdicts(_comparisons(entries)),
         "differences": pairs, "numbers": numbers, "lacking": lacking, "caption": caption(curves),
         "beds": beds, "together": len(recorded), "most": SIDE_BY_SIDE,
         "beside": f"/{'beside' if len(recorded) > 1 else 'run'}/{'-'.join(recorded)}/viewer" if recorded else "",
         "apart": studies and len(entries) > 1 and not numbers,
         "studies": [listing.name for listing in store.listings() if listing.path is not None]},
        {
            "curves": curves,
            "studies": [{**chart_data(item.contents.results), "label": item.label}
                        for item in entries if item.contents is not None and item.result is None],
        },
    )  # fmt: skip


def _comparisons(items: Sequence[ComparedItem]) -> list[BackendComparison]:
    """Stored comparisons of two backends of one study that both are among the items."""
    backends: dict[str, set[str]] = {}
    for item in items:
        if item.contents is not None:
            backends.setdefault(item.contents.study.name, set()).add(item.backend)
    comparisons = {
        (one.study.name, one.name): one for item in items if item.contents for one in item.contents.comparisons
    }
    return [
        comparison
        for comparison in comparisons.values()
        if {entrant.name for entrant in comparison.verdict.entrants} <= backends[comparison.study.name]
    ]


def _with_backends(items: list[ComparedItem]) -> list[ComparedItem]:
    """Add the backend to the labels if there are several backends."""
    if len({item.backend for item in items}) < 2:
        return items
    return [replace(item, label=f"{item.label} on {item.backend}") for item in items]


def _item(store: LabStore, text: str, lacking: list[str]) -> ComparedItem:
    item = _ITEM.fullmatch(text)
    if item is None or (item["kind"] == "point") != (item["number"] is not None):
        raise Malformed(f"{text[:80]} is not an item: use run:KEY, point:STUDY:NUMBER or study:STUDY")
    if item["kind"] == "run":
        return _run(store, text, item["name"], lacking)
    contents = store.contents(item["name"], store.backend_of(item["name"], item["backend"]))
    name = contents.study.name
    if item["kind"] == "study":
        return ComparedItem(text, name, f"study/{name}", None, None, contents, (), None, False, contents.backend)
    number = int(item["number"])
    result = point_of(contents, number)
    curves = [trace for run in result.runs if (trace := curve_of(run, run.repeat, lacking)) is not None]
    label, address = f"{name}, {result.label or 'the only point'}", f"study/{name}/point/{number}"
    sample = next((run for run in result.runs if run.recorded), result.runs[0])
    bed = sample.run_key, sample.recorded, contents.backend
    return ComparedItem(text, label, address, result.point, result, contents, curves, *bed)


def _run(store: LabStore, text: str, prefix: str, lacking: list[str]) -> ComparedItem:
    key = key_of(store, prefix)
    folder, entry = store.lab.run(key), store.catalogue.entries([key])[0]
    try:
        record = RunRecord.read(folder)
    except Unreadable as problem:
        raise NotFound(f"the run {key[:10]} cannot be read: {problem}") from problem
    curves, why = curve(folder, entry, record)
    lacking += why
    label = f"{record.study}, {record.label}, {record.repeat}"
    bed = key, record.coverage.recording is not None, record.backend
    return ComparedItem(text, label, f"run/{key[:16]}", point_of_run(record), None, None, curves, *bed)


def _differences(items: Sequence[ComparedItem]) -> list[tuple[str, tuple[str, ...]]]:
    """Find the settings in which items differ; of studies, the keys of their files."""
    if len(items) < 2:
        return []
    points = [item.point for item in items]
    if all(point is not None for point in points):
        rows = differences([point for point in points if point is not None])
        backends = tuple(item.backend for item in items)
        return rows + ([("backend", backends)] if len(set(backends)) > 1 else [])
    definitions = [_flat(item.contents.study.definition) if item.contents else {} for item in items]
    names = dict.fromkeys(name for definition in definitions for name in definition)
    backends = tuple(item.backend for item in items)
    return [("backend", backends)] * (len(set(backends)) > 1) + [
        (name, tuple(_words(definition.get(name, "–")) for definition in definitions))
        for name in names
        if name != "name" and len({str(definition.get(name)) for definition in definitions}) > 1
    ]


def _words(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def _numbers(items: Sequence[ComparedItem]) -> list[dict[str, Any]]:
    """Means of points, and their ratios to the first with 95 % intervals."""
    results = [item.result for item in items]
    names = dict.fromkeys(name for result in results if result is not None for name in result.pooled)
    return _numbers_of(results, tuple(names))


def _numbers_of(results: Sequence[PointResult | None], names: Sequence[str]) -> list[dict[str, Any]]:
    rows = []
    for name in names:
        measured = (run.measured for result in results if result is not None for run in result.runs)
        unit = next((of_run[name].unit for of_run in measured if name in of_run), "")
        notation = display.quantity(name, unit)
        pooled = [result.pooled.get(name) if result is not None else None for result in results]
        values = ["–" if one is None else f"{display.with_error(one.value, one.error, notation.scale)} (n = {one.n})"
                  for one in pooled]  # fmt: skip
        first = results[0]
        zero = notation.about_zero or first is None or name not in first.pooled or _about_zero(first.pooled[name])
        ratios = ["–" if zero or first is None else _ratio(result, first, name) for result in results[1:]]
        rows.append({"name": notation.heading, "values": values, "ratios": ratios})
    return rows


def _means(items: Sequence[ComparedItem]) -> list[dict[str, Any]]:
    """Means of the leading quantity of studies or backends at points with the same settings, and their ratios to the
    first, as `_numbers` gives them of points."""
    studies = [item.contents.results for item in items if item.contents is not None]
    quantity = next(filter(None, map(leading, studies)), "")
    if not quantity:
        return []
    points = [{tuple(sorted(result.at.items())): result for result in results.points} for results in studies]
    rows = []
    for at, first in points[0].items():
        results = [each.get(at) for each in points]
        if sum(result is not None for result in results) < 2:
            continue
        (row,) = _numbers_of(results, (quantity,))
        rows.append({**row, "name": f"{row['name']} at {first.label}" if first.label else row["name"]})
    return rows


def _about_zero(mean: Pooled) -> bool:
    """True if the interval of a mean contains zero, so that it has no ratios."""
    return mean.value == 0 or mean.low <= 0 <= mean.high


def _ratio(result: PointResult | None, first: PointResult | None, name: str) -> str:
    if result is None or first is None or name not in result.pooled or name not in first.pooled:
        return "–"
    ratio, pairs = ratio_of(result, first, name)
    ends = " to ".join(display.number(end, ratio.error) for end in (ratio.low, ratio.high))
    pairing = f"{pairs} pairs" if pairs else "independent runs"
    return f"{display.with_error(ratio.value, ratio.error)} ({ends}; {pairing})"


def _flat(definition: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name, value in definition.items():
        values |= _flat(value, f"{prefix}{name}.") if isinstance(value, Mapping) else {f"{prefix}{name}": value}
    return values
