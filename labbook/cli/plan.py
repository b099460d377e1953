"""`labbook plan`: what a study still needs, and why."""

import json
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import typer

from labbook.cli.lab import Device, engine_called, open_catalogue
from labbook.cli.options import ENGINE, LAB, AsJson, Engine, Lab, StudyFile, fail, read_study
from labbook.cli.screen import say, screen

if TYPE_CHECKING:
    from labbook.plan.forecast import Forecast
    from labbook.plan.plan import Plan


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def plan(
        study: StudyFile, lab: Lab = LAB, backend: Engine = ENGINE, device: Device = "cpu", as_json: AsJson = False
    ) -> None:
        """Show what is done, missing, partial or stale and why, with a forecast of time and disk."""
        from labbook.backend import Unsupported
        from labbook.catalogue.lab import Lab as Folder
        from labbook.measure import MeasureError
        from labbook.plan.check import check
        from labbook.plan.demand import Conflict
        from labbook.plan.forecast import forecast
        from labbook.plan.plan import Planner
        from labbook.plan.reach import cut_short
        from labbook.runner.provenance import cores, provenance

        asked, engine = read_study(study), engine_called(backend)
        catalogue = open_catalogue(lab)
        try:
            made = Planner(asked, catalogue, engine.capabilities).plan()
            check(engine, device, made.points)
        except (Unsupported, Conflict, MeasureError) as problem:
            fail(problem)
        lanes = cores() if device == "cpu" else 1
        ahead = forecast(made, catalogue, provenance(device)["machine"], device, lanes)
        warnings = list(cut_short(made, Folder(lab)))
        if as_json:
            typer.echo(json.dumps({**plain(made, ahead), "warnings": warnings}, indent=2, allow_nan=False))
        else:
            _show(made, ahead)
            for line in warnings:
                say(line)


def plain(plan: "Plan", ahead: "Forecast") -> dict[str, Any]:
    """The plan as plain values."""
    return {
        "study": plan.study.name,
        "engine": plan.engine.name,
        "counts": dict(plan.counts()),
        "runs": [
            {
                "point": item.demand.point.index,
                "label": item.demand.point.label,
                "seed": item.demand.seed,
                "run_key": item.keys.run,
                "state": item.state,
                "reason": item.reason,
                "outcome": item.outcome,
                "packing_key": item.keys.packing,
                "packing": "there" if item.packed else "missing",
            }
            for item in plan.items
        ],
        "packings_missing": len(plan.fillings),
        "replicates": {"first": plan.rule.first, "cap": plan.rule.cap, "tolerance": plan.rule.tolerance},
        "forecast": {
            "seconds": ahead.seconds,
            "disk_bytes": ahead.disk,
            "grain_steps": ahead.grain_steps,
            "grain_steps_per_second": ahead.speed,
            "lanes": ahead.lanes,
            "basis": ahead.basis,
        },
    }


def spans(seeds: Iterable[int]) -> str:
    """Whole numbers in few words: `1-3, 5` for 1, 2, 3 and 5."""
    found: list[list[int]] = []
    for seed in sorted(seeds):
        if found and seed == found[-1][-1] + 1:
            found[-1][1:] = [seed]
        else:
            found.append([seed])
    return ", ".join("-".join(map(str, span)) for span in found)


def _show(plan: "Plan", ahead: "Forecast") -> None:
    from collections import defaultdict

    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from labbook.runner.progress import duration, size

    console = screen(highlight=False)
    groups: dict[tuple[str, str, str], list[int]] = defaultdict(list)
    for item in plan.items:
        groups[item.demand.point.label, item.state, item.reason].append(item.demand.seed)
    table = Table(title=escape(plan.study.name), title_justify="left", box=box.SIMPLE_HEAD)
    for heading in ("point", "seeds", "state", "why"):
        table.add_column(heading, no_wrap=heading == "state", overflow="fold")
    colours = {"done": "green", "partial": "yellow", "stale": "yellow", "missing": "default"}
    for (label, state, reason), seeds in groups.items():
        table.add_row(escape(label), spans(seeds), f"[{colours[state]}]{state}[/]", escape(reason))
    console.print(table)
    counts = plan.counts()
    console.print(", ".join(f"{counts[state]} {state}" for state in colours if counts[state]), markup=False)
    rule = plan.rule
    if rule.sequential:
        console.print(
            f"Up to {rule.cap} replicates a point, until the flow rate is known to {rule.tolerance:.2%}", markup=False
        )
    if plan.todo:
        console.print(
            f"{len(plan.fillings)} packings to make; about {duration(ahead.seconds)} on {ahead.lanes} lanes "
            f"({ahead.basis}), {size(ahead.disk)} on disk",
            markup=False,
        )
