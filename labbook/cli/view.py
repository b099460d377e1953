"""`labbook view`: recordings of runs, made if missing, in the rerun viewer."""

from pathlib import Path
from typing import Annotated

import typer

from labbook.cli.options import BACKEND, LAB, Backend, Lab


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command()
    def view(
        targets: Annotated[
            list[str],
            typer.Argument(
                metavar="STUDY|RUN...",
                help="Study file, or the first digits of a run's key; several: side by side on one clock.",
            ),
        ],
        point: Annotated[
            int | None, typer.Option(min=1, help="Only this point of the study, counted from 1.", show_default=False)
        ] = None,
        screenshot: Annotated[
            Path | None,
            typer.Option(
                help="Write a picture (.png) of the views of the first recording; needs no screen.", show_default=False
            ),
        ] = None,
        at: Annotated[
            float, typer.Option("--at", min=0, max=1, help="Part of the run at which the picture is taken.")
        ] = 0.4,
        size: Annotated[
            str, typer.Option(metavar="WIDTHxHEIGHT", help="Window of the picture in pixels.")
        ] = "1100x1200",
        open_viewer: Annotated[
            bool, typer.Option("--open/--no-open", help="Open the viewer, or only write the recordings.")
        ] = True,
        lab: Lab = LAB,
        backend: Backend = BACKEND,
    ) -> None:
        """Make recordings of runs that kept their frames, and open them in the rerun viewer."""
        from labbook.cli.work import view as work

        work.view(targets, point, screenshot, at, size, open_viewer, lab, backend)
