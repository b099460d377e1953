"""`labbook movie`: films of recorded runs as WebP, GIF or MP4."""

from pathlib import Path
from typing import Annotated

import typer

from labbook.cli.options import BACKEND, LAB, Backend, Lab


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command()
    def movie(
        target: Annotated[
            str, typer.Argument(metavar="STUDY|RUN", help="Study file, or the first digits of a run's key.")
        ],
        point: Annotated[
            int | None, typer.Option(min=1, help="Only this point of the study, counted from 1.", show_default=False)
        ] = None,
        colour: Annotated[
            str, typer.Option(help="Colour of the grains: layers, speed, force, species or orientation.")
        ] = "layers",
        grid: Annotated[
            bool,
            typer.Option("--grid", help="One film of the whole sweep, swept keys as headings of rows and columns."),
        ] = False,
        seconds: Annotated[float, typer.Option(help="Duration of a film.")] = 6.0,
        size: Annotated[
            int | None,
            typer.Option(
                min=40, max=2000, help="Pixels of the longer side of a bed; default: 480, with --grid 200.",
                show_default=False,
            ),
        ] = None,
        out: Annotated[
            Path | None,
            typer.Option(
                help="File to write, with the ending .webp, .gif or .mp4 (needs ffmpeg); default: in LAB/films.",
                show_default=False,
            ),
        ] = None,
        lab: Lab = LAB,
        backend: Backend = BACKEND,
    ) -> None:  # fmt: skip
        """Make films of runs that kept their frames, for slides, web pages and reports."""
        from labbook.cli.work import movie as work

        work.movie(target, point, colour, grid, seconds, size, out, lab, backend)
