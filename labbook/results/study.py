"""Results of a study: points, series with fits, and the comparison with a reference."""

from dataclasses import dataclass

from labbook.results.numerical import Numerical
from labbook.results.points import PointResult
from labbook.results.reference import Comparison
from labbook.results.series import Series
from labbook.results.statements import Judged
from labbook.study import Point, Study


@dataclass(frozen=True, eq=False)
class Results:
    """All results of a study.

    `missing`: points without a readable finished run; `unreadable`: reasons why runs could not be read.
    """

    study: Study
    points: tuple[PointResult, ...]
    missing: tuple[Point, ...]
    unreadable: tuple[str, ...]
    series: tuple[Series, ...]
    comparisons: tuple[Comparison, ...] = ()
    judged: tuple[Judged, ...] = ()
    """Statements of the reference, compared with these results."""
    unmeasured: tuple[str, ...] = ()
    """Measures that could not be taken of a run, and why."""
    numerical: tuple[Numerical, ...] = ()
    """Points that differ in numerics only."""
    unevaluated: tuple[str, ...] = ()
    """Keys of runs that are not fully evaluated, if nothing is evaluated now (`find.kept`)."""
    stale: frozenset[int] = frozenset()
    """Other versions of the backend with runs in these results: `labbook run` would make those runs again."""

    @property
    def source(self) -> str:
        """Name of the reference; empty without one."""
        return self.study.reference.source if self.study.reference is not None else ""
