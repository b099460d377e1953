"""Tables of what a study found, and the design that gives a wanted value."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import typer

from labbook.api import Results
from labbook.cli.options import fail
from labbook.cli.screen import print_table, say, screen
from labbook.report import tables
from labbook.report.clogging import clogging_table, law_tables
from labbook.report.explored import influence_table, next_table, runs_and_time
from labbook.report.fitted_tables import fit_table
from labbook.report.page import summary
from labbook.report.paper import tables_of_all
from labbook.report.statement_tables import statement_digest, statement_table
from labbook.report.tables import numerical_table
from labbook.results import display
from labbook.results.clogging import clogging
from labbook.results.explore import DesignSurface
from labbook.results.frames import to_json
from labbook.results.reference import at_series
from labbook.results.surface import NoSurface


def show(results: Results, as_json: bool) -> None:
    """Print flow rates, fits, comparisons and statements as tables or as JSON."""
    if as_json:
        typer.echo(to_json(results))
        return
    console = screen(highlight=False)
    console.print(results.study.name, style="bold", markup=False)
    for sentence in summary(results):
        console.print(sentence, markup=False)
    print_table(console, tables.flow_table(results), "Flow rates")
    if (flowing := tables.flowing_table(results)) is not None:
        print_table(console, flowing, tables.CLOGGED)
    if results.numerical:
        print_table(console, numerical_table(results.numerical), "Do numerics matter?")
    further = tables.further_table(results)
    if further is not None:
        print_table(console, further, "Further measurements")
    for series in results.series:
        where = f" at {series.label}" if series.label else ""
        for law, fitted in series.fits.items():
            print_table(
                console,
                fit_table(law, fitted, at_series(results.comparisons, law, series), results.source),
                f"{display.law(law)}{where}: {fitted.law.formula}",
            )
        further_tables, failed = tables_of_all(results, series, where)
        for title, table in further_tables:
            print_table(console, table, title)
        for problem in failed:
            say(f"Not shown: {problem}", err=True)
        for problem in series.problems:
            console.print(f"Not fitted{where}: {problem}.", markup=False)
        if series.verdict:
            console.print(series.verdict, markup=False)
    for series in clogging(results):
        where = f" at {series.series.label}" if series.series.label else ""
        print_table(console, clogging_table(series), f"Clogging{where}")
        for fit, table in zip(series.fits, law_tables(series), strict=True):
            print_table(console, table, f"{fit.law.name.capitalize()}{where}: {fit.law.formula}")
        for line in filter(
            None, (*series.doubts, *(f"Not fitted{where}: {problem}." for problem in series.problems), series.verdict)
        ):
            console.print(line, markup=False)
    if digest := statement_digest(results.judged):
        print_table(console, digest, f"Statements of {results.source}")
        if not_holding := [judged for judged in results.judged if judged.verdict != "holds"]:
            print_table(console, statement_table(not_holding), "Statements that do not hold or are undecided")
    elif results.judged:
        print_table(console, statement_table(results.judged), f"Statements of {results.source}")
    if results.comparisons:
        print_table(console, tables.comparison_table(results.comparisons), f"Beside {results.source}")


def answer(results: Results, want: str, over: str | None, at: Sequence[str], as_json: bool) -> None:
    """Print the value of a swept key that gives `want`, such as `flow_rate = 50 g/s`; `at`: values of other keys."""
    quantity, value = _assigned(want, "--want", "'flow_rate = 50 g/s'")
    fixed = dict(_assigned(text, "--at", "'container.angle = 30 deg'") for text in at)
    try:
        design = results.inverse(quantity, value, over, fixed)
    except (LookupError, NoSurface, ValueError) as problem:
        fail(problem.args[0] if isinstance(problem, LookupError) and problem.args else problem)
    if as_json:
        plain = {name: _finite(value) for name, value in asdict(design).items()}
        typer.echo(json.dumps({"study": results.study.name, "at": fixed, **plain}, indent=2, allow_nan=False))
        return
    console = screen(highlight=False)
    for line in (f"{design.sentence}.", f"{design.method[:1].upper()}{design.method[1:]}.", *design.notes):
        console.print(line, markup=False, soft_wrap=True)


def show_explored(results: Results, quantity: str, at: Sequence[str], as_json: bool) -> None:
    """Print what matters for a quantity, and what to run next; `at`: values of keys that take words."""
    fixed = dict(_assigned(text, "--at", "'contact.law = linear'") for text in at)
    try:
        surface = results.explore(quantity, fixed)
    except (LookupError, NoSurface, ValueError) as problem:
        fail(problem.args[0] if isinstance(problem, LookupError) and problem.args else problem)
    if as_json:
        typer.echo(json.dumps(as_plain(surface), indent=2, allow_nan=False))
        return
    console = screen(highlight=False)
    console.print(f"{surface.method[:1].upper()}{surface.method[1:]}.", markup=False, soft_wrap=True)
    for note in surface.notes:
        console.print(note, markup=False, soft_wrap=True)
    print_table(console, influence_table(surface), "What matters")
    print_table(console, next_table(surface), "What to run next")
    if surface.next_study:
        console.print(f"As a study ({runs_and_time(surface.next_runs)}):\n", markup=False)
        console.print(surface.next_study, markup=False, soft_wrap=True)


def as_plain(surface: DesignSurface) -> dict[str, object]:
    """Give what matters and what to run next to programs: SI, None for unknown numbers."""

    def plain(row: Any, **derived: float) -> dict[str, object]:
        return {name: _finite(value) for name, value in (asdict(row) | derived).items()}

    return {
        "study": surface.results.study.name,
        "quantity": surface.quantity,
        "unit": surface.unit,
        "at": dict(surface.at),
        "method": surface.method,
        "lack_of_fit": _finite(surface.fit.lack_of_fit),
        "notes": list(surface.notes),
        "verdict": surface.verdict,
        "influences": [plain(influence) for influence in surface.influences],
        "next": [plain(runs, per_second=runs.per_second) for runs in surface.next_runs],
        "next_study": surface.next_study,
    }


def _assigned(text: str, option: str, example: str) -> tuple[str, str]:
    name, equals, value = (part.strip() for part in text.partition("="))
    if not (name and equals and value):
        raise typer.BadParameter(f"{text}: write {example}", param_hint=option)
    return name, value


def _finite(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value
