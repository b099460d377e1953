"""Options and output that `verify` and `stress` share: verbs that try cases on a backend."""

from collections.abc import Callable, Sequence
from typing import Annotated, Any

import typer

from labbook.cli.screen import say

Names = Annotated[list[str] | None, typer.Argument(help="Names of cases, or how they begin; none: all cases.")]
Tried = Annotated[str, typer.Option("--backend", help="Backend to test.")]
Precision = Annotated[str, typer.Option("--precision", help="Precision to test.")]
On = Annotated[str, typer.Option("--device", help="Device to test on.")]
Listed = Annotated[bool, typer.Option("--list", help="List the cases and what they check; run nothing.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON, when all cases have ended.")]


def find_cases(
    command: str, by_names: Callable[[list[str]], Sequence[Any]], names: list[str] | None, quick: bool
) -> list:
    """The cases with these names, without the slow ones if `quick`; ends with exit status 2 if there is none."""
    try:
        return [case for case in by_names(names or []) if not (quick and case.slow)]
    except KeyError as name:
        say(f"no case is called {name.args[0]}; labbook {command} --list shows them", err=True)
        raise typer.Exit(2) from None
