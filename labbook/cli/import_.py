"""`labbook import`: merge the runs, packings, study files and notes of another lab."""

from pathlib import Path
from typing import Annotated

import typer

from labbook.cli.options import LAB, Lab, fail
from labbook.cli.screen import say, ticking

Sources = Annotated[list[Path], typer.Argument(help="Other lab folders.", metavar="FOLDER...", show_default=False)]


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command(name="import")
    def import_(folders: Sources, lab: Lab = LAB) -> None:
        """Copy runs, packings, study files and notes from other labs, and index them.

        Every file is checked first; damaged or foreign files are named and left out. Exit status 1 if any was left
        out. Both labs may be in use meanwhile: unfinished runs are not imported, and a longer run is never replaced
        by a shorter one. Study files and notes of this lab are never replaced; if another lab has a different one
        under the same name, a message says so.
        """
        from labbook.lab.folder import LabFolder, room
        from labbook.lab.index import Index
        from labbook.lab.merge import Merged, merge

        for folder in folders:
            if not LabFolder(folder).exists:
                fail(f"{folder} is not a lab: it has neither runs/ nor packings/; give a lab folder")
        merged = Merged()
        with room(lab):
            with ticking("indexing") as tick:
                index = Index(LabFolder(lab), tick=tick)
            for folder in folders:
                merged += merge(index, folder)
            index.close()
        say(f"Runs and packings imported: {len(merged.copied)}")
        if merged.studies:
            say(f"Study files imported: {', '.join(merged.studies)}")
        if merged.notes:
            say(f"Notes imported: {merged.notes}")
        for difference in merged.stayed:
            say(f"Not replaced: {difference}")
        for problem in merged.left_out:
            say(f"Not imported: {problem}", err=True)
        if merged.left_out:
            raise typer.Exit(1)
