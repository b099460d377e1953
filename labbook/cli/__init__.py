"""The command line: `labbook COMMAND`, one module a command.

Each module of `COMMANDS` has `register(app)`, which adds its command. So that `labbook --help` stays quick, a command
imports other rooms in its body, or is a call of its module in `labbook.cli.work`, which imports them at its top: the
form for a command with several functions. Packages add commands by such functions, which they announce in the
entry-point group `labbook.verbs`.
"""

import gc
import sys
from importlib import import_module
from importlib.metadata import entry_points
from typing import Annotated

import typer
from typer.core import TyperGroup

from labbook.cli.options import explanation, fail
from labbook.cli.screen import say, show_anywhere
from labbook.version import __version__

_ALLOCATED = 10_000
"""Objects that are made between two looks for garbage."""
COMMANDS = (
    "new",
    "new_extension",
    "plan",
    "run",
    "pilot",
    "calibrate",
    "status",
    "runs",
    "show",
    "fit",
    "report",
    "export",
    "cite",
    "compare",
    "view",
    "movie",
    "doctor",
    "reindex",
    "import_",
    "slurm",
    "cluster",
    "verify",
    "stress",
    "bench",
)


class CommandGroup(TyperGroup):
    """All verbs; what goes wrong with files and folders ends each of them in one line, as `told` has it."""

    def main(self, *args, **kwargs):
        """Carry out a command line, whatever characters the terminal has."""
        show_anywhere()
        return super().main(*args, **kwargs)

    def invoke(self, ctx):
        """Carry out the verb that was asked for."""
        try:
            return super().invoke(ctx)
        except (typer.Exit, typer.Abort):
            raise
        except Exception as error:
            line = explanation(error)
            if line is None:
                raise
            fail(line)


def _show_version(requested: bool) -> None:
    if requested:
        say(f"labbook {__version__}")
        raise typer.Exit()


def _about(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_show_version, is_eager=True)
    ] = False,
) -> None:
    """Options of `labbook` itself, which their callbacks carry out."""


def build() -> typer.Typer:
    """The application with all its commands."""
    app = typer.Typer(
        name="labbook",
        cls=CommandGroup,
        help="Studies of granular silos, from a YAML file to a report with error bars.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )
    app.callback()(_about)
    for name in COMMANDS:
        import_module(f"labbook.cli.{name}").register(app)
    for entry in sorted(entry_points(group="labbook.verbs"), key=lambda entry: entry.name):
        try:
            entry.load()(app)
        except Exception as error:  # whatever a package does when it is imported: other commands stay
            problem = f"{entry.value} ({type(error).__name__}: {error}); fix or uninstall the package"
            print(f"Warning: the verb {entry.name} cannot be loaded: {problem}", file=sys.stderr)
    return app


def main() -> None:
    """Entry point of the `labbook` command."""
    show_anywhere()
    # points and runs live as long as the process: to look through them for garbage so often takes a sixth of a plan
    gc.set_threshold(_ALLOCATED, *gc.get_threshold()[1:])
    build()()
