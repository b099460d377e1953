"""`labbook web` and `labbook site`: the pages of a lab, served or as a folder of files."""

from pathlib import Path
from typing import Annotated

import typer

from labbook.cli.options import LAB, Lab, existing, fail

Studies = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="[STUDY]...", help="Study files to show besides those that the lab keeps.", show_default=False
    ),
]


def register(app: typer.Typer) -> None:
    """Add the verbs."""

    @app.command()
    def web(
        studies: Studies = None,
        lab: Lab = LAB,
        port: Annotated[
            int | None,
            typer.Option(
                min=0, max=65535, help="Port; if not given, 8321, or any that is free; 0: any.", show_default=False
            ),
        ] = None,
        host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
        remote: Annotated[
            bool,
            typer.Option(
                "--remote", help="Allow an address that other machines can reach; whoever asks needs the printed token."
            ),
        ] = False,
        read_only: Annotated[bool, typer.Option("--read-only", help="Write no notes and tags either.")] = False,
        open_browser: Annotated[
            bool, typer.Option("--open/--no-open", help="Open the first page in a browser.")
        ] = True,
    ) -> None:
        """Browse a lab: its studies, their charts, and their runs while they go on.

        Nothing is evaluated and nothing but notes is written; a study that runs is not held up. Ctrl-C ends it.
        """
        try:
            from labbook_web.serve import CannotServe, serve
        except ModuleNotFoundError as missing:
            fail(f"{missing.name} is not installed; install it: pip install 'labbook[web]'")
        for study in studies or ():
            if not study.is_file():
                fail(f"there is no file {study}")
        if lab.exists():
            existing(lab).close()
        try:
            serve(
                lab, studies or (), host, port, remote=remote, read_only=read_only, browse=open_browser, say=typer.echo
            )
        except CannotServe as why:
            fail(why)

    @app.command()
    def site(
        out: Annotated[Path, typer.Argument(help="Folder to write, which is new or empty or a site already.")],
        studies: Annotated[list[Path], typer.Argument(metavar="STUDY...", help="Study files to show.")],
        lab: Lab = LAB,
        recordings: Annotated[
            bool, typer.Option("--recordings", help="Take the recordings of runs along (.rrd), to download.")
        ] = False,
    ) -> None:
        """Write the pages of studies as a folder that needs no server: for a paper's supplement or a project page."""
        try:
            from labbook_web.site import CannotWrite, write
        except ModuleNotFoundError as missing:
            fail(f"{missing.name} is not installed; install it: pip install 'labbook[web]'")
        existing(lab).close()
        try:
            first = write(out, lab, studies, recordings=recordings, say=lambda text: typer.echo(text, err=True))
        except CannotWrite as why:
            fail(why)
        typer.echo(f"Site: {first}")
