"""`labbook reindex`: make the catalogue again from the folders, and choose where it is kept."""

from typing import Annotated

import typer

from labbook.cli.options import LAB, Lab, fail
from labbook.cli.screen import say, ticking


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command()
    def reindex(
        lab: Lab = LAB,
        index: Annotated[
            str | None,
            typer.Option(
                "--index",
                metavar="<url|file>",
                help="New place of the index: postgresql://HOST/DATABASE, or file (in the lab's folder).",
            ),
        ] = None,
    ) -> None:
        """Rebuild the index from the folders of runs and packings, and evaluate every run again.

        A lab that several people share may keep its index on a PostgreSQL server.
        """
        from labbook.lab import server
        from labbook.lab.folder import LabFolder
        from labbook.lab.index import Index

        if not LabFolder(lab).exists:
            fail(f"there is no lab {lab}: it has neither runs nor packings; give its folder with --lab")
        if index is not None:
            left = server.move_to_file(LabFolder(lab)) if index == "file" else server.move_to(LabFolder(lab), index)
            if left:
                say(left, err=True)
        with ticking("indexing") as tick:
            new_index = Index(LabFolder(lab), again=True, tick=tick)
            new_index.close()
        report = new_index.report
        say(f"{report.runs} runs and {report.packings} packings indexed")
        for problem in report.problems:
            say(f"Unreadable: {problem}", err=True)
