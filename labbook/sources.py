"""Published sources of what labbook computes: the one place for bibliographic data.

`SOURCES` holds the publications by key. The tables below it say which of them stand behind contact laws, measures, fits
of papers, starts of a filling and methods. Laws of flow and references name theirs in words; `named_in` finds them.
"""

import re
import unicodedata
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
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
            place = " ".join(filter(None, (self.journal, self.volume, year and f"({year})", self.pages)))
        else:
            place = ", ".join(filter(None, (self.publisher, year)))
        parts = [part if part.endswith(".") else f"{part}." for part in (authors, title, place) if part]
        return " ".join([*parts, *([f"https://doi.org/{self.doi}"] if self.doi else [])])

    @property
    def plain(self) -> dict[str, Any]:
        """Its fields that are known, as plain values."""
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


def _by_key(sources: Iterable[Source]) -> Mapping[str, Source]:
    found: dict[str, Source] = {}
    for one in sources:
        if one.key in found:
            raise ValueError(f"two sources have the key {one.key}")
        found[one.key] = one
    return found


SOURCES = _by_key(
    (
        # contact laws
        Source(
            "hertz1882",
            "Ueber die Berührung fester elastischer Körper",
            ("H. Hertz",),
            1882,
            "Journal für die reine und angewandte Mathematik",
            "92",
            "156–171",
        ),
        Source(
            "mindlin1953",
            "Elastic spheres in contact under varying oblique forces",
            ("R. D. Mindlin", "H. Deresiewicz"),
            1953,
            "Journal of Applied Mechanics",
            "20",
            "327–344",
        ),
        Source(
            "cundall1979",
            "A discrete numerical model for granular assemblies",
            ("P. A. Cundall", "O. D. L. Strack"),
            1979,
            "Géotechnique",
            "29",
            "47–65",
            "10.1680/geot.1979.29.1.47",
        ),
        Source(
            "tsuji1992",
            "Lagrangian numerical simulation of plug flow of cohesionless particles in a horizontal pipe",
            ("Y. Tsuji", "T. Tanaka", "T. Ishida"),
            1992,
            "Powder Technology",
            "71",
            "239–250",
            "10.1016/0032-5910(92)88030-L",
        ),
        Source(
            "schwager2007",
            "Coefficient of restitution and linear–dashpot model revisited",
            ("T. Schwager", "T. Pöschel"),
            2007,
            "Granular Matter",
            "9",
            "465",
        ),
        Source(
            "ai2011",
            "Assessment of rolling resistance models in discrete element simulations",
            ("J. Ai", "J.-F. Chen", "J. M. Rotter", "J. Y. Ooi"),
            2011,
            "Powder Technology",
            "206",
            "269–282",
            "10.1016/j.powtec.2010.09.030",
        ),
        Source(
            "kloss2012",
            "Models, algorithms and validation for opensource DEM and CFD–DEM",
            ("C. Kloss", "C. Goniva", "A. Hager", "S. Amberger", "S. Pirker"),
            2012,
            "Progress in Computational Fluid Dynamics",
            "12",
            "140–152",
            "10.1504/PCFD.2012.047457",
        ),
        Source(
            "thompson2022",
            "LAMMPS – a flexible simulation tool for particle-based materials modeling at the atomic, meso, and "
            "continuum scales",
            (
                "A. P. Thompson",
                "H. M. Aktulga",
                "R. Berger",
                "D. S. Bolintineanu",
                "W. M. Brown",
                "P. S. Crozier",
                "P. J. in 't Veld",
                "A. Kohlmeyer",
                "S. G. Moore",
                "T. D. Nguyen",
                "R. Shan",
                "M. J. Stevens",
                "J. Tranchida",
                "C. Trott",
                "S. J. Plimpton",
            ),
            2022,
            "Computer Physics Communications",
            "271",
            "108171",
            "10.1016/j.cpc.2021.108171",
        ),
        Source("ericson2005", "Real-Time Collision Detection", ("C. Ericson",), 2005, publisher="Morgan Kaufmann"),
        # flow through outlets
        Source(
            "rose1959",
            "Rate of discharge of granular materials from bins and hoppers",
            ("H. F. Rose", "T. Tanaka"),
            1959,
            "The Engineer",
            "208",
            "465–469",
        ),
        Source(
            "beverloo1961",
            "The flow of granular solids through orifices",
            ("W. A. Beverloo", "H. A. Leniger", "J. van de Velde"),
            1961,
            "Chemical Engineering Science",
            "15",
            "260",
            "10.1016/0009-2509(61)85030-6",
        ),
        Source(
            "brown1961",
            "Minimum energy theorem for flow of dry granules through apertures",
            ("R. L. Brown",),
            1961,
            "Nature",
            "191",
            "458",
            "10.1038/191458a0",
        ),
        Source(
            "janda2012",
            "Flow rate of particles through apertures obtained from self-similar density and velocity profiles",
            ("A. Janda", "I. Zuriguel", "D. Maza"),
            2012,
            "Physical Review Letters",
            "108",
            "248001",
            "10.1103/PhysRevLett.108.248001",
        ),
        # papers whose results are compared
        Source(
            "pongo2022",
            "Discharge of elongated grains in silos under rotational shear",
            ("T. Pongó", "T. Börzsönyi", "R. C. Hidalgo"),
            2022,
            "Physical Review E",
            "106",
            "034904",
            "10.1103/PhysRevE.106.034904",
        ),
        Source(
            "fan2023",
            "Numerical study of granular discharge flows through centred and off-centred rectangular hoppers using "
            "discrete element simulations",
            ("J. Fan", "H. Wang", "L.-H. Luu", "P. Philippe", "L. Wang", "Z.-L. Wei", "J. Yu"),
            2023,
            "Powder Technology",
            "429",
            "118964",
            "10.1016/j.powtec.2023.118964",
        ),
        Source(
            "dosta2024",
            "Comparing open-source DEM frameworks for simulations of common bulk processes",
            (
                "M. Dosta",
                "D. Andre",
                "V. Angelidakis",
                "R. A. Caulk",
                "M. A. Celigueta",
                "B. Chareyre",
                "J.-F. Dietiker",
                "J. Girardot",
                "N. Govender",
                "C. Hubert",
                "R. Kobyłka",
                "A. F. Moura",
                "V. Skorych",
                "D. K. Weatherley",
                "T. Weinhart",
            ),
            2024,
            "Computer Physics Communications",
            "296",
            "109066",
        ),
        # measures
        Source(
            "nelson1979",
            "Dislocation-mediated melting in two dimensions",
            ("D. R. Nelson", "B. I. Halperin"),
            1979,
            "Physical Review B",
            "19",
            "2457",
            "10.1103/PhysRevB.19.2457",
        ),
        Source(
            "goldhirsch2010",
            "Stress, stress asymmetry and couple stress: from discrete particles to continuous fields",
            ("I. Goldhirsch",),
            2010,
            "Granular Matter",
            "12",
            "239",
            "10.1007/s10035-010-0181-z",
        ),
        # statistics
        Source(
            "schuirmann1987",
            "A comparison of the two one-sided tests procedure and the power approach for assessing the equivalence of "
            "average bioavailability",
            ("D. J. Schuirmann",),
            1987,
            "Journal of Pharmacokinetics and Biopharmaceutics",
            "15",
            "657",
            "10.1007/BF01068419",
        ),
        Source(
            "venzon1988",
            "A method for computing profile-likelihood-based confidence intervals",
            ("D. J. Venzon", "S. H. Moolgavkar"),
            1988,
            "Applied Statistics",
            "37",
            "87",
            "10.2307/2347496",
        ),
        Source(
            "hurvich1989",
            "Regression and time series model selection in small samples",
            ("C. M. Hurvich", "C.-L. Tsai"),
            1989,
            "Biometrika",
            "76",
            "297",
            "10.1093/biomet/76.2.297",
        ),
        Source(
            "davison1997",
            "Bootstrap Methods and Their Application",
            ("A. C. Davison", "D. V. Hinkley"),
            1997,
            publisher="Cambridge University Press",
        ),
        Source(
            "politis2003",
            "Adaptive bandwidth choice",
            ("D. N. Politis",),
            2003,
            "Journal of Nonparametric Statistics",
            "15",
            "517",
        ),
    )
)
"""All publications, by key."""

_HERTZ = ("hertz1882", "tsuji1992")
CONTACT_LAWS: Mapping[str, tuple[str, ...]] = {
    "hertz-mindlin": (*_HERTZ, "mindlin1953", "fan2023"),
    "hertz-printed": (*_HERTZ, "mindlin1953", "fan2023"),
    "hertz-liggghts": (*_HERTZ, "kloss2012"),
    "hertz-lammps": (*_HERTZ, "thompson2022"),
    "linear": ("cundall1979", "pongo2022"),
}
"""Keys of the sources of contact laws."""

ROLLING_MODELS: Mapping[str, tuple[str, ...]] = {"cdt": ("fan2023",), "epsd": ("ai2011",)}
"""Keys of the sources of models of rolling friction."""

MEASURES: Mapping[str, tuple[str, ...]] = {
    "flow_rate": (),
    "outlet_profiles": (),
    "packing": (),  # but for the hexatic order, see METHODS
    "orifice": ("goldhirsch2010", "pongo2022"),
    "contact_stress": ("goldhirsch2010",),
    "ledger": (),
    "outlets": (),
}
"""Keys of the sources of measures; none for definitions of labbook's own."""

PAPER_FITS: Mapping[str, tuple[str, ...]] = dict.fromkeys(
    ("outlet_profiles", "outlet_crossings"), ("fan2023", "davison1997")
)
"""Keys of the sources of fits that papers add. Laws of flow name theirs as `source`."""

STARTS: Mapping[str, tuple[str, ...]] = {"rain": (), "gas": (), "planar": ()}
"""Keys of the sources of starts of a filling; none for those of labbook's own."""

METHODS: Mapping[str, tuple[str, ...]] = {
    "restitution of the law linear": ("schwager2007",),
    "contacts of rods": ("ericson2005",),
    "hexatic order": ("nelson1979",),
    "fields of recorded runs": ("goldhirsch2010",),
    "confidence intervals of fits": ("venzon1988",),
    "choice between laws": ("hurvich1989",),
    "flow rate against the angle of the bottom": ("brown1961", "rose1959"),
    "equivalence tests of numerics": ("schuirmann1987",),
    "error of the flow rate within a run": ("politis2003",),
}
"""Keys of the sources of methods that a study uses without naming them."""

_YEAR = re.compile(r"\b(?:1[89]|20)\d\d\b")


def named_in(text: str) -> tuple[Source, ...]:
    """The sources that a text names, by the surname of the first author and the year behind it.

    Parts between semicolons are read one by one. A part with a year that names none of `SOURCES` is a source by
    itself, with the part as its title; so is a text that names none at all.
    """
    found: dict[str, Source] = {}
    for part in filter(None, (part.strip() for part in text.split(";"))):
        known = [one for one in SOURCES.values() if _names(folded(part), one)]
        if not known and _YEAR.search(part):
            known = [_unknown(part)]
        found |= {one.key: one for one in known}
    return tuple(found.values()) or (_unknown(text),)


def _names(part: str, source: Source) -> bool:
    surname = folded(source.authors[0]).split()[-1]
    return re.search(rf"\b{re.escape(surname)}\b.*?\b{source.year}\b", part, re.DOTALL) is not None


def _unknown(text: str) -> Source:
    """A source of which only a text is known; its key is made of the text."""
    title = " ".join(text.split())
    words = re.findall(r"[a-z0-9]+", folded(title))
    return Source("-".join(words[:6]) or "source", title)
