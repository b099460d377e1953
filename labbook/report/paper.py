"""What a paper's own analysis shows in reports."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from labbook.report.blocks import Block, Section
from labbook.report.tables import Table
from labbook.results.paper import Analysis
from labbook.results.points import PointResult
from labbook.results.series import Series
from labbook.results.study import StudyResults
from labbook.study.paper import PAPERS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Draw = Callable[[], "Figure"]
"""Draws a figure."""


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
        """Figures by name, of several series at once."""
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
