"""`labbook import`: merge the runs, packings, study files and notes of another lab."""

from pathlib import Path
from typing import Annotated

import typer

from labbook.cli.options import LAB, Lab, fail
from labbook.cli.screen import say, ticking

Sources = Annotated[list[Path], typer.Argument(help="Other lab folders.", metavar="FOLDER...", show_default=False)]


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command(name="import")
    def import_(folders: Sources, lab: Lab = LAB) -> None:
        """Copy runs, packings, study files and notes from other labs, and index them.

        Everything is looked at before it is taken; what is damaged or does not belong is named, and left out. Exit
        status 1 if anything was left out. Runners may work in either lab meanwhile: unfinished work is not imported,
        and a longer run is never replaced by a shorter one. A study file or note of this lab stays as it is; if
        another lab has a different one under the same name, that is said.
        """
        from labbook.lab.folder import Lab as Folder
        from labbook.lab.folder import room
        from labbook.lab.index import Index
        from labbook.lab.merge import Merged, merge

        for folder in folders:
            if not Folder(folder).exists:
                fail(f"{folder}: no lab: it has neither runs/ nor packings/")
        merged = Merged()
        with room(lab):
            with ticking("indexing") as tick:
                index = Index(Folder(lab), tick=tick)
            for folder in folders:
                merged += merge(index, folder)
            index.close()
        say(f"{len(merged.copied)} runs and packings imported")
        if merged.studies:
            say(f"Study files imported: {', '.join(merged.studies)}")
        if merged.notes:
            say(f"Notes imported: {merged.notes}")
        for what in merged.stayed:
            say(f"Not replaced: {what}")
        for problem in merged.left_out:
            say(f"Not imported: {problem}", err=True)
        if merged.left_out:
            raise typer.Exit(1)
