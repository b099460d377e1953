"""What a paper's own analysis adds to the words of a study: fits, and quantities that a reference can name."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from labbook.fit import LAWS
from labbook.measure import Quantity
from labbook.plugins import Registry
from labbook.scene.scene import Scene
from labbook.study.problems import instead, meant, shown


@dataclass(frozen=True)
class Wrong:
    """Why a reference cannot be compared with anything, and what would help."""

    reason: str
    remedy: str


@dataclass(frozen=True)
class Asked:
    """Where a reference names a quantity: one scene of each kind among the points that it
    speaks of (`scenes`), the SI `units` of what the
    study measures there, by name, and whether a range is `stated` rather than a number given."""

    scenes: tuple[Scene, ...]
    units: Mapping[str, str]
    stated: bool = False


class Vocabulary:
    """Words that studies may use. `labbook.papers.Paper` is the whole of what a paper adds.

    A class that lists `fits` has a method `fit` (`labbook.results.paper.Analysis`). Without it, defining the class
    raises TypeError.
    """

    name: ClassVar[str]
    fits: ClassVar[Mapping[str, str]] = MappingProxyType({})
    """What a study can name under `fit`, with the measure that it needs."""
    declared: ClassVar[tuple[Quantity, ...]] = ()
    """Quantities called `HEAD.NAME`, such as a parameter of a fit: how they are shown, and their units."""
    heads: ClassVar[tuple[str, ...]] = ()
    """Further words before the first dot of a quantity, if `unit` knows what may follow."""

    def __init_subclass__(cls, **further: Any):
        super().__init_subclass__(**further)
        if cls.fits and not hasattr(cls, "fit"):
            raise TypeError(
                f"{cls.__qualname__} lists {', '.join(cls.fits)} in `fits` and has no method `fit`; "
                "add `def fit(self, name, points)`, which returns a FurtherFit, or leave `fits` out"
            )

    @property
    def words(self) -> tuple[str, ...]:
        """All words that its quantities begin with."""
        return tuple(dict.fromkeys((*self.fits, *self.heads, *(one.name.partition(".")[0] for one in self.declared))))

    def unit(self, quantity: str, asked: Asked) -> str | Wrong | None:
        """SI unit of what a reference calls `quantity`; None of one that is not its own."""
        head, _, tail = quantity.partition(".")
        known = {one.name: one.unit for one in self.declared if one.name.startswith(f"{head}.")}
        if not known or tail in asked.units:  # a measure may share its name with a fit
            return None
        return known[quantity] if quantity in known else none_such(quantity, known)


PAPERS: Registry[Vocabulary] = Registry[Vocabulary]("labbook.papers", Vocabulary, ())
"""Papers whose analyses are installed, labbook's own among them."""


def words() -> Iterator[str]:
    """What quantities of all papers begin with."""
    return (word for paper in PAPERS.values() for word in paper.words)


def fits() -> dict[str, str]:
    """What papers add to what a study can name under `fit`, with the measure that it needs."""
    return {name: needed for paper in PAPERS.values() for name, needed in paper.fits.items()}


def of_fit(quantity: str) -> bool:
    """Whether it is a parameter of a fit, `FIT.NAME`."""
    head = quantity.partition(".")[0]
    papers = (paper for paper in PAPERS.values() if head in paper.fits)
    return head in LAWS or any(one.name == quantity for paper in papers for one in paper.declared)


def none_such(quantity: str, known: Iterable[str]) -> Wrong:
    """A quantity that is not among those known. Of names that begin alike, what follows is compared."""
    head, _, tail = quantity.partition(".")
    names = list(known)
    alike = bool(names) and all(name.startswith(f"{head}.") for name in names)
    close = meant(tail, [name.partition(".")[2] for name in names]) if alike else meant(quantity, names)
    remedy = f"did you mean {head}.{close}?" if alike and close else instead("" if alike else quantity, names)
    return Wrong(f"{shown(quantity)} is neither measured nor fitted in this study", remedy)
