"""`labbook doctor`: what is installed, and which engines work here."""

import json
from typing import Annotated

import typer

from labbook.cli.lab import saying


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def doctor(
        as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    ) -> None:
        """Tell what is installed, and let every engine work a little on each device. Exit status 1 if none works."""
        from labbook.doctor import examine

        with saying("looking around") as say:
            found = examine(say)
        if as_json:
            print(json.dumps(found.as_dict(), indent=2))
        else:
            _show(found)
        if not any(engine.works for engine in found.engines):
            raise typer.Exit(1)


def _show(found) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console()
    console.print(f"labbook {found.version}, Python {found.hardware['python']} on {found.hardware['processor']}")
    console.print(f"GPU and driver: {found.hardware['gpu'] or 'none found'}")
    for engine, versions in found.versions.items():
        console.print(f"{engine}: " + ", ".join(f"{what} {version}" for what, version in versions.items()))
    packages = Table("package", "version", "needed for")
    for package in found.packages:
        packages.add_row(package.name, package.version or "not installed", package.purpose)
    console.print(packages)
    engines = Table("engine", "device", "what it is", "works", "precisions", "laws", "note")
    for engine in found.engines:
        engines.add_row(
            engine.name,
            engine.device,
            engine.what,
            "yes" if engine.works else "no",
            ", ".join(engine.precisions),
            ", ".join(engine.laws),
            escape(engine.note),  # which may name an extra in brackets
        )
    console.print(engines)
