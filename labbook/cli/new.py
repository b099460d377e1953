"""`labbook new`: a commented study to begin with."""

from pathlib import Path
from typing import Annotated

import typer

from labbook.cli.screen import say
from labbook.commands import command


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command()
    def new(
        name: Annotated[str, typer.Argument(help="Name of the study; the file is called NAME.yaml.")],
        folder: Annotated[Path, typer.Option(help="Folder to write it to.")] = Path("."),
        kind: Annotated[
            str,
            typer.Option(help="Its container: wedge-hopper, cylinder-silo, conical-silo, box or primitives."),
        ] = "wedge-hopper",
    ) -> None:
        """Write a commented example study. An existing file is never overwritten."""
        from labbook.study.template import NotWritten, write

        try:
            path = write(name, folder, kind)
        except NotWritten as error:
            say(f"labbook new: {error}", err=True)
            raise typer.Exit(1) from None
        say(f"Wrote {path}. Next: {command('plan', path)}")
