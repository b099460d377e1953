"""`labbook new-extension`: a package to begin an extension with."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from labbook.cli.screen import say


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command("new-extension")
    def new_extension(
        name: Annotated[str, typer.Argument(help="Name of the package: small letters, digits and -.")],
        folder: Annotated[Path, typer.Option(help="Folder to write it to.")] = Path("."),
    ) -> None:
        """Write a package that extends labbook: a contact law, a measure, a verification case, a test and a study.

        An existing folder is never overpackage.
        """
        from labbook.extension import PackageNotWritten, write

        try:
            package = write(name, folder)
        except PackageNotWritten as error:
            say(f"labbook new-extension: {error}", err=True)
            raise typer.Exit(1) from None
        say(f"Wrote {package}. Next: pip install --no-deps -e {shlex.quote(str(package))}")
