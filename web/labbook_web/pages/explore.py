"""The page of the response surface of a study: a quantity over all swept keys, by sliders, and its inverse."""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import pandas as pd

from labbook.commands import command
from labbook.report.explored import influence_table, next_table, runs_and_time
from labbook.report.result_box import no_number
from labbook.results import display
from labbook.results.explore import DesignSurface, Factor, explore, swept_keys
from labbook.results.points import FLOW_RATE, PointResult
from labbook.results.study import StudyResults
from labbook.results.surface import NoSurface
from labbook.scene.quantities import parse
from labbook.study import Study
from labbook.study.proposed import study_at
from labbook_web.page import Page
from labbook_web.pages.sheet import leading, unit_of
from labbook_web.store import LabStore, NotFound, StudyContents

_QUANTITIES, _CHOICES = 4, 12
"""Quantities, and values of keys that take words, of which a page has surfaces."""


def explorable(study: Study) -> bool:
    """Decide if a study has a page to explore: it sweeps a key of numbers."""
    return bool(swept_keys(study.points)[0])


def explore_page(store: LabStore, name: str, query: Mapping[str, str]) -> Page:
    """Make the page of a study on one backend. Raises NotFound for a study that sweeps no key of numbers."""
    contents = store.contents(name, store.backend_of(name, query.get("backend")))
    if not explorable(contents.study):
        raise NotFound(f"{name} sweeps no key of numbers: there is nothing to explore")
    views = contents.cached("explored", lambda: _views(contents))
    numbers = [view["numbers"] for view in views]
    return Page(
        "explore.html.j2",
        f"study/{name}/explore",
        f"Explore {name}",
        lambda: {"study": name, "backend": contents.backend, "views": numbers},
        lambda: _frame(views),
        {"contents": contents, "views": views, "named": f"{name}-design", "command": command},
        {"study": name, "views": numbers},
        {"backend": query["backend"]} if "backend" in query else {},
    )


def _views(contents: StudyContents) -> list[dict[str, Any]]:
    """Surfaces of the quantities at each value of the keys that take words: data of the charts, and tables."""
    results = contents.results
    _, fixed = swept_keys(results.points)
    varied = [name for name in fixed if len({result.at.get(name) for result in results.points}) > 1]
    values = [list(dict.fromkeys(one.at[name] for one in results.points if name in one.at)) for name in varied]
    choices = [dict(zip(varied, choice, strict=True)) for choice in product(*values)][:_CHOICES]
    names = dict.fromkeys(name for result in results.points for name in result.pooled)
    names = sorted(names, key=lambda name: name != FLOW_RATE)
    views: list[dict[str, Any]] = []
    problems: list[dict[str, Any]] = []
    for at in choices:
        count = 0
        for quantity in names:
            if count == _QUANTITIES:
                break
            try:
                surface = explore(results, quantity, at)
            except (LookupError, NoSurface) as problem:
                problems.append(_without(results, quantity, at, f"{problem.args[0]}."))
                continue
            count += 1
            views.append(_view(surface, label=display.label(at)))
    return (
        views or problems[:1] or [_without(results, FLOW_RATE, {}, no_number(results) or "No run gave a number yet.")]
    )


def map_view(results: StudyResults, surface: DesignSurface | None) -> dict[str, Any] | None:
    """Data of the map of the leading quantity over two swept keys.

    Args:
        results: Results of a study.
        surface: As `surface_of` gives it; None if the points do not determine it.

    Returns:
        The view, without a surface only its points; None of a study that does not sweep exactly two keys of numbers,
        or has no number.
    """
    keys, choices = swept_keys(results.points)
    quantity = leading(results)
    if len(keys) != 2 or not quantity or any(len({one.at.get(name) for one in results.points}) > 1 for name in choices):
        return None
    try:
        if surface is None or surface.quantity != quantity:
            surface = explore(results, quantity)
        view = _view(surface, "")["numbers"]
    except (LookupError, NoSurface) as problem:
        view = _without(results, quantity, {}, f"{problem.args[0]}.")["numbers"]
    return {name: view[name] for name in _MAPPED if name in view}


_MAPPED = ("label", "quantity", "why", "method", "factors", "surface", "points")
"""Parts of a view that a map is drawn of."""


def _without(results: StudyResults, quantity: str, at: Mapping[str, float | str], why: str) -> dict[str, Any]:
    """A view without a surface: the points, and the reason."""
    notation = unit_of(results, quantity)
    keys = swept_keys(results.points)[0]
    complete = [result for result in results.points if all(key in result.at for key in keys)]
    factors = [Factor.of(key, [float(result.at[key]) for result in complete]) for key in keys]
    numbers = {
        "label": notation.heading,
        "quantity": {"name": quantity, "label": notation.name, "unit": notation.unit, "scale": notation.scale},
        "why": why,
        "factors": [_factor(factor, complete, results.study) for factor in factors],
        "points": [_point(result, quantity, keys, used=quantity in result.pooled) for result in complete],
    }
    return {"numbers": numbers, "surface": None, "why": why, "label": display.label(at)}


def _view(surface: DesignSurface, label: str) -> dict[str, Any]:
    notation = display.quantity(surface.quantity, surface.unit)
    first = {**surface.at, **{factor.key: factor.low for factor in surface.factors}}
    study = surface.results.study
    head, _ = study_at(study, [first], f"{study.name}-design", max(2, study.replicates))
    numbers = {
        "label": f"{notation.heading}{f', {label}' if label else ''}",
        "quantity": {"name": surface.quantity, "label": notation.name, "unit": notation.unit, "scale": notation.scale},
        "at": dict(surface.at),
        "why": "",
        "method": surface.method,
        "factors": [_factor(factor, (*surface.points, *surface.left_out), study) for factor in surface.factors],
        "surface": surface.numbers(),
        "points": [
            _point(result, surface.quantity, surface.keys, used=result in surface.points)
            for result in (*surface.points, *surface.left_out)
            if all(key in result.at for key in surface.keys)
        ],
        "influences": [vars(influence) for influence in surface.influences],
        "next": [{**vars(run), "per_second": run.per_second} for run in surface.next_runs],
        "study": head,
    }
    return {
        "numbers": numbers,
        "surface": surface,
        "why": "",
        "label": label,
        "matters": influence_table(surface),
        "bars": bars(surface),
        "remarks": f"{len(surface.notes)} point{' has' if len(surface.notes) == 1 else 's have'} a remark",
        "next": next_table(surface),
        "cost": runs_and_time(surface.next_runs),
    }


def bars(surface: DesignSurface) -> list[dict[str, Any]]:
    """Rows of the influences: name of each key, its share of the variance, and the change over its range in words."""
    quantity, ranges = display.quantity(surface.quantity, surface.unit).name, {one.key: one for one in surface.factors}
    rows = []
    for row, influence in zip(influence_table(surface).rows, surface.influences, strict=True):
        change = ""
        if influence.key:
            low, high = (
                display.amount(influence.key, end) for end in (ranges[influence.key].low, ranges[influence.key].high)
            )
            change = f"{quantity}: {row[-1]} from {low} to {high} {display.key(influence.key).unit}".rstrip()
        rows.append({"name": row[0], "share": row[1] if len(row) > 2 else "", "change": change, "influence": influence})
    return rows


def _factor(factor: Factor, points: Sequence[PointResult], study: Study) -> dict[str, Any]:
    """Data of a swept key for the sliders [SI], with its unit in study files."""
    notation = display.key(factor.key)
    values = sorted({float(result.at[factor.key]) for result in points if factor.key in result.at})
    try:
        unit = notation.unit if not notation.unit or parse(f"1 {notation.unit}", None) else ""
        scale = notation.scale
    except ValueError:  # a unit that is shown by a sign of its own
        unit, scale = study.units.get(factor.key, ""), 1.0
    return {
        "key": factor.key,
        "label": notation.name,
        "spoken": display.spoken(factor.key),
        "unit": notation.unit,
        "scale": notation.scale,
        "low": factor.low,
        "high": factor.high,
        "logarithmic": factor.logarithmic,
        "values": values,
        "yaml": {"unit": unit, "scale": scale},
    }


def _point(result: PointResult, quantity: str, keys: Sequence[str], *, used: bool) -> dict[str, Any]:
    pooled = result.pooled.get(quantity)
    clogged = result.outcomes["clogged"]
    return {
        "n": result.point.index + 1,
        "at": [result.at.get(key) for key in keys],
        "label": result.label,
        "value": None if pooled is None else [pooled.value, pooled.low, pooled.high, pooled.n],
        "used": used,
        "clogged": f"{clogged} of {len(result.runs)} clogged" if clogged else "",
    }


def _frame(views: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Table of the CSV twin: each point with its keys, its mean and the surface, with their intervals [SI]."""
    rows = []
    for view in views:
        surface: DesignSurface | None = view["surface"]
        if surface is None:
            continue
        for result in surface.points:
            pooled = result.pooled[surface.quantity]
            value, low, high = surface.predict({key: result.at[key] for key in surface.keys})
            rows.append({
                "quantity": surface.quantity, "unit": surface.unit, "point": result.point.index + 1, **result.at,
                "mean": pooled.value, "low": pooled.low, "high": pooled.high,
                "surface": value, "surface_low": low, "surface_high": high,
            })  # fmt: skip
    frame = pd.DataFrame(rows)
    frame.attrs["units"] = views[0]["surface"].results.study.units if rows else {}
    return frame
