"""Cases of `labbook stress` on the terminal: a table, or JSON."""

import json
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress, TimeElapsedColumn
from rich.table import Table

from labbook.backend import BackendMissing, Unsupported
from labbook.stress.bounded import Bench, judged
from labbook.stress.case import Case, Row

SHOWN = {
    "right": "[green]right[/]",
    "named error": "[green]named error[/]",
    "failed": "[bold red]FAILED[/]",
    "unsupported": "[dim]unsupported[/]",
}


EXCERPT = 100
"""Characters of a message that the table shows; JSON has all."""


def list_cases(cases: Sequence[Case], as_json: bool) -> None:
    """Print what each case does, and its oracle."""
    if as_json:
        told = [{"case": case.name, "what": case.what, "oracle": case.oracle, "slow": case.slow} for case in cases]
        typer.echo(json.dumps(told, indent=2))
        return
    table = Table("case", "what is done", "oracle")
    for case in cases:
        table.add_row(case.name, case.what, case.oracle)
    Console().print(table)


def run_cases(cases: Sequence[Case], bench: Bench, as_json: bool) -> bool:
    """Run cases and print how they ended; whether none failed. A backend that cannot do it ends the program."""
    try:
        stand = bench.stand()
        if bench.precision not in stand.backend.capabilities.precisions:
            raise Unsupported("numerics.precision", f"{bench.backend} has no precision {bench.precision}")
    except (BackendMissing, Unsupported) as error:
        typer.echo(f"labbook stress: {error}", err=True)
        raise typer.Exit(2) from None
    rows = _rows(cases, bench)
    if as_json:
        # JSON has no NaN: a number that is not finite is null, and `figure` says what it was
        typer.echo(json.dumps([{**asdict(row), "error": _finite(row.error)} for row in rows], indent=2))
    else:
        Console(width=None if sys.stdout.isatty() else 200).print(_table(rows))
        counts = ", ".join(f"{sum(row.outcome == name for row in rows)} {name}" for name in SHOWN)
        typer.echo(f"{counts}; backend {bench.backend}, {bench.precision}, {bench.device}")
    return all(row.outcome != "failed" for row in rows)


def _finite(error: float | None) -> float | None:
    return error if error is not None and math.isfinite(error) else None


def _rows(cases: Sequence[Case], bench: Bench) -> list[Row]:
    rows: list[Row] = []
    with Progress(*Progress.get_default_columns(), TimeElapsedColumn(), console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=len(cases))
        found = judged(cases, bench)
        for case in cases:
            bar.update(task, description=case.name)
            rows += next(found)
            bar.advance(task)
        found.close()
    return rows


def _excerpt(figure: str) -> str:
    return figure if len(figure) <= EXCERPT else figure[: EXCERPT - 1] + "…"


def _table(rows: Sequence[Row]) -> Table:
    table = Table("case", "what is done", "oracle", "part", "outcome", "figure")
    before = ""
    for row in rows:
        first = row.case != before
        head = (row.case, row.what, row.oracle) if first else ("", "", "")
        table.add_row(*head, escape(row.part), SHOWN[row.outcome], escape(_excerpt(row.figure)))
        before = row.case
    return table
