"""Results of a study: points, series with fits, and the comparison with a reference."""

from collections import Counter
from dataclasses import dataclass
from functools import cached_property

from labbook.results.numerical import Numerical
from labbook.results.points import PointResult, RunResult
from labbook.results.reference import Comparison
from labbook.results.series import Series
from labbook.results.statements import Judged
from labbook.study import Point, Study


@dataclass(frozen=True, eq=False)
class StudyResults:
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
    campaign: tuple[str, ...] = ()
    """Proposals of its strategy with their reasons, line by line; empty for a study without a strategy."""
    unevaluated: tuple[str, ...] = ()
    """Keys of runs that are not fully evaluated, if nothing is evaluated now (`find.stored_results`)."""
    installed: tuple[str, int] | None = None
    """Backend and version of it with which stale runs would be made again; None if it is not installed here."""

    @cached_property
    def stale(self) -> Counter[str]:
        """Number of stale runs by reason; `labbook run` would make them again."""
        every = (run for result in self.points for run in result.runs)
        return Counter(why for run in every if (why := self.stale_because(run)))

    def stale_because(self, run: RunResult) -> str:
        """Reason that a run of these results is stale; empty if it is not."""
        if run.outdated or self.installed is None or self.installed[1] == run.cache_version:
            return run.outdated
        name, version = self.installed
        return f"made by version {run.cache_version} of {name}, now at version {version}"

    @property
    def source(self) -> str:
        """Name of the reference; empty without one."""
        return self.study.reference.source if self.study.reference is not None else ""
