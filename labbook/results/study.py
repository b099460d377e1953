"""What a study found: points, series with fits, and the comparison with a reference."""

from dataclasses import dataclass

from labbook.results.numerical import Numerical
from labbook.results.points import PointResult
from labbook.results.reference import Comparison
from labbook.results.series import Series
from labbook.results.statements import Judged
from labbook.study import Point, Study


@dataclass(frozen=True, eq=False)
class Results:
    """All that was found of a study.

    `missing`: points without any finished run that could be read; `unreadable`: why runs could not be.
    """

    study: Study
    points: tuple[PointResult, ...]
    missing: tuple[Point, ...]
    unreadable: tuple[str, ...]
    series: tuple[Series, ...]
    comparisons: tuple[Comparison, ...] = ()
    judged: tuple[Judged, ...] = ()
    """Statements of the reference, held against ours."""
    numerical: tuple[Numerical, ...] = ()
    """Points that differ in numerics only."""
    unevaluated: tuple[str, ...] = ()
    """Keys of runs that lack a number which was not evaluated yet, where nothing is evaluated (`find.kept`)."""
    stale: frozenset[int] = frozenset()
    """Versions of the backend whose runs count though another one is installed: `labbook run` would make them again."""

    @property
    def source(self) -> str:
        """What the reference is called; empty without one."""
        return self.study.reference.source if self.study.reference is not None else ""
