"""`labbook fit`: what a study found, as tables."""

import json
import sys

import typer

from labbook.cli.options import BACKEND, LAB, AsJson, Backend, Lab, StudyFile, analysed
from labbook.cli.screen import screen
from labbook.cli.tables import print_table


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def fit(study: StudyFile, lab: Lab = LAB, backend: Backend = BACKEND, as_json: AsJson = False) -> None:
        """Show flow rates with errors, fits with intervals, and the comparison with the reference."""
        from labbook.report.plain import plain

        analysis = analysed(study, lab, backend)
        if as_json:
            typer.echo(json.dumps(plain(analysis), indent=2, allow_nan=False))
        else:
            _show(analysis)


def _show(analysis) -> None:
    from labbook.fit.outlet import DEFINITIONS, FORMULA
    from labbook.report import outlet_tables, tables
    from labbook.report.comparison import at_series
    from labbook.report.fitted_tables import fit_table
    from labbook.report.page import summary
    from labbook.report.statement_tables import statement_digest, statement_table
    from labbook.report.tables import numerical_table

    console = screen(highlight=False, width=None if sys.stdout.isatty() else 120)
    console.print(analysis.study.name, style="bold", markup=False)
    for sentence in summary(analysis):
        console.print(sentence, markup=False)
    print_table(console, tables.flow_table(analysis), "Flow rates")
    if analysis.numerical:
        print_table(console, numerical_table(analysis.numerical), "Do numerics matter?")
    further = tables.further_table(analysis)
    if further is not None:
        print_table(console, further, "Further measurements")
    for series in analysis.series:
        where = f" at {series.label}" if series.label else ""
        for law, found in series.fits.items():
            print_table(
                console,
                fit_table(law, found, at_series(analysis.comparisons, law, series), analysis.source),
                f"{law.capitalize()}{where}: {found.law.formula}",
            )
        for name in series.profiles:
            title = f"Profiles along the outlets{where} ({DEFINITIONS[name]}): {FORMULA}"
            shown = outlet_tables.profile_table(series, name, analysis.comparisons, analysis.source)
            print_table(console, shown, title)
            print_table(console, outlet_tables.outlet_table(series, name), f"Outlets{where}")
        for problem in series.problems:
            console.print(f"Not fitted{where}: {problem}.", markup=False)
        if series.verdict:
            console.print(series.verdict, markup=False)
    if digest := statement_digest(analysis.judged):
        print_table(console, digest, f"What {analysis.source} state")
        if open_ones := [one for one in analysis.judged if one.verdict != "holds"]:
            print_table(console, statement_table(open_ones), "Where that does not hold, or is undecided")
    elif analysis.judged:
        print_table(console, statement_table(analysis.judged), f"What {analysis.source} state")
    if analysis.comparisons:
        print_table(console, tables.comparison_table(analysis.comparisons), f"Beside {analysis.source}")
