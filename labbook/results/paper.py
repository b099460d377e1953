"""The numbers that a paper's own analysis makes of the points and series of a study."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from labbook.results.points import PointResult
from labbook.results.reference import Comparison
from labbook.results.series import FitTo, FurtherFit
from labbook.results.statements import Judged
from labbook.results.study import StudyResults
from labbook.study import Statement
from labbook.study.paper import PAPERS, Vocabulary

Row = dict[str, Any]


class Analysis(Vocabulary):
    """What it makes of results. `labbook.papers.Paper` is the whole of what a paper adds."""

    columns: ClassVar[Mapping[str, Mapping[str, str]]] = MappingProxyType({})
    """SI units of the columns of its frames that mean the same in every row, by frame."""

    if TYPE_CHECKING:  # no class that lists `fits` is without it: `Vocabulary` sees to that

        def fit(self, name: str, points: Sequence[PointResult]) -> FurtherFit:
            """One of its `fits` to the points of a series, which are in the order of their orifice. Raises FitError."""
            ...

    def compared(
        self, results: StudyResults, quantity: str, at: Mapping[str, float | str]
    ) -> Sequence[Comparison] | None:
        """Ours for a quantity of its own that a reference names, at the points `at`, the reference being left NaN; None
        of other quantities. Parameters of its fits need nothing here. `results` have no comparisons yet."""
        return None

    def judged(self, results: StudyResults, statement: Statement) -> Sequence[Judged] | None:
        """A statement on a quantity of its own, at all places that it speaks of; None of other quantities, which are
        judged by what `compared` gives. `results` have no comparisons yet."""
        return None

    def frames(self, results: StudyResults) -> Mapping[str, Iterable[Row]]:
        """Rows of data frames, by name; SI."""
        return {}


def analyses() -> Iterator[Analysis]:
    """Those of all papers. An entry of the group that is a `Vocabulary` only adds words to studies and nothing here."""
    return (paper for paper in PAPERS.values() if isinstance(paper, Analysis))


def further_fits() -> dict[str, FitTo]:
    """What papers can fit to the points of a series, by name."""
    return {name: partial(paper.fit, name) for paper in analyses() for name in paper.fits}


def compared(results: StudyResults, quantity: str, at: Mapping[str, float | str]) -> Sequence[Comparison] | None:
    """Ours for a quantity of a paper; None if no paper has it."""
    every = (paper.compared(results, quantity, at) for paper in analyses())
    return next((found for found in every if found is not None), None)


def judged(results: StudyResults, statement: Statement) -> Sequence[Judged] | None:
    """What the paper says whose quantity a statement is on; None if it is no paper's."""
    every = (paper.judged(results, statement) for paper in analyses())
    return next((found for found in every if found is not None), None)
