"""`labbook report`: the page and figures of a study."""

from pathlib import Path
from typing import Annotated

import typer

from labbook.cli.options import BACKEND, LAB, Backend, Lab, StudyFile, results
from labbook.cli.screen import say


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command()
    def report(
        study: StudyFile,
        out: Annotated[
            Path | None, typer.Option(help="Folder of the report; if not given, LAB/reports/NAME.", show_default=False)
        ] = None,
        lab: Lab = LAB,
        backend: Backend = BACKEND,
    ) -> None:
        """Write the report of a study: one HTML file, and its figures as PNG, SVG and PDF."""
        page = results(study, lab, backend).report(out)
        say(f"Report: {page}")
