"""The command line: `labbook VERB`, one module a verb.

Each module of `VERBS` has `register(app)`, which adds its command; modules import what is heavy inside the command,
so that `labbook --help` stays quick.
"""

from importlib import import_module

import typer

VERBS = (
    "new",
    "plan",
    "run",
    "status",
    "runs",
    "show",
    "fit",
    "report",
    "export",
    "compare",
    "view",
    "doctor",
    "reindex",
    "import_",
    "verify",
    "bench",
)


def build() -> typer.Typer:
    """The application with all its verbs."""
    app = typer.Typer(
        name="labbook",
        help="Studies of granular silos, from a YAML file to a report with error bars.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )
    for verb in VERBS:
        import_module(f"labbook.cli.{verb}").register(app)
    return app


def main() -> None:
    """Entry point of the `labbook` command."""
    build()()
