"""Pages as HTML."""

from functools import cache
from typing import Any

from labbook.measure import MEASURES
from labbook.report.page import environment
from labbook.results import display
from labbook.version import __version__
from labbook_web.page import Links, Page, embedded


def html(page: Page, links: Links, **common: Any) -> str:
    """Render a page. `common`: variables of all pages, `read_only` and `lab`."""
    return (
        _templates()
        .get_template(page.template)
        .render(page=page, links=links, version=__version__, **{"read_only": True, "lab": "", **common}, **page.context)
    )


def fragment(template: str, links: Links, **context: Any) -> str:
    """Render a part of a page, which htmx inserts into an open one."""
    return _templates().get_template(template).render(links=links, **{"read_only": True, **context})


def _ago(iso: str) -> str:
    """Shorten a time to minutes: `2026-11-23 02:14`."""
    return iso.replace("T", " ")[:16]


def _size(size: int) -> str:
    amount = float(size)
    for unit in ("B", "kB", "MB"):
        if amount < 1000:
            return f"{amount:.3g} {unit}" if unit != "B" else f"{size} B"
        amount /= 1000
    return f"{amount:.3g} GB"


@cache
def _meanings() -> dict[str, str]:
    declared = [quantity for measure in MEASURES.values() for quantity in measure.declared]
    return {display.quantity(one.name, one.unit).heading: one.meaning for one in declared if one.meaning}


def meaning(heading: str) -> str:
    """Meaning of a measured quantity by its heading, such as `W [g/s]`; empty of another one."""
    return _meanings().get(heading, "")


@cache
def _templates():
    templates = environment("labbook_web")
    templates.filters |= {"embedded": embedded, "ago": _ago, "size": _size, "meaning": meaning}
    templates.filters["combined"] = lambda first, second: {**first, **second}
    return templates
