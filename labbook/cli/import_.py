"""`labbook import`: merge the runs and packings of another lab."""

from pathlib import Path
from typing import Annotated

import typer

from labbook.cli.lab import ticking
from labbook.cli.options import LAB, Lab, fail

Source = Annotated[Path, typer.Argument(help="Another lab folder.", metavar="FOLDER", show_default=False)]


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command(name="import")
    def import_(folder: Source, lab: Lab = LAB) -> None:
        """Copy runs and packings from another lab, brought from another machine, and index them."""
        from labbook.catalogue.index import Index
        from labbook.catalogue.lab import DiskFull, room
        from labbook.catalogue.lab import Lab as Folder
        from labbook.catalogue.merge import merge

        target = Folder(lab)
        try:
            with room(lab):
                copied, problems = merge(target, folder)
                with ticking("indexing") as tick:
                    Index(target, tick=tick)
        except (FileNotFoundError, DiskFull) as problem:
            fail(problem)
        typer.echo(f"{len(copied)} runs and packings imported")
        for problem in problems:
            typer.echo(f"Not imported: {problem}", err=True)
