"""`labbook fit`: what a study found, as tables."""

import typer

from labbook.cli.options import BACKEND, LAB, AsJson, Backend, Lab, StudyFile, results


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def fit(study: StudyFile, lab: Lab = LAB, backend: Backend = BACKEND, as_json: AsJson = False) -> None:
        """Show flow rates with errors, fits with intervals, and the comparison with the reference."""
        from labbook.cli.work.fit import show

        show(results(study, lab, backend), as_json)
