"""Cases on the terminal: a table that grows as verdicts come in, or JSON."""

import json
from collections.abc import Sequence
from dataclasses import asdict

import typer
from rich.console import Console
from rich.progress import Progress, TimeElapsedColumn
from rich.table import Table

from labbook.backend import BackendMissing, Unsupported, load
from labbook.checks.verify.case import Case, CriterionResult, failed, judge
from labbook.checks.verify.cases import EVERY
from labbook.checks.verify.platform import Platform
from labbook.plugins import ExtensionError

COLOURS = {"passed": "green", "failed": "bold red", "reported": "dim", "unsupported": "dim"}


def list_cases(cases: Sequence[Case], as_json: bool, console: Console) -> None:
    """Print the statement and the source of each case."""
    if as_json:
        typer.echo(json.dumps([_described(case) for case in cases], indent=2))
        return
    table = Table("case", "what holds", "source")
    for case in cases:
        table.add_row(case.name, case.statement, case.source)
    console.print(table)


def _described(case: Case) -> dict[str, object]:
    limits = {name: dict(measure.limits) for name, measure in case.measures.items()}
    return {"case": case.name, "statement": case.statement, "source": case.source, "limits": limits}


def run_cases(
    cases: Sequence[Case], backend: str, precision: str, device: str, as_json: bool, console: Console
) -> bool:
    """Run cases and print their verdicts; a backend that cannot run them ends the program. Returns False on failure."""
    try:
        verdicts = judge_all(cases, Platform(load(backend), precision, device))
    except (BackendMissing, Unsupported) as error:
        typer.echo(f"labbook verify: {error}", err=True)
        raise typer.Exit(2) from None
    if as_json:
        # JSON has no NaN: an error that could not be measured is null, and `note` says why
        rows = [{**asdict(v), "error": v.error if v.error == v.error else None} for v in verdicts]
        typer.echo(json.dumps(rows, indent=2))
    else:
        console.print(_table(verdicts))
        failed = sum(v.result == "failed" for v in verdicts)
        passed = sum(v.result == "passed" for v in verdicts)
        typer.echo(f"{passed} passed, {failed} failed, backend {backend}, {precision}, {device}")
    return all(v.result != "failed" for v in verdicts)


def judge_all(cases: Sequence[Case], platform: Platform) -> list[CriterionResult]:
    """Judge cases on a platform, with a progress bar; a case of another package whose code fails is failed."""
    verdicts: list[CriterionResult] = []
    with Progress(*Progress.get_default_columns(), TimeElapsedColumn(), console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=len(cases))
        for case in cases:
            bar.update(task, description=case.name)
            try:
                with EVERY.calling(case.name, Unsupported):
                    verdicts += judge(case, platform)
            except ExtensionError as error:
                verdicts += failed(case, platform, str(error))
            bar.advance(task)
    return verdicts


def _table(verdicts: Sequence[CriterionResult]) -> Table:
    table = Table("test", "error of", "error", "tolerance", "source", "verdict")
    before = ""
    for v in verdicts:
        unit = f" {v.unit}" if v.unit else ""
        limit = "" if v.limit is None else f"{v.limit:.3g}{unit}"
        error = v.note or f"{v.error:.3g}{unit}"
        verdict = f"[{COLOURS[v.result]}]{v.result}[/]"
        first = v.case != before
        table.add_row(v.case if first else "", v.measure, error, limit, v.source if first else "", verdict)
        before = v.case
    return table
