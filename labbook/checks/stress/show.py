"""Cases of `labbook stress` on the terminal: the parts of each case as it ends, or JSON."""

import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress, TimeElapsedColumn
from rich.table import Table

from labbook.backend import BackendMissing, Unsupported
from labbook.checks.stress.bounded import NamedBackend, judge_isolated
from labbook.checks.stress.case import Row, StressCase

LABELS = {
    "right": "[green]right[/]",
    "named error": "[green]named error[/]",
    "failed": "[bold red]FAILED[/]",
    "unsupported": "[dim]unsupported[/]",
}


EXCERPT = 100
"""Characters of a message that the table shows; JSON has all."""


def list_cases(cases: Sequence[StressCase], as_json: bool, console: Console) -> None:
    """Print the attempt of each case and its oracle."""
    if as_json:
        rows = [{"case": case.name, "what": case.attempt, "oracle": case.oracle, "slow": case.slow} for case in cases]
        typer.echo(json.dumps(rows, indent=2))
        return
    table = Table("case", "what is done", "oracle")
    for case in cases:
        table.add_row(case.name, case.attempt, case.oracle)
    console.print(table)


def run_cases(cases: Sequence[StressCase], named_backend: NamedBackend, as_json: bool, console: Console) -> bool:
    """Run cases and print their outcomes; a backend that cannot run them ends the program. Returns False on failure."""
    try:
        platform = named_backend.platform()
        if named_backend.precision not in platform.backend.capabilities.precisions:
            raise Unsupported(
                "numerics.precision", f"{named_backend.backend} has no precision {named_backend.precision}"
            )
    except (BackendMissing, Unsupported) as error:
        typer.echo(f"labbook stress: {error}", err=True)
        raise typer.Exit(2) from None
    rows: list[Row] = []
    for case_rows in _run_each(cases, named_backend):
        rows += case_rows
        if not as_json:
            console.print(_lines(case_rows))
            console.file.flush()  # whoever stops it later has this
    if as_json:
        # JSON has no NaN: a number that is not finite is null, and `figure` says what it was
        typer.echo(json.dumps([{**asdict(row), "error": _finite(row.error)} for row in rows], indent=2))
    else:
        counts = ", ".join(f"{sum(row.outcome == name for row in rows)} {name}" for name in LABELS)
        typer.echo(f"{counts}; backend {named_backend.backend}, {named_backend.precision}, {named_backend.device}")
    return all(row.outcome != "failed" for row in rows)


def _finite(error: float | None) -> float | None:
    return error if error is not None and math.isfinite(error) else None


def _run_each(cases: Sequence[StressCase], named_backend: NamedBackend) -> Iterator[list[Row]]:
    """Yield the rows of each case at its end."""
    # standard output is another stream where only one of the two is a terminal
    bar = Progress(
        *Progress.get_default_columns(), TimeElapsedColumn(), console=Console(stderr=True),
        redirect_stdout=sys.stdout.isatty(),
    )  # fmt: skip
    with bar:
        task = bar.add_task("", total=len(cases))
        endings = judge_isolated(cases, named_backend)
        for case in cases:
            bar.update(task, description=case.name)
            yield next(endings)
            bar.advance(task)
        endings.close()


def _excerpt(figure: str) -> str:
    return figure if len(figure) <= EXCERPT else figure[: EXCERPT - 1] + "…"


def _lines(rows: Sequence[Row]) -> Table:
    """Lay out the parts of a case; if one failed, add the attempt and the oracle."""
    table = Table.grid(padding=(0, 2, 0, 0))
    for row in rows:
        table.add_row(LABELS[row.outcome], row.case, escape(row.part), escape(_excerpt(row.figure)))
    if any(row.outcome == "failed" for row in rows):
        table.add_row("", "", "what is done", rows[0].what)
        table.add_row("", "", "oracle", rows[0].oracle)
    return table
