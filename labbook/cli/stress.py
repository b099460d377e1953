"""`labbook stress`: attempts to break a backend, which ship with labbook."""

from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the verb."""

    @app.command()
    def stress(
        names: Annotated[list[str] | None, typer.Argument(help="Cases, or how their names begin; none: all.")] = None,
        backend: Annotated[str, typer.Option(help="Backend to stress.")] = "numba",
        precision: Annotated[str, typer.Option(help="Precision to stress it in.")] = "double",
        device: Annotated[str, typer.Option(help="Device to stress it on.")] = "cpu",
        quick: Annotated[bool, typer.Option("--quick", help="Leave out cases that take more than 30 s.")] = False,
        list_: Annotated[bool, typer.Option("--list", help="Say what the cases do; run nothing.")] = False,
        json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
    ) -> None:
        """Try to break a backend: extreme time steps, stiffnesses, speeds, sizes and geometries.

        Every case ends right or with a named error; exit status 1 if one does not.
        """
        from labbook.stress.bounded import Bench
        from labbook.stress.cases import chosen
        from labbook.stress.show import list_cases, run_cases

        try:
            cases = [case for case in chosen(names or []) if not (quick and case.slow)]
        except KeyError as name:
            typer.echo(f"no case is called {name.args[0]}; labbook stress --list shows them", err=True)
            raise typer.Exit(2) from None
        if list_:
            list_cases(cases, json)
        elif not run_cases(cases, Bench(backend, precision, device), json):
            raise typer.Exit(1)
