"""Output on a terminal: text of files and studies without control characters, tables, and progress."""

import codecs
import io
import os
import sys
import unicodedata
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from labbook.report.tables import Table

_LAYOUT = frozenset("\n\t")
_STEERING = frozenset(["Cc", "Cs"])  # control characters, and halves of others, which no terminal can be sent
_TURNING = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")  # change the order of what follows
_BESIDE = 3
"""Columns of a terminal between two of a table."""


WIDE = 10_000
"""Columns of what is no terminal: each row of a table is one line, for grep and awk, and nothing is cut off."""
_PLAIN = {
    **dict.fromkeys("–—−‐‑", "-"), **dict.fromkeys("’‘′", "'"), **dict.fromkeys("“”", '"'), "±": "+-", "∞": "inf",
    "×": "x", "·": "*", "÷": "/", "≤": "<=", "≥": ">=", "≈": "~", "≠": "!=", "⟨": "<", "⟩": ">", "…": "...", "•": "*",
    "°": " deg", "√": "sqrt", "∫": "int", "→": "->", "←": "<-", "µ": "u", "ß": "ss", "ø": "o", "Ø": "O", "ł": "l",
    "Ł": "L", "æ": "ae", "Æ": "AE", "\u00a0": " ", "\u2009": " ", "\u202f": " ",
}  # fmt: skip
_PLAINLY = "labbook-plainly"
_RAISED = frozenset("⁰¹²³⁴⁵⁶⁷⁸⁹⁺⁻")


def show_anywhere() -> None:
    """Let standard output and error replace what their encoding lacks (− by -, ± by +-), and never fail on it."""
    codecs.register_error(_PLAINLY, _replacing)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_PLAINLY)


def _replacing(error: UnicodeError) -> tuple[str, int]:
    """An error handler of codecs (see `codecs.register_error`)."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return plain(error.object[error.start : error.end]), error.end


def plain(text: str) -> str:
    """Text in ASCII: signs as one types them, Greek letters by their names, others without accents, the rest as ?."""
    ascii_text, raised = "", False
    for sign in text:
        power = sign in _RAISED
        ascii_text += ("^" if power and not raised else "") + _plain(sign)
        raised = power
    return ascii_text


@lru_cache(maxsize=4096)
def _plain(character: str) -> str:
    if character.isascii():
        return character
    if character in _PLAIN:
        return _PLAIN[character]
    name = unicodedata.name(character, "")
    if name.startswith("GREEK ") and " LETTER " in name and " WITH " not in name:
        letter = name.rpartition(" LETTER ")[2].removeprefix("FINAL ").lower()
        return letter.capitalize() if "CAPITAL" in name else letter
    bare = "".join(one for one in unicodedata.normalize("NFKD", character) if not unicodedata.combining(one))
    bare = bare.replace("\N{MINUS SIGN}", "-")
    return bare if bare and bare.isascii() else "?"


def printable(text: object) -> str:
    """Text without characters that a terminal would obey: each is shown as \N{REPLACEMENT CHARACTER}."""
    return "".join("\N{REPLACEMENT CHARACTER}" if _steers(one) else one for one in str(text))


@lru_cache(maxsize=4096)
def _steers(character: str) -> bool:
    if character in _LAYOUT:
        return False
    return unicodedata.category(character) in _STEERING or character in _TURNING


def say(text: object, *, err: bool = False) -> None:
    """Print a line."""
    stream = sys.stderr if err else sys.stdout
    typer.echo(encodable(printable(text), getattr(stream, "encoding", None) or "utf-8"), err=err)


def screen(**options: Any):
    """A console of rich that prints all text as `printable` has it, in lines that are not broken where it is no
    terminal, unless COLUMNS says otherwise. `options`: its own."""
    from rich.console import Console

    class Screen(Console):
        def render_str(self, text: str, **how: Any):
            return super().render_str(encodable(printable(text), self.encoding), **how)

    console = Screen(**options)
    if "width" not in options and not console.is_terminal and not os.environ.get("COLUMNS", "").isdigit():
        console.width = WIDE
    return console


def encodable(text: str, encoding: str) -> str:
    """Text with what an encoding lacks replaced, before columns are measured by it."""
    try:
        return text.encode(encoding, _PLAINLY).decode(encoding)
    except LookupError:  # no such encoding, or `show_anywhere` was not asked for
        return text


@contextmanager
def saying(activity: str) -> Iterator[Callable[[str], None]]:
    """Show the present activity on standard error: in one line that changes on a terminal, elsewhere line by line with
    the time since the beginning.

    Yields:
        A function to call with the next activity.
    """
    import time

    from labbook.scene.quantities import duration

    console, begun = screen(stderr=True, markup=False), time.monotonic()
    if console.is_terminal:
        with console.status(activity) as status:
            yield status.update
        return

    def step(text: str) -> None:
        say(f"{duration(time.monotonic() - begun):>6}: {text}", err=True)

    step(activity)
    yield step


@contextmanager
def ticking(title: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar on a terminal: a function to call with how many of how many are done."""
    from rich.progress import Progress

    console = screen(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(title, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


def print_table(console: "Console", table: "Table", title: str) -> None:
    """Print a table of a report with its title and notes; marked rows are bold. No number is cut off: where there is no
    room for all beside each other, they wrap between value and error, and text between words."""
    from rich import box
    from rich.cells import cell_len
    from rich.markup import escape
    from rich.table import Table as RichTable

    rich_table = RichTable(title=escape(title), title_justify="left", box=box.SIMPLE_HEAD)
    columns = list(zip(table.headings, *table.rows, strict=True))
    whole = [max(map(cell_len, cells)) for cells in columns]
    words = [max(map(cell_len, " ".join(cells).split()), default=0) for cells in columns]
    spare = console.width - _BESIDE * len(columns) - 1 - sum(words)
    widths: list[int | None] = [None] * len(columns)
    if spare >= 0:
        lacks = [most - least for most, least in zip(whole, words, strict=True)]
        order = sorted(range(len(columns)), key=lambda k: (k in table.text, lacks[k]))
        for rank, k in enumerate(order):  # numbers come first; of text what lacks least, so that the longest share
            grant = min(lacks[k], spare // (len(order) - rank) if k in table.text else spare)
            widths[k] = words[k] + grant
            spare -= grant
    for k, heading in enumerate(table.headings):
        justify = "left" if k in table.text else "right"
        rich_table.add_column(escape(heading), justify=justify, overflow="fold", width=widths[k])
    for rank, row in enumerate(table.rows):
        rich_table.add_row(*map(escape, row), style="bold" if rank in table.marked else None)
    console.print(rich_table)
    for note in table.notes:
        console.print(note, style="dim", markup=False)
