"""`labbook web` and `labbook site`: the pages of a lab, served or as a folder of files."""

from pathlib import Path
from typing import Annotated

import typer

from labbook.cli.options import LAB, Lab, existing, fail
from labbook.cli.screen import say

Studies = Annotated[
    list[Path] | None,
    typer.Argument(metavar="[STUDY]...", help="Study files to show besides those kept in the lab.", show_default=False),
]


def register(app: typer.Typer) -> None:
    """Add the commands to the app."""

    @app.command()
    def web(
        studies: Studies = None,
        lab: Lab = LAB,
        port: Annotated[
            int | None,
            typer.Option(
                min=0,
                max=65535,
                help="Port; default: 8321, or any free port if that is taken; 0: any free port.",
                show_default=False,
            ),
        ] = None,
        host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
        remote: Annotated[
            bool,
            typer.Option(
                "--remote", help="Allow an address that other machines can reach; clients need the printed token."
            ),
        ] = False,
        read_only: Annotated[bool, typer.Option("--read-only", help="Do not write notes and tags.")] = False,
        open_browser: Annotated[
            bool, typer.Option("--open/--no-open", help="Open the first page in a browser.")
        ] = True,
    ) -> None:
        """Browse a lab in a web browser: studies, charts, and runs in progress.

        The app evaluates nothing and writes only notes; it does not block a running study. Ctrl-C ends it.
        """
        try:
            from labbook_web.serve import CannotServe, serve
        except ModuleNotFoundError as missing:
            fail(f"{missing.name} is not installed; install it: pip install 'labbook[web]'")
        for study in studies or ():
            if not study.is_file():
                fail(f"no such file: {study}; give the path of a study file")
        if lab.exists() or not studies:  # a study may be followed from before its first run
            existing(lab).close()
        try:
            serve(lab, studies or (), host, port, remote=remote, read_only=read_only, browse=open_browser, say=say)
        except CannotServe as why:
            fail(why)

    @app.command()
    def site(
        out: Annotated[Path, typer.Argument(help="Folder to write: new, empty, or a site written before.")],
        studies: Annotated[list[Path], typer.Argument(metavar="STUDY...", help="Study files to show.")],
        lab: Lab = LAB,
        recordings: Annotated[
            bool, typer.Option("--recordings", help="Include the recordings of runs (.rrd) for download.")
        ] = False,
        films: Annotated[
            bool, typer.Option("--films", help="Make films of all recorded runs; those in the lab are included anyway.")
        ] = False,
        notes: Annotated[
            bool, typer.Option("--notes/--no-notes", help="Publish the notes and tags of these studies and runs.")
        ] = False,
    ) -> None:
        """Write the pages of studies as static files, for a paper's supplement or a project page.

        Notes and tags may be private: they are left out unless --notes is given.
        """
        try:
            from labbook_web.site import CannotWrite, has_notes, write
        except ModuleNotFoundError as missing:
            fail(f"{missing.name} is not installed; install it: pip install 'labbook[web]'")
        existing(lab).close()
        try:
            first = write(
                out, lab, studies, recordings=recordings, films=films, notes=notes, say=lambda text: say(text, err=True)
            )
        except CannotWrite as why:
            fail(why)
        if notes:
            say("Notes and tags are published with the site.", err=True)
        elif has_notes(lab):
            say("Notes and tags are left out; --notes publishes them.", err=True)
        say(f"Site: {first}")
