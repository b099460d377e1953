"""Arguments that several verbs share, and how their mistakes are told."""

import errno
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from labbook.cli.screen import say
from labbook.commands import DEFAULT_BACKEND, command
from labbook.plugins import BrokenPlugin, blamed

if TYPE_CHECKING:
    from labbook.api import Results
    from labbook.lab import Catalogue
    from labbook.study import Study

StudyFile = Annotated[Path, typer.Argument(help="Study file (YAML).", metavar="STUDY", show_default=False)]


def _expanded(lab: Path) -> Path:
    """With the home folder in place of `~`, which shells leave in `--lab=~/lab`."""
    from labbook.study.source import given_path

    try:
        return given_path(lab, "--lab")
    except ValueError as problem:
        raise typer.BadParameter(str(problem)) from None


Lab = Annotated[Path, typer.Option("--lab", envvar="LABBOOK_LAB", help="Lab folder.", callback=_expanded)]
Backend = Annotated[str, typer.Option("--backend", help="Backend that made the runs: numba or warp.")]
RunsOn = Annotated[str, typer.Option("--backend", help="Backend to run on: numba (CPU) or warp (GPU).")]
Device = Annotated[str, typer.Option("--device", help="Device to run on, such as cpu or cuda:0; several: cuda:all.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]

LAB = Path("lab")
BACKEND = DEFAULT_BACKEND
STOPPED = 130
"""Exit status of what was asked to stop, as shells give it for Ctrl-C."""
GO_ON = "the same command goes on from here"


def fail(message: object) -> NoReturn:
    """End with exit status 1 and the message on standard error."""
    say(f"Error: {message}", err=True)
    raise typer.Exit(1)


def leave(status: int) -> NoReturn:
    """End the process now, whatever its threads are doing: they may be compiling or in the middle of a long beat."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # the terminal is gone, or the stream is closed
            stream.flush()
    os._exit(status)


def explanation(error: Exception) -> str | None:
    """Meaning of an error of the storage or of an extension, and the remedy, in a line; None for any other error."""
    if isinstance(error, BrokenPlugin):
        return str(error)
    if "labbook.stats.emulator" in sys.modules:
        from labbook.stats.emulator import LearnMissing

        if isinstance(error, LearnMissing):
            return str(error)
    if isinstance(error, OSError):
        return _of_files(error) if error.errno not in (None, errno.EPIPE) else None
    if "labbook.lab" in sys.modules:
        from labbook.lab import LabError, Unreadable

        if isinstance(error, Unreadable):
            return f"{error}; labbook run makes it again, and labbook reindex lists all damaged files"
        if isinstance(error, LabError):
            return str(error)
    of_extension = blamed(error)
    return None if of_extension is None else str(of_extension)


_REMEDIES = {
    errno.ENOSPC: "free some disk space and give the same command again; finished runs are safe",
    errno.EDQUOT: "free some disk space and give the same command again; finished runs are safe",
    errno.EACCES: "get permission to read and write it, or use another folder",
    errno.EPERM: "get permission to read and write it, or use another folder",
    errno.EROFS: "it cannot be written: use a copy of the lab, or another folder",
    errno.ENOTDIR: "there is a file where a folder is needed: use another folder, or move the file",
    errno.EEXIST: "there is a file where a folder is needed: use another folder, or move the file",
    errno.EISDIR: "there is a folder where a file is needed: move the folder away",
}


def _of_files(error: OSError) -> str:
    where = " and ".join(str(path) for path in (error.filename, error.filename2) if path is not None)
    problem = f"{where}: {error.strerror}" if where else str(error.strerror)
    remedy = _REMEDIES.get(error.errno or 0, "check the disk and the folder, and give the same command again")
    return f"{problem[0].lower() if not where else problem[0]}{problem[1:]}; {remedy}"


def read_study(path: Path) -> "Study":
    """The study in a file; everything that is wrong with it is printed, and ends the program."""
    from labbook.study import StudyError, load

    try:
        return load(path)
    except StudyError as error:
        fail(error)


def existing(lab: Path) -> "Catalogue":
    """The catalogue of a lab that is there; if there is none, that is said, and ends the program."""
    from labbook.lab import Catalogue, LabFolder

    if not lab.exists():
        fail(f"there is no lab {lab}; give its folder with --lab, or make one: {command('run', 'STUDY', lab=lab)}")
    if lab.is_dir() and not LabFolder(lab).exists:
        fail(f"{lab} is not a lab: it has neither runs nor packings; give another folder with --lab")
    return Catalogue(lab)


def results(path: Path, lab: Path, backend: str) -> "Results":
    """Read the results of a study. Unreadable runs are named and left out; measures that fail are named."""
    import warnings

    from labbook.api import Lab as OpenLab
    from labbook.api import LabWarning

    study = read_study(path)
    existing(lab)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LabWarning)  # told below
        results_of_study = OpenLab(lab, backend).results(study)
    if not results_of_study.points and not results_of_study.unreadable:
        fail(
            f"{lab} has no finished run of {study.name} on {backend}; {instead_of_none(study.name, path, lab, backend)}"
        )
    for title, problems in (("Left out", results_of_study.unreadable), ("Not measured", results_of_study.unmeasured)):
        for problem in problems[:_PROBLEMS]:
            say(f"{title}: {problem}", err=True)
        if len(problems) > _PROBLEMS:
            say(f"{title}: {len(problems) - _PROBLEMS} more", err=True)
    if results_of_study.unreadable:
        say(f"Make what cannot be read again: {again(path, lab, backend)}", err=True)
    if not results_of_study.points:
        fail(f"no finished run of {study.name} on {backend} in {lab} can be read; make them again: "
             f"{again(path, lab, backend)}")  # fmt: skip
    return results_of_study


_PROBLEMS = 20
"""Runs with a problem that are named one by one."""


def again(study: Path | str, lab: Path, backend: str) -> str:
    """The command that makes the runs of a study."""
    return command("run", study, lab=lab, backend=backend)


def instead_of_none(name: str, path: Path | str, lab: Path, backend: str) -> str:
    """Remedy where a lab has no run of a study from a backend: another backend, or the command that makes the runs."""
    from labbook.backend.registry import installed
    from labbook.lab import Catalogue

    there = sorted({*Catalogue(lab).runs(name)["backend"]} - {backend, ""})
    if there:
        return f"it has runs on {' and '.join(there)}: add --backend {there[0]}"
    if backend not in installed():
        return f"there is no backend {backend}; installed are {', '.join(sorted(installed()))}"
    return f"make some: {again(path, lab, backend)}"
