"""`labbook doctor`: what is installed, and which backends work here."""

import json
from pathlib import Path
from typing import Annotated

import typer

from labbook.cli.options import BACKEND, Backend, fail, read_study
from labbook.cli.screen import saying


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def doctor(
        as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
        kernel: Annotated[
            Path | None,
            typer.Option(
                metavar="STUDY", help="Print the module of kernels that this study needs instead.", show_default=False
            ),
        ] = None,
        point: Annotated[int, typer.Option(min=1, help="With --kernel: of this point, counted from 1.")] = 1,
        backend: Backend = BACKEND,
    ) -> None:
        """Tell what is installed, and let every backend work a little on each device. Exit status 1 if none works."""
        from labbook.doctor import examine

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


def _kernel(study: Path, point: int, backend: str) -> str:
    from labbook.backend import BackendMissing, Unsupported, load
    from labbook.doctor import NoKernel
    from labbook.doctor import kernel as of
    from labbook.run.demand import Conflict

    try:
        return of(load(backend), read_study(study), point)
    except (BackendMissing, NoKernel, Unsupported, Conflict) as error:
        fail(error)


def _show(found) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console()
    console.print(f"labbook {found.version}, Python {found.hardware['python']} on {found.hardware['processor']}")
    console.print(f"GPU and driver: {found.hardware['gpu'] or 'none found'}")
    for backend, versions in found.versions.items():
        console.print(f"{backend}: " + ", ".join(f"{what} {version}" for what, version in versions.items()))
    packages = Table("package", "version", "needed for")
    for package in found.packages:
        packages.add_row(package.name, package.version or "not installed", package.purpose)
    console.print(packages)
    backends = Table("backend", "device", "what it is", "works", "precisions", "laws", "note")
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
