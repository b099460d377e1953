"""Text on a terminal: what a file or a study says is shown, and steers nothing."""

import unicodedata
from functools import lru_cache
from typing import Any

import typer

_KEPT = frozenset("\n\t")
_STEERING = frozenset(["Cc", "Cs"])  # control characters, and halves of others, which no terminal can be sent
_TURNING = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")  # change the order of what follows


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
