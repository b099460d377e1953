"""Arguments that several verbs share, and how their mistakes are told."""

import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

if TYPE_CHECKING:
    from labbook.report.analysis import Analysis
    from labbook.study import Study

StudyFile = Annotated[Path, typer.Argument(help="Study file (YAML).", metavar="STUDY", show_default=False)]
Lab = Annotated[Path, typer.Option("--lab", envvar="LABBOOK_LAB", help="Lab folder.")]
Engine = Annotated[str, typer.Option("--backend", help="Engine whose runs are meant.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]

LAB = Path("lab")
ENGINE = "numba"
STOPPED = 130
"""Exit status of what was asked to stop, as shells give it for Ctrl-C."""
GO_ON = "the same command goes on from here"


def fail(message: object) -> NoReturn:
    """End with exit status 1 and the message on standard error."""
    typer.echo(f"Error: {message}", err=True)
    raise typer.Exit(1)


def leave(status: int) -> NoReturn:
    """End the process now, whatever its threads are doing: they may be compiling or in the middle of a long beat."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # the terminal is gone, or the stream is closed
            stream.flush()
    os._exit(status)


def read_study(path: Path) -> "Study":
    """The study in a file; everything that is wrong with it is printed, and ends the program."""
    from labbook.study import StudyError, load

    try:
        return load(path)
    except StudyError as error:
        fail(error)


def analysed(path: Path, lab: Path, engine: str) -> "Analysis":
    """The analysis of a study's finished runs in the lab."""
    from rich.console import Console
    from rich.progress import Progress

    from labbook.catalogue import Catalogue, NoCatalogue
    from labbook.report.analysis import analyse

    study = read_study(path)
    try:
        finished = Catalogue(lab).finished(study, engine)
    except NoCatalogue as error:
        fail(error)
    if not finished:
        fail(f"{lab} has no finished run of {study.name} on {engine}; make some: labbook run {path} --lab {lab}")
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("measuring", total=len(finished))
        return analyse(study, finished, lambda done: progress.update(task, completed=done))
