"""`labbook reindex`: make the catalogue again from the folders."""

import typer

from labbook.cli.lab import ticking
from labbook.cli.options import LAB, Lab


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def reindex(lab: Lab = LAB) -> None:
        """Make the catalogue again from run and packing folders, and measure again."""
        from labbook.catalogue.index import Index
        from labbook.catalogue.lab import Lab as Folder

        with ticking("indexing") as tick:
            found = Index(Folder(lab), again=True, tick=tick).found
        typer.echo(f"{found.runs} runs and {found.packings} packings indexed")
        for problem in found.problems:
            typer.echo(f"Unreadable: {problem}", err=True)
