"""`labbook report`: the page and figures of a study."""

from pathlib import Path
from typing import Annotated

import typer

from labbook.cli.options import Backend, Lab, StudyFile


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def report(
        study: StudyFile,
        out: Annotated[
            Path | None, typer.Option(help="Folder of the report.  [default: LAB/reports/NAME-OF-THE-STUDY]")
        ] = None,
        lab: Lab = Path("lab"),
        backend: Backend = "numba",
    ) -> None:
        """Write the report of a study: one HTML file, and its figures as PNG, SVG and PDF."""
        from labbook.cli.options import analysed
        from labbook.report.page import write

        analysis = analysed(study, lab, backend)
        folder = out if out is not None else lab / "reports" / analysis.study.name
        page = write(analysis, folder)
        typer.echo(f"Report: {page}")
