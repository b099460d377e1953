"""Parts of a page: sections, and the blocks in them. The template draws every kind in one place.

Whoever adds to a report returns a Section of these blocks; neither the page nor the template has to know of it.
"""

import math
import re
from base64 import b64encode
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from labbook.report import style
from labbook.report.tables import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Prose:
    """A paragraph. `note`: in small print."""

    kind: ClassVar[str] = "prose"
    text: str
    note: bool = False


@dataclass(frozen=True)
class Formula:
    """A formula in the notation of `Law.formula`, typeset, and where it is from."""

    kind: ClassVar[str] = "formula"
    text: str
    source: str = ""


@dataclass(frozen=True)
class Picture:
    """A figure as the page holds it: a data URI, what it shows in words, its caption and its width (CSS)."""

    kind: ClassVar[str] = "picture"
    uri: str
    alt: str
    caption: str
    width: str


@dataclass(frozen=True)
class Facts:
    """Terms with what is to be said of them. `marked`: terms that ask for attention."""

    kind: ClassVar[str] = "facts"
    rows: tuple[tuple[str, str], ...]
    marked: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Verbatim:
    """Text as it is, such as a file."""

    kind: ClassVar[str] = "verbatim"
    text: str


@dataclass(frozen=True)
class Folded:
    """Blocks that the reader opens."""

    kind: ClassVar[str] = "folded"
    title: str
    blocks: tuple["Block", ...]


@dataclass(frozen=True)
class Beside:
    """Blocks in two columns, where there is room for two."""

    kind: ClassVar[str] = "beside"
    left: tuple["Block", ...]
    right: tuple["Block", ...]


@dataclass(frozen=True)
class Section:
    """A part of the page with a heading. A section within a section is a part of it. `anchor`: what links name; made
    of the title if not given."""

    kind: ClassVar[str] = "section"
    title: str
    blocks: tuple["Block", ...]
    anchor: str = ""

    @property
    def subsections(self) -> tuple["Section", ...]:
        """The sections within."""
        return tuple(block for block in self.blocks if isinstance(block, Section))


Block = Prose | Formula | Picture | Table | Facts | Verbatim | Folded | Beside | Section


def picture(figure: "Figure", stem: Path, alt: str, caption: str) -> Picture:
    """Write a figure in all formats beside the page, and hold it for the page."""
    style.save(figure, stem)
    data = b64encode(stem.with_name(f"{stem.name}.svg").read_bytes()).decode("ascii")
    width = f"{math.ceil(figure.get_figwidth() / style.MILLIMETRE * 1.45)}mm"
    return Picture(f"data:image/svg+xml;base64,{data}", alt, caption, width)


def slug(text: str) -> str:
    """Small letters, digits and hyphens: for file names and anchors."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def anchored(sections: Sequence[Section], used: set[str] | None = None) -> tuple[Section, ...]:
    """The same sections, each with an anchor that no other has."""
    used = set() if used is None else used
    return tuple(_anchored(section, used) for section in sections)


def _anchored(section: Section, used: set[str]) -> Section:
    stem = section.anchor or slug(section.title) or "section"
    anchor = next(name for name in _numbered(stem) if name not in used)
    used.add(anchor)
    within = (_anchored(block, used) if isinstance(block, Section) else block for block in section.blocks)
    return replace(section, anchor=anchor, blocks=tuple(within))


def _numbered(name: str) -> Iterator[str]:
    yield name
    number = 2
    while True:
        yield f"{name}-{number}"
        number += 1
