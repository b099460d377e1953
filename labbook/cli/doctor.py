"""`labbook doctor`: what is installed, which backends work here, and whether a folder can hold a lab."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from labbook.cli.options import BACKEND, Backend, fail, read_study
from labbook.cli.screen import saying, screen

if TYPE_CHECKING:
    from labbook.checks.disk import Check


def register(app: typer.Typer) -> None:
    """Add the verb."""

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
        """List what is installed, and test every backend shortly on each device. Exit status 1 if none works.

        With --lab, test the file system of a folder: free space, locks between two processes, atomic rename, fsync,
        its clock, and the index. With --lab and --peer, wait for the same command with the same folder on another
        host, then test locks, rename, clocks and index between the two. Exit status 1 if a test fails.
        """
        from labbook.checks.doctor import examine

        if lab is not None:
            _examine_lab(lab, peer, as_json)
            return
        if peer:
            fail("--peer needs --lab PATH: the folder that both hosts share")
        if kernel is not None:
            typer.echo(_kernel(kernel, point, backend), nl=False)
            return
        with saying("looking around") as say:
            found = examine(say)
        if as_json:
            print(json.dumps(found.as_dict(), indent=2))
        else:
            _show(found)
        if not any(backend.works for backend in found.backends):
            raise typer.Exit(1)


def _examine_lab(lab: Path, peer: bool, as_json: bool) -> None:
    from labbook.checks import disk

    if not lab.is_dir():
        fail(f"{lab}: no such folder; create it first")
    with saying("free space") as say:
        checks = disk.examine(lab, say)
        if peer:
            checks += disk.meet(lab, say)
    if as_json:
        print(json.dumps([asdict(check) for check in checks], indent=2))
    else:
        _show_checks(lab, checks)
    if not all(check.works for check in checks):
        raise typer.Exit(1)


def _show_checks(lab: Path, checks: "list[Check]") -> None:
    from rich.markup import escape
    from rich.table import Table

    shown = Table("test", "works", "note", title=escape(str(lab)), title_justify="left")
    for check in checks:
        style = None if check.works else "bold red"
        shown.add_row(check.name, "yes" if check.works else "no", escape(check.note), style=style)
    screen().print(shown)


def _kernel(study: Path, point: int, backend: str) -> str:
    from labbook.backend import BackendMissing, Unsupported, load
    from labbook.checks.doctor import NoKernel
    from labbook.checks.doctor import kernel as of
    from labbook.plan.demand import Conflict

    try:
        return of(load(backend), read_study(study), point)
    except (BackendMissing, NoKernel, Unsupported, Conflict) as error:
        fail(error)


def _show(found) -> None:
    from rich.markup import escape
    from rich.table import Table

    console = screen()
    console.print(f"labbook {found.version}, Python {found.hardware['python']} on {found.hardware['processor']}")
    console.print(f"GPU and driver: {found.hardware['gpu'] or 'none found'}")
    for backend, versions in found.versions.items():
        console.print(f"{backend}: " + ", ".join(f"{what} {version}" for what, version in versions.items()))
    packages = Table("package", "version", "needed for")
    for package in found.packages:
        packages.add_row(package.name, package.version or "not installed", package.purpose)
    console.print(packages)
    backends = Table("backend", "device", "description", "works", "precisions", "laws", "note")
    for backend in found.backends:
        backends.add_row(
            backend.name,
            backend.device,
            backend.what,
            "yes" if backend.works else "no",
            ", ".join(backend.precisions),
            ", ".join(backend.laws),
            escape(backend.note),  # which may name an extra in brackets
        )
    console.print(backends)
