"""What a paper's own analysis shows in reports."""

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
    """What the analysis of a paper adds to labbook; whatever it leaves out, it adds nothing to.

    | room    | attributes and methods                                                                   |
    |---------|------------------------------------------------------------------------------------------|
    | study   | `name`, `fits`, `declared`, `heads`, `unit`: words that a study may use, and their units  |
    | results | `fit`, `compared`, `judged`, `frames`, `columns`: numbers made of points and series       |
    | report  | `sections`, `of_series`, `tables`, `figures`, `figures_of`, `shows_beds_of`: what is shown |

    It is announced by an entry point of the group `labbook.papers` (see `labbook.papers`).
    """

    def sections(self, results: StudyResults, folder: Path) -> Sequence[Section]:
        """Sections of the page, after the comparison with the reference; figures go into the folder."""
        return ()

    def of_series(
        self, results: StudyResults, series: Series, folder: Path, suffix: str, where: str
    ) -> Sequence[Block]:
        """What stands at the end of the section of a series. `suffix`: of names of files, `where`: ` (angle = 40 deg)`,
        to be put into words; both are empty of the only series."""
        return ()

    def tables(self, results: StudyResults, series: Series, where: str) -> Sequence[tuple[str, Table]]:
        """Titles and tables of a series for the terminal; `where`: ` at angle = 40 deg`, or empty."""
        return ()

    def figures(self, results: StudyResults) -> Mapping[str, Draw]:
        """Figures by name, of several series at once; `Drawing` gives one a caption."""
        return {}

    def figures_of(self, results: StudyResults, series: Series) -> Mapping[str, Draw]:
        """Figures of a series, by name."""
        return {}

    def shows_beds_of(self, results: StudyResults) -> Collection[PointResult]:
        """Points of which its sections show how the beds flow: they are left out elsewhere."""
        return ()


def papers() -> Iterator[Paper]:
    """Those that are installed. An entry of the group that is an `Analysis` or a `Vocabulary` only shows nothing."""
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
            points |= {id(one) for one in paper.shows_beds_of(results)}
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
