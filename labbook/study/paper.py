"""Words that a paper's own analysis adds to studies: fits, and quantities that a reference can name."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from labbook.fit import LAWS
from labbook.measure import Quantity
from labbook.plugins import Registry
from labbook.scene.scene import Scene
from labbook.study.problems import closest, instead, quote


@dataclass(frozen=True)
class Wrong:
    """Reason that a number of a reference cannot be compared, with a remedy."""

    reason: str
    remedy: str


@dataclass(frozen=True)
class QuantityContext:
    """Context in which a reference names a quantity.

    Args:
        scenes: One scene of each kind, among the points that the reference speaks of.
        units: SI units of the quantities that the study measures there, by name.
        is_statement: True for a statement, which gives a range instead of a number.
    """

    scenes: tuple[Scene, ...]
    units: Mapping[str, str]
    is_statement: bool = False


class Vocabulary:
    """Words that studies may use. `labbook.papers.Paper` is the whole of what a paper adds.

    A class that lists `fits` has a method `fit` (`labbook.results.paper.Analysis`). Without it, defining the class
    raises TypeError.
    """

    name: ClassVar[str]
    fits: ClassVar[Mapping[str, str]] = MappingProxyType({})
    """Names that a study may list under `fit`, each with the measure that it needs."""
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
        return tuple(
            dict.fromkeys((*self.fits, *self.heads, *(quantity.name.partition(".")[0] for quantity in self.declared)))
        )

    def unit(self, quantity: str, context: QuantityContext) -> str | Wrong | None:
        """SI unit of a quantity that a reference names.

        Args:
            quantity: Name in the reference.
            context: Scenes and measured quantities.

        Returns:
            The unit; Wrong if the quantity is not available; None if it is not one of this paper.
        """
        head, _, tail = quantity.partition(".")
        units = {
            declaration.name: declaration.unit
            for declaration in self.declared
            if declaration.name.startswith(f"{head}.")
        }
        if not units or tail in context.units:  # a measure may share its name with a fit
            return None
        return units[quantity] if quantity in units else none_such(quantity, units)


PAPERS: Registry[Vocabulary] = Registry[Vocabulary]("labbook.papers", Vocabulary, ())
"""Papers whose analyses are installed, labbook's own among them."""


def words() -> Iterator[str]:
    """First words of the quantities of all papers."""
    return (word for paper in PAPERS.values() for word in paper.words)


def fits() -> dict[str, str]:
    """Names of all papers that a study may list under `fit`, each with the measure that it needs."""
    return {name: needed for paper in PAPERS.values() for name, needed in paper.fits.items()}


def of_fit(quantity: str) -> bool:
    """Tell parameters of fits from other quantities.

    Args:
        quantity: Name of the quantity.

    Returns:
        True for a parameter of a fit, `FIT.NAME`.
    """
    head = quantity.partition(".")[0]
    papers = (paper for paper in PAPERS.values() if head in paper.fits)
    return head in LAWS or any(declaration.name == quantity for paper in papers for declaration in paper.declared)


def none_such(quantity: str, candidates: Iterable[str]) -> Wrong:
    """Report a quantity that is not available.

    Args:
        quantity: Name in the reference.
        candidates: Names that are available. If all begin as the quantity does, only the rest of the names is compared.

    Returns:
        Reason and remedy.
    """
    head, _, tail = quantity.partition(".")
    names = list(candidates)
    alike = bool(names) and all(name.startswith(f"{head}.") for name in names)
    match = closest(tail, [name.partition(".")[2] for name in names]) if alike else closest(quantity, names)
    remedy = f"did you mean {head}.{match}?" if alike and match else instead("" if alike else quantity, names)
    return Wrong(f"{quote(quantity)} is neither measured nor fitted in this study", remedy)
