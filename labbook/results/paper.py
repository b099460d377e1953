"""The numbers that a paper's own analysis makes of the points and series of a study."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from labbook.fit import FitError
from labbook.lab.evaluations import NotEvaluated
from labbook.lab.records import Unreadable
from labbook.plugins import ExtensionError
from labbook.results.points import PointResult
from labbook.results.reference import Comparison, sought
from labbook.results.series import FitTo, FurtherFit
from labbook.results.statements import Judged
from labbook.results.study import StudyResults
from labbook.study import Statement
from labbook.study.paper import PAPERS, Vocabulary

Row = dict[str, Any]


class Analysis(Vocabulary):
    """Numbers that a paper's analysis adds to results. `labbook.papers.Paper` has everything that a paper adds."""

    columns: ClassVar[Mapping[str, Mapping[str, str]]] = MappingProxyType({})
    """SI units of columns that mean the same in every row of a frame, by frame and column."""

    if TYPE_CHECKING:  # no class that lists `fits` is without it: `Vocabulary` sees to that

        def fit(self, name: str, points: Sequence[PointResult]) -> FurtherFit:
            """Fit one of its `fits`.

            Args:
                name: Name of the fit.
                points: Points of a series, in the order of their orifice.

            Returns:
                Fitted parameters.

            Raises:
                FitError: The points cannot be fitted; with the reason and a remedy.
            """
            ...

    def compared(
        self, results: StudyResults, quantity: str, at: Mapping[str, float | str]
    ) -> Sequence[Comparison] | None:
        """Compare a quantity of its own that a reference names. Parameters of its fits need nothing here.

        Args:
            results: Results of the study, without comparisons yet.
            quantity: Name of the quantity.
            at: Values of keys that the points must have [SI or word].

        Returns:
            Comparisons with NaN as the reference; None for quantities of others.
        """
        return None

    def judged(self, results: StudyResults, statement: Statement) -> Sequence[Judged] | None:
        """Judge a statement on a quantity of its own.

        Args:
            results: Results of the study, without comparisons yet.
            statement: The statement.

        Returns:
            Judgements at all places that the statement speaks of; None for quantities of others, which are judged by
            the comparisons.
        """
        return None

    def frames(self, results: StudyResults) -> Mapping[str, Iterable[Row]]:
        """Data frames with numbers of its own.

        Args:
            results: Results of the study.

        Returns:
            Rows of the frames by name, in SI.
        """
        return {}


def analyses() -> Iterator[Analysis]:
    """Analyses of all papers. An entry that is only a `Vocabulary` adds words to studies and no numbers."""
    return (paper for paper in PAPERS.values() if isinstance(paper, Analysis))


def calling(paper: Vocabulary) -> AbstractContextManager[None]:
    """A context for a call of a paper's method: what the code of another package raises becomes an ExtensionError,
    unless it is about the lab or the data."""
    return PAPERS.calling(paper.name, FitError, NotEvaluated, Unreadable)


def further_fits() -> dict[str, FitTo]:
    """Fits of all papers to the points of a series, by name."""
    return {name: _fit_of(paper, name) for paper in analyses() for name in paper.fits}


def _fit_of(paper: Analysis, name: str) -> FitTo:
    def fit(points: Sequence[PointResult]) -> FurtherFit:
        with calling(paper):
            return paper.fit(name, points)

    return fit


def compared(results: StudyResults, quantity: str, at: Mapping[str, float | str]) -> Sequence[Comparison] | None:
    """Ours for a quantity of a paper; None if no paper has it. Where the code of the paper fails, a comparison without
    numbers says so."""
    for paper in analyses():
        try:
            with calling(paper):
                comparisons = paper.compared(results, quantity, at)
        except ExtensionError as error:
            comparisons = [replace(sought(quantity, at), why=str(error))] if _owns(paper, quantity) else None
        if comparisons is not None:
            return comparisons
    return None


def judged(results: StudyResults, statement: Statement) -> Sequence[Judged] | None:
    """Verdicts of the paper whose quantity a statement is on; None if it is no paper's. Where its code fails, the
    statement is undecided, with the reason."""
    for paper in analyses():
        try:
            with calling(paper):
                verdicts = paper.judged(results, statement)
        except ExtensionError as error:
            verdicts = [Judged(statement, "", None, why=str(error))] if _owns(paper, statement.quantity) else None
        if verdicts is not None:
            return verdicts
    return None


def frames(results: StudyResults) -> tuple[dict[str, Iterable[Row]], list[str]]:
    """Rows of the data frames of all papers, by name; and why those of a paper are lacking."""
    tables, problems = dict[str, Iterable[Row]](), list[str]()
    for paper in analyses():
        try:
            with calling(paper):
                own = paper.frames(results)
                # rows are made when they are read: those of another package here, where its errors are caught
                tables |= {name: list(rows) for name, rows in own.items()} if paper.name in PAPERS.extensions else own
        except ExtensionError as error:
            problems.append(str(error))
    return tables, problems


def _owns(paper: Analysis, quantity: str) -> bool:
    return quantity.partition(".")[0] in paper.words
