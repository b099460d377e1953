"""The page of a study: its result, a chart of what was measured against what was swept, tables, figures, its file."""

import json
import re
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from labbook.api import Results
from labbook.checks.compare import shown
from labbook.commands import command
from labbook.fit import Law
from labbook.lab.evaluations import NotEvaluated
from labbook.measure import MeasureError
from labbook.plugins import ExtensionError
from labbook.report import gallery, style, tables
from labbook.report.blocks import Facts, slug
from labbook.report.fitted_tables import fit_table
from labbook.report.paper import Draw, Drawing
from labbook.report.result_box import headline, no_number, result_box
from labbook.report.sections import series_of_points
from labbook.report.setting import setting
from labbook.report.statement_tables import statement_digest, statement_table
from labbook.report.tables import Table
from labbook.results import display
from labbook.results.explore import DesignSurface
from labbook.results.frames import frames, to_json
from labbook.results.points import ORIFICE, PointResult, followers, names_scene
from labbook.results.reference import at_series
from labbook.results.series import Series
from labbook_web.page import Page, embedded, with_units
from labbook_web.pages.changes import changes, latest, moment
from labbook_web.pages.explore import explorable, map_view
from labbook_web.pages.lab import outcomes, progress
from labbook_web.pages.sheet import sheet
from labbook_web.pages.tiles import Tiles, surface_of, tiles
from labbook_web.render import meaning
from labbook_web.store import BackendComparison, LabStore, NotFound, StudyContents

if TYPE_CHECKING:
    import pandas as pd


def study_page(store: LabStore, name: str, query: Mapping[str, str]) -> Page:
    """Make the page of a study on one backend.

    Args:
        store: Studies and their results.
        name: Name of the study.
        query: `backend`: its name, without it the one with most runs; `as`: state at the time of a permalink; `since`:
            date after which runs count as new.

    Raises:
        NotFound: No such study or backend.
        StudyError: An invalid study.
        NoMoment: A malformed date.
    """
    backend = store.backend_of(name, query.get("backend"))
    processes = store.running()  # before the results: a page that follows nobody has all runs
    contents = store.contents(name, backend)
    results, study = contents.results, contents.study
    path = f"study/{name}"
    parameters = {"backend": query["backend"]} if "backend" in query else {}
    linked = query.get("as")
    now = progress(contents, processes)
    lacking = bool(now["running"]) and now["done"] < now["asked"]
    labels = [job.label for process in now["running"] for job in process["jobs"]]
    return Page(
        "study.html.j2",
        path,
        name,
        lambda: {
            "study": name,
            "about": study.about,
            "backend": backend,
            "state": contents.state,
            "headline": headline(results),
            **json.loads(to_json(results)),
        },
        results.frame,
        {
            **contents.cached("study", lambda: _context(contents)),
            "tiles": contents.cached(f"tiles of {now}", lambda: tiles(results, now, _surface(contents)))
            if results.points
            else None,
            "sheet": sheet(results, labels) if labels else contents.cached("sheet", lambda: sheet(results)),
            "contents": contents,
            "backends": sorted(
                {backend, *next((entry.backends for entry in store.listings() if entry.name == name), ())}
            ),
            "progress": now,
            "note": store.note("study", name),
            "linked": linked,
            "changes": changes(results, moment(query["since"])) if query.get("since") else None,
            "latest": contents.cached("latest", lambda: latest(results)),
            "outdated": linked is not None and linked != contents.state,
            "command": command("run", study.path, lab=store.lab.folder, backend=backend),
        },
        contents.cached(
            f"chart_data of {lacking}", lambda: embedded({**chart_data(results, lacking), "map": _map(contents)})
        ),
        parameters,
    )


def _context(contents: StudyContents) -> dict[str, Any]:
    """Context of the template that depends only on the results: tables and texts."""
    results = contents.results
    return {
        "results": results,
        "box": result_box(results) if results.points else None,
        "nothing": no_number(results),
        "constants": _constants(results),
        "outcomes": outcomes(results),
        "flow": tables.flow_table(results) if results.points else None,
        "further": tables.further_table(results),
        "flowing": tables.flowing_table(results),
        "clogged_title": tables.CLOGGED,
        "fits": _fits(results),
        "comparisons": tables.comparison_table(results.comparisons) if results.comparisons else None,
        "comparisons_digest": tables.digest_table(results.comparisons),
        "statements": statement_table(results.judged) if results.judged else None,
        "statements_digest": statement_digest(results.judged) if results.judged else None,
        "numerics": tables.numerical_table(results.numerical) if results.numerical else None,
        "figures": figures(contents),
        "printed": {address: drawings(contents)[address][0] for address in _charted(contents)},
        "kinds": style.FORMATS,
        "compared": verdicts(contents.comparisons),
        "copied": copied(contents.text, contents.study.name),
        "explorable": explorable(results.study),
        "mapped": _map(contents),
        "parallel": len({name for result in results.points for name in result.at}) > 1,
    }


def _map(contents: StudyContents) -> dict[str, Any] | None:
    """Data of the map of two swept keys for `static/map.js`; None of other studies."""
    return contents.cached("map", lambda: map_view(contents.results, _surface(contents)))


def _tiles(contents: StudyContents, now: Mapping[str, Any]) -> Tiles | None:
    return tiles(contents.results, now, _surface(contents)) if contents.results.points else None


def _surface(contents: StudyContents) -> DesignSurface | None:
    return contents.cached("surface", lambda: surface_of(contents.results))


def _fits(results: Results) -> list[tuple[str, str, Law, Table]]:
    """Fitted laws: label of the series, name of the law, the law, and the table of its parameters."""
    return [
        (series.label, law, fit.law, fit_table(law, fit, at_series(results.comparisons, law, series), results.source))
        for series in results.series
        for law, fit in series.fits.items()
    ]


def verdicts(comparisons: Sequence[BackendComparison]) -> list[dict[str, Any]]:
    """Comparisons of backends for the template: sentences, means, figure, and a flag for a recording."""
    return [
        {
            "name": comparison.name,
            "title": " and ".join(entrant.called for entrant in comparison.verdict.entrants),
            "made": comparison.verdict.made,
            "stale": comparison.stale,
            "sentences": shown.summary(comparison.verdict),
            "table": shown.contrast_table(comparison.verdict),
            "study": comparison.study.name,
            "recorded": comparison.recording is not None,
            "figure": f"compare-{slug(comparison.name)}",
        }
        for comparison in comparisons
    ]


def figures(contents: StudyContents) -> dict[str, str]:
    """Titles by address of the figures of the report and of comparisons of backends, without those in the chart."""
    return {address: title for address, (title, _) in drawings(contents).items() if address not in _charted(contents)}


def _charted(contents: StudyContents) -> list[str]:
    """Addresses of figures that repeat the chart of the page; they are linked below it for print."""
    return [address for address in ("overview", "flow-rate", "map") if address in drawings(contents)]


_PANEL_LIMIT = 48
"""Largest number of panels of a figure with one for each point; beyond it each series has its own figure."""


def drawings(contents: StudyContents) -> dict[str, tuple[str, Draw]]:
    """Title and drawing of each figure, by address."""
    return contents.cached("drawings", lambda: _drawings(contents))


def _drawings(contents: StudyContents) -> dict[str, tuple[str, Draw]]:
    results = contents.results
    entries: dict[str, tuple[str, Draw]] = {
        f"compare-{slug(comparison.name)}": (
            f"Backends {' and '.join(entrant.called for entrant in comparison.verdict.entrants)}",
            partial(shown.figure, comparison.verdict),
        )
        for comparison in contents.comparisons
    }
    panels: set[str] = set()
    with suppress(NotEvaluated):
        for name, draw in gallery.of_results(results).items():
            entries[slug(name)] = _title(name), draw
        if 0 < len(results.points) <= _PANEL_LIMIT:
            for name, draw in gallery.of_points(series_of_points(results.points)).items():
                panels.add(name)
                entries[slug(name)] = _title(name), draw
    for number, series in enumerate(results.series, 1):
        label = f", {series.label}" if series.label else ""
        try:
            own = gallery.of_series(results, series)
        except NotEvaluated:
            continue
        for name, draw in own.items():
            if name not in panels:
                address = slug(name) + (f"-{number}" if len(results.series) > 1 else "")
                entries[address] = _title(name) + label, draw
    return entries


def draw(contents: StudyContents, address: str) -> "tuple[str, Draw]":
    """Find the title and the drawing of a figure. Raises NotFound."""
    entries = drawings(contents)
    if address not in entries:
        raise NotFound(f"{contents.study.name} has no figure {address}; it has: {', '.join(entries) or 'none'}")
    return entries[address]


def picture(store: LabStore, contents: StudyContents, address: str, kind: str = "svg") -> bytes:
    """Encode a figure, cached until its contents change.

    Args:
        store: Store with the cache.
        contents: Study of the figure.
        address: Address of the figure.
        kind: Format, of `style.FORMATS`.

    Raises:
        NotFound: No such figure.
        CANNOT_DRAW: Results that lack something.
    """

    def make() -> bytes:
        return encoded(draw(contents, address)[1], kind)[0]

    return store.pictures.get((contents.study.name, contents.backend, address, kind), contents.state, make)


def caption(contents: StudyContents, address: str) -> str:
    """Caption of a figure; empty without one. Raises NotFound, and the errors of CANNOT_DRAW."""
    drawing = draw(contents, address)[1]
    return drawing.caption() if isinstance(drawing, Drawing) else ""


def numbers(contents: StudyContents, address: str) -> "pd.DataFrame | None":
    """Table of the numbers of a figure, units in the headings; None of a figure without one. Raises NotFound."""
    drawing = draw(contents, address)[1]
    if not isinstance(drawing, Drawing) or not drawing.table:
        return None
    if drawing.table == "points":
        return with_units(contents.results.frame())
    table = frames(contents.results, (drawing.table,)).get(drawing.table)
    return None if table is None else with_units(table)


def figure(contents: StudyContents, address: str, make: Callable[[], Any]) -> dict[str, Any]:
    """Context of the template of a figure: title, caption, table, or the reason why `make` fails. Raises NotFound."""
    title = draw(contents, address)[0]
    try:
        make()
        described = {"why": "", "caption": caption(contents, address), "table": numbers(contents, address) is not None}
    except CANNOT_DRAW as error:
        described = {"why": why_not(error, contents), "caption": "", "table": False}
    return {"address": address, "title": title, "kinds": style.FORMATS, **described}


def encoded(make: Draw, *kinds: str) -> tuple[bytes, ...]:
    """Draw a figure and encode it in formats of `style.FORMATS`."""
    with _drawing:
        drawing, files = make(), list[bytes]()
        for kind in kinds:
            files.append(style.encode(drawing, kind))
            drawing.set_layout_engine("none")  # laid out once: that takes as long as drawing
        return tuple(files)


_drawing = threading.Lock()  # matplotlib's settings are those of the whole process


def why_not(error: Exception, contents: StudyContents) -> str:
    """Reason why a figure cannot be drawn, and the remedy."""
    if isinstance(error, NotEvaluated):
        return f"Not drawn, since {error}: {command('report', contents.study.path.name)} evaluates it."
    return f"{str(error)[:1].upper()}{str(error)[1:]}."


CANNOT_DRAW = (NotEvaluated, LookupError, MeasureError, ImportError, ExtensionError)
"""Errors of drawing a figure of results that lack something."""


def _title(name: str) -> str:
    head, _, key = name.partition("against_")
    text = (
        f"W against {key.rpartition('-')[2]}" if not head and key else name.replace("_", " ").replace("-", " ").strip()
    )
    return text[:1].upper() + text[1:]


def _constants(results: Results) -> Facts:
    from datetime import UTC, datetime

    return setting(results, datetime.now(UTC).date())


def copied(text: str, name: str) -> str:
    """Text of a study under a new name, `a-3` after `a-2` and `a-2` after `a`, to start a new study from."""
    number = re.search(r"-(\d+)$", name)
    successor = f"{name[: number.start()]}-{int(number[1]) + 1}" if number else f"{name}-2"
    return re.sub(rf"^(name:\s*)(['\"]?){re.escape(name)}\2", rf"\g<1>{successor}", text, count=1, flags=re.MULTILINE)


# data of the charts


def chart_data(results: Results, lacking: bool = False) -> dict[str, Any]:
    """Data of the charts: points, fits and their bands [SI], with the factors to the displayed units.

    Args:
        results: Results of a study.
        lacking: Runs are in progress: fits are left out, as laws of few runs would be taken for results.
    """
    units = {
        name: next(run.measured[name].unit for run in result.runs if name in run.measured)
        for result in results.points
        for name in result.pooled
    }
    keys = dict.fromkeys(name for result in results.points for name in result.at)
    quantities = dict.fromkeys(name for result in results.points for name in result.pooled)
    return {
        "study": results.study.name,
        "keys": {name: _key_notation(name, results) for name in keys},
        "quantities": {name: _quantity_notation(name, units[name]) for name in quantities},
        "points": [_point(result) for result in results.points],
        "references": [
            {"quantity": comparison.quantity.rpartition(".")[2], "point": comparison.points[0].point.index + 1,
             "value": comparison.reference, "error": comparison.reference_error, "source": results.source}
            for comparison in results.comparisons if len(comparison.points) == 1
        ],
        "series": [] if lacking else [_series(series) for series in results.series if series.fits],
        "lacking": lacking,
        "source": results.source,
        "nothing": no_number(results),
        "outlet": next((series.outlet for series in results.series), ""),
    }  # fmt: skip


def _key_notation(name: str, results: Results) -> dict[str, Any]:
    notation = display.key(name)
    words = any(isinstance(result.at.get(name), str) for result in results.points)
    along = [display.key(key).name for key in followers(results.points, name) if names_scene(key)]
    label = f"{notation.name} (with {', '.join(along)})" if along else notation.name
    return {"label": label, "unit": notation.unit, "scale": notation.scale, "words": words, "orifice": name == ORIFICE}


def _quantity_notation(name: str, unit: str) -> dict[str, Any]:
    notation = display.quantity(name, unit)
    return {
        "label": notation.name,
        "unit": notation.unit,
        "scale": notation.scale,
        "meaning": meaning(notation.heading),
    }


def _point(result: PointResult) -> dict[str, Any]:
    outcomes = result.outcomes
    return {
        "n": result.point.index + 1,
        "at": dict(result.at),
        "label": result.label or "the only point",
        "runs": len(result.runs),
        "asked": result.requested,
        "remark": result.remark,
        "trending": result.trending,
        "clogged": outcomes["clogged"],
        "values": {name: [mean.value, mean.error, mean.low, mean.high, mean.n] for name, mean in result.pooled.items()},
        "said": {
            name: display.with_interval(mean, display.quantity(name).scale) for name, mean in result.pooled.items()
        },
    }


_PLACES = 80


def _series(series: Series) -> dict[str, Any]:
    laws = {}
    for law, fit in series.fits.items():
        D = np.linspace(fit.D.min(), fit.D.max(), _PLACES)
        value, low, high = fit.band(D)
        table, residuals = fit_table(law, fit), series.residuals(law)
        laws[law] = {
            "label": display.law(law),
            "parameters": ", ".join(f"{row[0]} = {row[1]}" for row in table.rows),
            "x": D,
            "value": value,
            "low": low,
            "high": high,
            "at": [residual.orifice for residual in residuals],
            "residuals": [100 * residual.value for residual in residuals],
            "half_widths": [100 * residual.half_width for residual in residuals],
            "errors": [100 * residual.error for residual in residuals],
        }
    return {"label": series.label, "at": dict(series.at), "points": [one.point.index + 1 for one in series.points],
            "laws": laws}  # fmt: skip
