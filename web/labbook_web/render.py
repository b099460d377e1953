"""Pages as HTML."""

from functools import cache
from typing import Any

from labbook.report.page import environment
from labbook.version import __version__
from labbook_web.page import Links, Page, embedded


def html(page: Page, links: Links, **common: Any) -> str:
    """A page with everything around it. `common`: `read_only`, `lab`: what all pages show."""
    return (
        _templates()
        .get_template(page.template)
        .render(page=page, links=links, version=__version__, **{"read_only": True, "lab": "", **common}, **page.shown)
    )


def part(template: str, links: Links, **shown: Any) -> str:
    """A part of a page, which a page that is open takes in."""
    return _templates().get_template(template).render(links=links, **{"read_only": True, **shown})


def _ago(iso: str) -> str:
    """When something was, short: `2026-11-23 02:14`."""
    return iso.replace("T", " ")[:16]


def _size(size: int) -> str:
    amount = float(size)
    for unit in ("B", "kB", "MB"):
        if amount < 1000:
            return f"{amount:.3g} {unit}" if unit != "B" else f"{size} B"
        amount /= 1000
    return f"{amount:.3g} GB"


@cache
def _templates():
    made = environment("labbook_web")
    made.filters |= {"embedded": embedded, "ago": _ago, "size": _size, "combined": lambda one, other: {**one, **other}}
    return made
