"""Small tables in HTML, by which a notebook shows what Python hands out."""

import re
from collections.abc import Iterable, Sequence
from html import escape


def table(headings: Sequence[str], rows: Iterable[Sequence[str]], notes: Sequence[str] = ()) -> str:
    """A table of texts that a notebook styles itself, with lines of notes below; a superscript is written ^(...)."""

    def cells(row: Sequence[str], tag: str) -> str:
        return "".join(f"<{tag}>{_raised(text)}</{tag}>" for text in row)

    head = f"<thead><tr>{cells(headings, 'th')}</tr></thead>" if headings else ""
    body = "".join(f"<tr>{cells(row, 'td')}</tr>" for row in rows)
    return f"<table>{head}<tbody>{body}</tbody></table>{lines(notes)}"


def lines(texts: Iterable[str]) -> str:
    """Texts, one below the other."""
    return "".join(f"<div>{_raised(text)}</div>" for text in texts)


def titled(title: str, *parts: str) -> str:
    """A title above parts that are HTML already."""
    return f"<div><b>{escape(title)}</b></div>{''.join(parts)}"


def _raised(text: str) -> str:
    return re.sub(r"\^\(([^)]*)\)", r"<sup>\1</sup>", escape(text))
