"""Published sources of what labbook computes, read from `sources.toml`, the one place for bibliographic data.

The tables say which of the publications stand behind contact laws, measures, fits of papers, starts of a filling and
methods. Laws of flow and references name theirs in words; `named_in` finds them.
"""

import re
import tomllib
import unicodedata
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any


@dataclass(frozen=True)
class Source:
    """A publication or a program, with the data that a list of references needs. Empty fields are not known.

    `authors`: initials and surname of each (`J. Fan`), or the name of a group; `pages`: a range, the first page or the
    number of an article; `version`: of a program.
    """

    key: str
    title: str
    authors: tuple[str, ...] = ()
    year: int | None = None
    journal: str = ""
    volume: str = ""
    pages: str = ""
    doi: str = ""
    publisher: str = ""
    version: str = ""

    @property
    def text(self) -> str:
        """The source as a line of a list of references."""
        authors = " and ".join(filter(None, (", ".join(self.authors[:-1]), *self.authors[-1:])))
        title = f"{self.title}, version {self.version}" if self.version else self.title
        year = "" if self.year is None else str(self.year)
        if self.journal:
            journal_text = " ".join(filter(None, (self.journal, self.volume, year and f"({year})", self.pages)))
        else:
            journal_text = ", ".join(filter(None, (self.publisher, year)))
        parts = [part if part.endswith(".") else f"{part}." for part in (authors, title, journal_text) if part]
        return " ".join([*parts, *([f"https://doi.org/{self.doi}"] if self.doi else [])])

    @property
    def plain(self) -> dict[str, Any]:
        """Known fields as plain values."""
        return {name: list(value) if name == "authors" else value for name, value in vars(self).items() if value}

    @property
    def bibtex(self) -> str:
        """The source as an entry of a BibTeX file, in ASCII where LaTeX has a command for a letter."""
        kind = "article" if self.journal else "book" if self.publisher else "misc"
        # a group is braced as a whole, since BibTeX would look for its surname
        authors = [latex(one) if "." in one else f"{{{latex(one)}}}" for one in self.authors]
        fields = {
            "author": " and ".join(authors),
            "title": f"{{{latex(self.title)}}}",
            "journal": latex(self.journal),
            "volume": self.volume,
            "pages": self.pages.replace("–", "--"),
            "publisher": latex(self.publisher),
            "year": "" if self.year is None else str(self.year),
            "doi": self.doi,
            "note": f"Software, version {latex(self.version)}" if self.version else "",
        }
        lines = [f"  {name} = {{{value}}}," for name, value in fields.items() if value and value != "{}"]
        return "\n".join([f"@{kind}{{{self.key},", *lines, "}"])


_ACCENTS = {"\u0300": "`", "\u0301": "'", "\u0302": "^", "\u0303": "~", "\u0308": '"', "\u030b": "H ", "\u030c": "v "}
_LETTERS = {"ł": r"{\l}", "Ł": r"{\L}", "ø": r"{\o}", "Ø": r"{\O}", "ß": r"{\ss}", "–": "--", "—": "---", "’": "'"}
_SPECIAL = {one: f"\\{one}" for one in "&%$#_"} | {
    # BibTeX counts braces even behind a backslash
    "{": r"\textbraceleft{}",
    "}": r"\textbraceright{}",
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
}


def latex(text: str) -> str:
    """Text as LaTeX reads it: special characters and accents as commands, line breaks as spaces."""
    return "".join(map(_latex, unicodedata.normalize("NFC", " ".join(text.split()))))


def _latex(letter: str) -> str:
    if letter in _SPECIAL or letter in _LETTERS:
        return _SPECIAL.get(letter) or _LETTERS[letter]
    parts = unicodedata.normalize("NFD", letter)
    if len(parts) == 2 and parts[1] in _ACCENTS:
        return f"{{\\{_ACCENTS[parts[1]]}{parts[0]}}}"
    return letter


def folded(text: str) -> str:
    """Text in lower case without accents: `Pongó` and `Pongo` are the same."""
    apart = unicodedata.normalize("NFD", text)
    return "".join(letter for letter in apart if not unicodedata.combining(letter)).casefold()


_DATA = tomllib.loads(files("labbook").joinpath("sources.toml").read_text(encoding="utf-8"))


def _source(key: str, authors: Iterable[str] = (), **fields: Any) -> Source:
    return Source(key, authors=tuple(authors), **fields)


def _sources_behind(part: str) -> Mapping[str, tuple[str, ...]]:
    """Keys of sources of each name in one table `behind` of sources.toml."""
    return {name: tuple(keys) for name, keys in _DATA["behind"][part].items()}


SOURCES: Mapping[str, Source] = {key: _source(key, **fields) for key, fields in _DATA["sources"].items()}
"""All publications, by key."""
CONTACT_LAWS = _sources_behind("contact_laws")
"""Keys of the sources of contact laws."""
ROLLING_MODELS = _sources_behind("rolling_models")
"""Keys of the sources of models of rolling friction."""
MEASURES = _sources_behind("measures")
"""Keys of the sources of measures; none for definitions of labbook's own."""
PAPER_FITS = _sources_behind("paper_fits")
"""Keys of the sources of fits that papers add. Laws of flow name theirs as `source`."""
STARTS = _sources_behind("starts")
"""Keys of the sources of starts of a filling; none for those of labbook's own."""
METHODS = _sources_behind("methods")
"""Keys of the sources of methods that a study uses without naming them."""

_YEAR = re.compile(r"\b(?:1[89]|20)\d\d\b")


def named_in(text: str) -> tuple[Source, ...]:
    """The sources that a text names, by the surname of the first author and the year behind it.

    Parts between semicolons are read one by one. A part with a year that names none of `SOURCES` is a source by
    itself, with the part as its title; so is a text that names none at all.
    """
    sources: dict[str, Source] = {}
    for part in filter(None, (part.strip() for part in text.split(";"))):
        matches = [one for one in SOURCES.values() if _names(folded(part), one)]
        if not matches and _YEAR.search(part):
            matches = [_of_text(part)]
        sources |= {one.key: one for one in matches}
    return tuple(sources.values()) or (_of_text(text),)


def _names(part: str, source: Source) -> bool:
    """True if a text has the surname and the year of a source."""
    surname = folded(source.authors[0]).split()[-1]
    return re.search(rf"\b{re.escape(surname)}\b.*?\b{source.year}\b", part, re.DOTALL) is not None


def _of_text(text: str) -> Source:
    """A source of which only a text is known; its key is made of the text."""
    title = " ".join(text.split())
    words = re.findall(r"[a-z0-9]+", folded(title))
    return Source("-".join(words[:6]) or "source", title)
