"""Sections, tables and figures that a paper's own analysis adds to reports."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from labbook.plugins import ExtensionError
from labbook.report.blocks import Block, Prose, Section
from labbook.report.tables import Table
from labbook.results.paper import Analysis, calling
from labbook.results.points import PointResult
from labbook.results.series import Series
from labbook.results.study import StudyResults
from labbook.study.paper import PAPERS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Draw = Callable[[], "Figure"]
"""Draws a figure."""


@dataclass(frozen=True)
class Drawing:
    """A figure with its caption, made when it is called.

    Attributes:
        draw: Draws it.
        caption: Makes its caption.
        table: Frame of `labbook.results.frames` that has its numbers; empty without one.
    """

    draw: Draw
    caption: Callable[[], str] = str
    table: str = ""

    def __call__(self) -> "Figure":
        """Draw it."""
        return self.draw()


class Paper(Analysis):
    """Additions of a paper's analysis to labbook: base class, whose methods add nothing unless overridden.

    | room    | attributes and methods                                                                   |
    |---------|------------------------------------------------------------------------------------------|
    | study   | `name`, `fits`, `declared`, `heads`, `unit`: words that a study may use, and their units  |
    | results | `fit`, `compared`, `judged`, `frames`, `columns`: numbers made of points and series       |
    | report  | `sections`, `of_series`, `tables`, `figures`, `figures_of`, `shows_beds_of`: what is shown |

    It is announced by an entry point of the group `labbook.papers` (see `labbook.papers`).
    """

    def sections(self, results: StudyResults, folder: Path) -> Sequence[Section]:
        """Sections of the page, after the comparison with the reference.

        Args:
            results: Results of the study.
            folder: Folder of the page, into which figures are written.

        Returns:
            The sections, in order.
        """
        return ()

    def of_series(
        self, results: StudyResults, series: Series, folder: Path, suffix: str, where: str
    ) -> Sequence[Block]:
        """Blocks at the end of the section of a series.

        Args:
            results: Results of the study.
            series: The series.
            folder: Folder of the page, into which figures are written.
            suffix: Suffix for names of files; empty if there is one series.
            where: Place of the series for use in titles, ` (angle = 40 deg)`; empty if there is one series.

        Returns:
            The blocks, in order.
        """
        return ()

    def tables(self, results: StudyResults, series: Series, where: str) -> Sequence[tuple[str, Table]]:
        """Tables of a series for the terminal.

        Args:
            results: Results of the study.
            series: The series.
            where: Place of the series for use in titles, ` at angle = 40 deg`; empty if there is one series.

        Returns:
            Pairs of title and table.
        """
        return ()

    def figures(self, results: StudyResults) -> Mapping[str, Draw]:
        """Figures that show several series at once.

        Args:
            results: Results of the study.

        Returns:
            Functions that draw them, by name; `Drawing` gives one a caption.
        """
        return {}

    def figures_of(self, results: StudyResults, series: Series) -> Mapping[str, Draw]:
        """Figures of a series.

        Args:
            results: Results of the study.
            series: The series.

        Returns:
            Functions that draw them, by name.
        """
        return {}

    def shows_beds_of(self, results: StudyResults) -> Collection[PointResult]:
        """Points whose flow patterns its own sections show, so that other sections leave them out.

        Args:
            results: Results of the study.

        Returns:
            The points.
        """
        return ()


def papers() -> Iterator[Paper]:
    """Installed papers with output in reports. An entry that is only an `Analysis` or a `Vocabulary` has none."""
    return (paper for paper in PAPERS.values() if isinstance(paper, Paper))


def sections_of_all(results: StudyResults, folder: Path) -> list[Section]:
    """Sections of all papers. Where the code of a paper fails, a section says so."""
    sections: list[Section] = []
    for paper in papers():
        try:
            with calling(paper):
                sections += paper.sections(results, folder)
        except ExtensionError as error:
            sections.append(Section(f"Analysis of {paper.name}", (_failed(error),)))
    return sections


def blocks_of_all(results: StudyResults, series: Series, folder: Path, suffix: str, where: str) -> list[Block]:
    """All that papers add to the section of a series; where the code of a paper fails, the reason."""
    blocks: list[Block] = []
    for paper in papers():
        try:
            with calling(paper):
                blocks += paper.of_series(results, series, folder, suffix, where)
        except ExtensionError as error:
            blocks.append(_failed(error))
    return blocks


def tables_of_all(results: StudyResults, series: Series, where: str) -> tuple[list[tuple[str, Table]], list[str]]:
    """Titles and tables of a series for the terminal, and why those of a paper are lacking."""
    titled, problems = list[tuple[str, Table]](), list[str]()
    for paper in papers():
        try:
            with calling(paper):
                titled += paper.tables(results, series, where)
        except ExtensionError as error:
            problems.append(str(error))
    return titled, problems


def figures_of_all(results: StudyResults, series: Series | None = None) -> dict[str, Draw]:
    """Figures of all papers by name: of one series, or (None) of several at once.

    Drawing one raises ExtensionError where the code of its paper fails. A paper that cannot list its figures has one
    under its own name, which raises that error.
    """
    figures: dict[str, Draw] = {}
    for paper in papers():
        try:
            with calling(paper):
                own = paper.figures(results) if series is None else paper.figures_of(results, series)
            figures |= {name: _guarded(paper, draw) for name, draw in own.items()}
        except ExtensionError as error:
            figures[paper.name] = _raising(error)
    return figures


def beds_shown_by_all(results: StudyResults) -> set[int]:
    """Identities of the points whose beds sections of papers show."""
    points = set[int]()
    for paper in papers():
        with suppress(ExtensionError), calling(paper):  # its sections say so, and the page shows these beds
            points |= {id(result) for result in paper.shows_beds_of(results)}
    return points


def _guarded(paper: Paper, draw: Draw) -> Draw:
    def guarded() -> "Figure":
        with calling(paper):
            return draw()

    return replace(draw, draw=guarded) if isinstance(draw, Drawing) else guarded


def _raising(error: ExtensionError) -> Draw:
    def fail() -> "Figure":
        raise error

    return fail


def _failed(error: ExtensionError) -> Prose:
    return Prose(f"Not shown: {error}.", note=True)
