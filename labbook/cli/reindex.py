"""`labbook reindex`: make the catalogue again from the folders."""

import typer

from labbook.cli.options import LAB, Lab, fail
from labbook.cli.screen import say, ticking


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def reindex(lab: Lab = LAB) -> None:
        """Make the catalogue again from run and packing folders, and measure again."""
        from labbook.lab.folder import Lab as Folder
        from labbook.lab.index import Index

        if not Folder(lab).exists:
            fail(f"there is no lab {lab}: it has neither runs nor packings; give its folder with --lab")
        with ticking("indexing") as tick:
            index = Index(Folder(lab), again=True, tick=tick)
            index.close()
        found = index.found
        typer.echo(f"{found.runs} runs and {found.packings} packings indexed")
        for problem in found.problems:
            say(f"Unreadable: {problem}", err=True)
