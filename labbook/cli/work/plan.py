"""A plan as tables, or as JSON."""

import json
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import typer
from rich import box
from rich.markup import escape
from rich.table import Table

from labbook.api import Lab
from labbook.backend import BackendMissing, Unsupported
from labbook.cli.options import fail, read_study
from labbook.cli.screen import screen
from labbook.lab import NoCatalogue
from labbook.measure import MeasureError
from labbook.plan.advice import TooLarge
from labbook.plan.demand import Conflict
from labbook.plan.forecast import outline
from labbook.plan.plan import Forecast, Plan, PointPlan
from labbook.scene.quantities import percent, size

_ROWS, _LABELS = 30, 3
"""Rows of the table of steps, and points that are named in each."""
_RUNS = 500
"""Rows of the table of runs."""
_LARGE = 1e9
"""Memory of a run [bytes] from which on it is told."""


def plan(study: Path, lab: Path, backend: str, device: str, as_json: bool) -> None:
    """Print the runs that a study still needs, with the forecast and warnings."""
    definition = read_study(study)
    try:
        result = Lab(lab, backend, device).plan(definition)
    except (BackendMissing, NoCatalogue, Unsupported, Conflict, MeasureError, TooLarge) as problem:
        fail(problem)
    except ImportError as missing:
        fail(f"the backend {backend} cannot be loaded ({missing}); try: pip install 'labbook[{backend}]'")
    assert result.forecast is not None
    if as_json:
        document = {**plain(result, result.forecast), "warnings": list(result.warnings)}
        if result.pilot is not None and result.pilot.forecast is not None:
            document["pilot"] = plain(result.pilot, result.pilot.forecast)
        typer.echo(json.dumps(document, indent=2, allow_nan=False))
    else:
        _show(result)


def plain(plan: Plan, ahead: Forecast) -> dict[str, Any]:
    """The plan as plain values."""

    record = plan.study.record
    return {
        "study": plan.study.name,
        "backend": plan.backend.name,
        "counts": dict(plan.counts()),
        "runs": [
            {
                "point": item.demand.point.index + 1,
                "label": item.demand.point.label,
                "seed": item.demand.seed,
                "discharge": item.demand.discharge,
                "run_key": item.keys.run,
                "state": item.state,
                "reason": item.reason,
                "outcome": item.outcome,
                "packing_key": item.keys.packing,
                "packing": "there" if item.packed else "missing",
            }
            for item in plan.items
        ],
        "campaign": list(plan.campaign),
        "packings_missing": len(plan.fillings),
        "recorded": None
        if record is None
        else {
            "every_seconds": sorted({point.shared.frame_interval or 0.0 for point in plan.points}),
            "replicates": record.replicates,
        },
        "replicates": {"first": plan.rule.first, "cap": plan.rule.cap, "tolerance": plan.rule.tolerance},
        "discharges_per_bed": plan.study.discharges_per_bed,
        "shares": {line: list(labels) for line, labels in plan.shares.items()},
        "forecast": {
            "seconds": ahead.seconds,
            "disk_bytes": ahead.disk,
            "grain_steps": ahead.grain_steps,
            "grain_steps_per_second": ahead.speed,
            "lanes": ahead.lanes,
            "basis": ahead.basis,
            "compiling_seconds": ahead.compiling,
            "feature_sets": ahead.sets,
        },
        "points": [
            {"point": point.shared.point.index + 1, "label": point.shared.point.label, **asdict(outline(point.shared))}
            for point in plan.points
        ],
    }


def spans(seeds: Iterable[int]) -> str:
    """Whole numbers in few words: `1-3, 5` for 1, 2, 3 and 5."""
    ranges: list[list[int]] = []
    for seed in sorted(seeds):
        if ranges and seed == ranges[-1][-1] + 1:
            ranges[-1][1:] = [seed]
        else:
            ranges.append([seed])
    return ", ".join("-".join(map(str, span)) for span in ranges)


def _show(plan: Plan) -> None:

    console = screen(highlight=False)
    groups: dict[tuple[str, str, str], list[int]] = defaultdict(list)
    for item in plan.items:
        groups[item.demand.point.label, item.state, item.reason].append(item.demand.seed)
    table = Table(title=escape(plan.study.name), title_justify="left", box=box.SIMPLE_HEAD)
    for heading in ("point", "seeds", "state", "why"):
        table.add_column(heading, no_wrap=heading == "state", overflow="fold")
    colours = {"done": "green", "partial": "yellow", "stale": "yellow", "missing": "default"}
    for number, ((label, state, reason), seeds) in enumerate(groups.items()):
        if number == _RUNS:
            table.add_row(f"and {len(groups) - _RUNS} more (--json lists all)", "", "", "")
            break
        several = f" ({len(seeds)} runs)" if len(seeds) > len({*seeds}) else ""
        table.add_row(escape(label), spans({*seeds}) + several, f"[{colours[state]}]{state}[/]", escape(reason))
    console.print(table)
    console.print(_physics(plan))
    for line in plan.lines():
        console.print(line, markup=False, soft_wrap=True)
    largest = max(outline(point.shared).memory for point in plan.points)
    if plan.todo and largest > _LARGE:
        console.print(f"A run needs about {size(largest)} of memory", markup=False)


def _count(number: float) -> str:
    """A forecast of a number, to two figures."""
    return f"{float(f'{number:.2g}'):,.0f}".replace(",", " ")


def _size(point: PointPlan, sizes: set[str]) -> str:
    """The size of a grain that an outlet is measured in, if points differ in it."""
    return "" if len(sizes) == 1 else " d" if point.shared.scene.grains.round else " L"


def _physics(plan: Plan) -> Table:
    """Step, steps, outlet and bed of every point; points that agree in all of that share a row."""

    sizes = {"d" if point.shared.scene.grains.round else "L" for point in plan.points}
    ratio = f"D/{next(iter(sizes))}" if len(sizes) == 1 else "D"  # points then say what they are measured in
    table = Table(box=box.SIMPLE_HEAD)
    for heading in ("point", "dt", "of limit", "fill steps", "steps", ratio, "bed height"):
        table.add_column(heading, overflow="fold", justify="left" if heading == "point" else "right")
    rows: dict[tuple[str, ...], list[str]] = {}
    for point in plan.points:
        numbers = outline(point.shared)
        row = (
            f"{numbers.dt * 1e6:.3g} µs",
            percent(numbers.dt / numbers.limit, ".0f"),
            _count(numbers.fill_steps),
            _count(numbers.steps),
            "–" if numbers.ratio is None else f"{numbers.ratio:.3g}{_size(point, sizes)}",
            "–" if numbers.height is None else f"{numbers.height * 1e3:.3g} mm",
        )
        rows.setdefault(row, []).append(point.shared.point.label)
    for number, (row, labels) in enumerate(rows.items()):
        if number == _ROWS:
            table.add_row(f"and {len(rows) - _ROWS} more", *[""] * len(row))
            break
        if len(labels) == len(plan.points) > 1:
            labels = [f"all {len(labels)} points"]
        rest = f"; and {len(labels) - _LABELS} more" if len(labels) > _LABELS else ""
        table.add_row(escape("; ".join(labels[:_LABELS]) + rest), *row)
    return table
