"""`labbook verify`: checks of a backend that ship with labbook."""

from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def verify(
        names: Annotated[list[str] | None, typer.Argument(help="Cases, or how their names begin; none: all.")] = None,
        backend: Annotated[str, typer.Option(help="Backend to check.")] = "numba",
        precision: Annotated[str, typer.Option(help="Precision to check it in.")] = "double",
        device: Annotated[str, typer.Option(help="Device to check it on.")] = "cpu",
        quick: Annotated[bool, typer.Option("--quick", help="Leave out cases that take more than 10 s.")] = False,
        list_: Annotated[bool, typer.Option("--list", help="Say what the cases check; run nothing.")] = False,
        json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
    ) -> None:
        """Check a backend against analysis, conservation laws, symmetries and independent integration.

        Exit status 1 if a check fails.
        """
        from labbook.verify.cases import chosen
        from labbook.verify.show import list_cases, run_cases

        try:
            cases = [case for case in chosen(names or []) if not (quick and case.slow)]
        except KeyError as name:
            typer.echo(f"no case is called {name.args[0]}; labbook verify --list shows them", err=True)
            raise typer.Exit(2) from None
        if list_:
            list_cases(cases, json)
        elif not run_cases(cases, backend, precision, device, json):
            raise typer.Exit(1)
