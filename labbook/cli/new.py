"""`labbook new`: a commented study to begin with."""

from pathlib import Path
from typing import Annotated

import typer

from labbook.commands import command


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def new(
        name: Annotated[str, typer.Argument(help="Name of the study; the file is called NAME.yaml.")],
        folder: Annotated[Path, typer.Option(help="Folder to write it to.")] = Path("."),
    ) -> None:
        """Write a commented example study. An existing file is never overwritten."""
        from labbook.study.template import NotWritten, write

        try:
            path = write(name, folder)
        except NotWritten as error:
            typer.echo(f"labbook new: {error}", err=True)
            raise typer.Exit(1) from None
        typer.echo(f"Wrote {path}. Next: {command('plan', path)}")
