"""`labbook stress`: attempts to break a backend, which ship with labbook."""

from typing import Annotated

import typer

from labbook.cli.cases import AsJson, Listed, Names, On, Precision, Tried, find_cases
from labbook.cli.screen import screen


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command()
    def stress(
        names: Names = None,
        backend: Tried = "numba",
        precision: Precision = "double",
        device: On = "cpu",
        quick: Annotated[bool, typer.Option("--quick", help="Leave out cases that take more than 30 s.")] = False,
        list_: Listed = False,
        json: AsJson = False,
    ) -> None:
        """Try to break a backend: extreme time steps, stiffnesses, speeds, sizes and geometries.

        Every case must give a correct result or a clear error; exit status 1 if one does not.
        """
        from labbook.checks.stress.bounded import NamedBackend
        from labbook.checks.stress.cases import select_cases
        from labbook.checks.stress.show import list_cases, run_cases

        cases = find_cases("stress", select_cases, names, quick)
        if list_:
            list_cases(cases, json, screen())
        elif not run_cases(cases, NamedBackend(backend, precision, device), json, screen(highlight=False)):
            raise typer.Exit(1)
