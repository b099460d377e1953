"""What is shown on a terminal: text of files and studies, which steers nothing, tables, and progress."""

import unicodedata
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from labbook.report.tables import Table

_KEPT = frozenset("\n\t")
_STEERING = frozenset(["Cc", "Cs"])  # control characters, and halves of others, which no terminal can be sent
_TURNING = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")  # change the order of what follows
_BESIDE = 3
"""Columns of a terminal between two of a table."""


def printable(text: object) -> str:
    """Text without characters that a terminal would obey: each is shown as \N{REPLACEMENT CHARACTER}."""
    return "".join("\N{REPLACEMENT CHARACTER}" if _steers(one) else one for one in str(text))


@lru_cache(maxsize=4096)
def _steers(character: str) -> bool:
    if character in _KEPT:
        return False
    return unicodedata.category(character) in _STEERING or character in _TURNING


def say(text: object, *, err: bool = False) -> None:
    """Print a line."""
    typer.echo(printable(text), err=err)


def screen(**options: Any):
    """A console of rich that prints all text as `printable` has it. `options`: its own."""
    from rich.console import Console

    class Screen(Console):
        def render_str(self, text: str, **how: Any):
            return super().render_str(printable(text), **how)

    return Screen(**options)


@contextmanager
def saying(what: str) -> Iterator[Callable[[str], None]]:
    """What is going on, on standard error: in one line that changes on a terminal, elsewhere line by line with the
    time since the beginning. Gives a function to call with the next."""
    import time

    from rich.console import Console

    from labbook.run.progress import duration

    console, begun = Console(stderr=True, markup=False), time.monotonic()
    if console.is_terminal:
        with console.status(what) as status:
            yield status.update
        return

    def say(text: str) -> None:
        typer.echo(f"{duration(time.monotonic() - begun):>6}: {text}", err=True)

    say(what)
    yield say


@contextmanager
def ticking(what: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar on a terminal: a function to call with how many of how many are done."""
    from rich.progress import Progress

    console = screen(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


def print_table(console: "Console", table: "Table", title: str) -> None:
    """Print a table of a report with its title and notes; marked rows are bold. No number is cut off: where there is no
    room for all beside each other, they wrap between value and error, and text between words."""
    from rich import box
    from rich.cells import cell_len
    from rich.markup import escape
    from rich.table import Table as Shown

    shown = Shown(title=escape(title), title_justify="left", box=box.SIMPLE_HEAD)
    columns = list(zip(table.headings, *table.rows, strict=True))
    whole = [max(map(cell_len, cells)) for cells in columns]
    words = [max(map(cell_len, " ".join(cells).split()), default=0) for cells in columns]
    spare = console.width - _BESIDE * len(columns) - 1 - sum(words)
    widths: list[int | None] = [None] * len(columns)
    if spare >= 0:
        lacks = [most - least for most, least in zip(whole, words, strict=True)]
        order = sorted(range(len(columns)), key=lambda k: (k in table.text, lacks[k]))
        for place, k in enumerate(order):  # numbers come first; of text what lacks least, so that the longest share
            grant = min(lacks[k], spare // (len(order) - place) if k in table.text else spare)
            widths[k] = words[k] + grant
            spare -= grant
    for k, heading in enumerate(table.headings):
        justify = "left" if k in table.text else "right"
        shown.add_column(escape(heading), justify=justify, overflow="fold", width=widths[k])
    for place, row in enumerate(table.rows):
        shown.add_row(*map(escape, row), style="bold" if place in table.marked else None)
    console.print(shown)
    for note in table.notes:
        console.print(note, style="dim", markup=False)
