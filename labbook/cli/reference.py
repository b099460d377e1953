"""docs/commands.md, written from the help texts: `python -m labbook.cli.reference docs/commands.md`."""

import sys
from pathlib import Path

import typer.main
from typer.core import TyperGroup

from labbook.cli import build

WIDTH = 100  # of help texts, whatever the terminal


def markdown() -> str:
    """The page: one section a verb, each with the text that `labbook VERB --help` prints at 100 columns."""
    group = typer.main.get_command(build())
    assert isinstance(group, TyperGroup)
    top = group.make_context("labbook", [], resilient_parsing=True, max_content_width=WIDTH)
    parts = ["# Commands\n", "Written from the help texts by `make docs`.\n", _fenced(group, top)]
    for name in group.list_commands(top):
        command = group.get_command(top, name)
        assert command is not None
        context = command.make_context(name, [], parent=top, resilient_parsing=True, max_content_width=WIDTH)
        parts += [f"## labbook {name}\n", _fenced(command, context)]
        if not isinstance(command, TyperGroup):
            continue
        for kind in command.list_commands(context):
            inner = command.get_command(context, kind)
            assert inner is not None
            below = inner.make_context(kind, [], parent=context, resilient_parsing=True, max_content_width=WIDTH)
            parts += [f"### labbook {name} {kind}\n", _fenced(inner, below)]
    return "\n".join(parts)


def _fenced(command, context) -> str:
    context.terminal_width = WIDTH
    return f"```text\n{command.get_help(context).rstrip()}\n```\n"


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(markdown(), encoding="utf-8")
