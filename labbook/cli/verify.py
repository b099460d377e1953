"""`labbook verify`: checks of a backend that ship with labbook."""

from typing import Annotated

import typer

from labbook.cli.cases import AsJson, Listed, Names, On, Precision, Tried, find_cases
from labbook.cli.screen import screen


def register(app: typer.Typer) -> None:
    """Add the command to the app."""

    @app.command()
    def verify(
        names: Names = None,
        backend: Tried = "numba",
        precision: Precision = "double",
        device: On = "cpu",
        quick: Annotated[bool, typer.Option("--quick", help="Leave out cases that take more than 10 s.")] = False,
        list_: Listed = False,
        json: AsJson = False,
    ) -> None:
        """Check a backend against analytical solutions, conservation laws, symmetries and independent integration.

        Exit status 1 if a check fails.
        """
        from labbook.checks.verify.cases import select_cases
        from labbook.checks.verify.show import list_cases, run_cases

        cases = find_cases("verify", select_cases, names, quick)
        if list_:
            list_cases(cases, json, screen())
        elif not run_cases(cases, backend, precision, device, json, screen()):
            raise typer.Exit(1)
