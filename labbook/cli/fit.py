"""`labbook fit`: what a study found, as tables."""

import json
import sys

import typer

from labbook.cli.options import ENGINE, LAB, AsJson, Engine, Lab, StudyFile, analysed


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def fit(study: StudyFile, lab: Lab = LAB, backend: Engine = ENGINE, as_json: AsJson = False) -> None:
        """Show flow rates with errors, fits with intervals, and the comparison with the reference."""
        from labbook.report.plain import plain

        analysis = analysed(study, lab, backend)
        if as_json:
            typer.echo(json.dumps(plain(analysis), indent=2, allow_nan=False))
        else:
            _show(analysis)


def _show(analysis) -> None:
    from rich.console import Console

    from labbook.report import tables
    from labbook.report.page import summary

    console = Console(highlight=False, width=None if sys.stdout.isatty() else 120)
    console.print(f"[bold]{analysis.study.name}[/bold]")
    for sentence in summary(analysis):
        console.print(sentence, markup=False)
    _print(console, tables.flow_table(analysis), "Flow rates")
    packing = tables.packing_table(analysis)
    if packing is not None:
        _print(console, packing, "Packings")
    for series in analysis.series:
        where = f" at {series.label}" if series.label else ""
        for law, found in series.fits.items():
            _print(console, tables.fit_table(law, found), f"{law.capitalize()}{where}: {found.law.formula}")
        for problem in series.problems:
            console.print(f"Not fitted{where}: {problem}.", markup=False)
        if series.verdict:
            console.print(series.verdict, markup=False)
    if analysis.comparisons:
        _print(console, tables.comparison_table(analysis.comparisons), f"Beside {analysis.study.reference.source}")


def _print(console, table, title: str) -> None:
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    shown = Table(title=escape(title), title_justify="left", box=box.SIMPLE_HEAD)
    for place, heading in enumerate(table.headings):
        words = place in table.text
        shown.add_column(escape(heading), justify="left" if words else "right", no_wrap=not words)
    for place, row in enumerate(table.rows):
        shown.add_row(*map(escape, row), style="bold" if place in table.marked else None)
    console.print(shown)
    for note in table.notes:
        console.print(note, style="dim", markup=False)
