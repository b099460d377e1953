"""`labbook doctor`: what is installed, which backends work here, and whether a folder can hold a lab."""

from pathlib import Path
from typing import Annotated

import typer

from labbook.cli.options import BACKEND, Backend


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command()
    def doctor(
        as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
        kernel: Annotated[
            Path | None,
            typer.Option(
                metavar="STUDY", help="Only print the module of kernels that this study needs.", show_default=False
            ),
        ] = None,
        point: Annotated[int, typer.Option(min=1, help="With --kernel: point of the study, counted from 1.")] = 1,
        backend: Backend = BACKEND,
        lab: Annotated[
            Path | None,
            typer.Option(help="Only test whether this folder can hold a lab.", metavar="PATH", show_default=False),
        ] = None,
        peer: Annotated[
            bool, typer.Option("--peer", help="With --lab: also test between this host and another one.")
        ] = False,
    ) -> None:
        """List what is installed, and run a short test of every backend on each device. Exit status 1 if none works.

        With --lab, test the file system of a folder: free space, locks between two processes, atomic rename, fsync,
        its clock, and the index. With --lab and --peer, wait for the same command with the same folder on another
        host, then test locks, rename, clocks and index between the two. Exit status 1 if a test fails.
        """
        from labbook.cli.work import doctor as work

        work.doctor(as_json, kernel, point, backend, lab, peer)
