"""What a study found: points, series with fits, and the comparison with a reference."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from labbook.backend import BackendMissing, load
from labbook.lab import Catalogue
from labbook.lab.evaluations import numbers
from labbook.lab.records import Observe
from labbook.results.numerical import Numerical, numerical
from labbook.results.points import Finished, PointResult, RunResult, pooled_point, redundant, swept
from labbook.results.reference import Comparison, compare
from labbook.results.rotation import Rotation, rotations
from labbook.results.series import Series, series_of
from labbook.results.statements import Judged, judge
from labbook.run.coverage import finished, unreadable
from labbook.stats import Measured
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
    comparisons: tuple[Comparison, ...]
    turning: tuple[Rotation, ...] = ()
    """Points that differ in the rotation of the bottom only."""
    judged: tuple[Judged, ...] = ()
    """Statements of the reference, held against ours."""
    numerical: tuple[Numerical, ...] = ()
    """Points that differ in numerics only."""
    stale: frozenset[int] = frozenset()
    """Versions of the backend whose runs count though another one is installed: `labbook run` would make them again."""

    @property
    def source(self) -> str:
        """What the reference is called; empty without one."""
        return self.study.reference.source if self.study.reference is not None else ""


def results_of(
    study: Study,
    runs: Sequence[Finished],
    measured: Mapping[str, Mapping[str, Measured]],
    problems: Mapping[str, str] | None = None,
    lost: Sequence[str] = (),
) -> Results:
    """Pool replicates, fit series and compare with the study's reference.

    `measured`: numbers by run key and quantity. A run with a problem is left out and reported, after those of which
    that was known before (`lost`: why).
    """
    wrong, unreadable = problems or {}, list(lost)
    by_point: dict[int, list[RunResult]] = {}
    for run in sorted(runs, key=lambda run: (run.point.index, run.seed)):
        if (why := wrong.get(run.run_key)) is not None:
            unreadable.append(why)
            continue
        found = RunResult(run, measured.get(run.run_key, {}), study.measure, study.window)
        by_point.setdefault(run.point.index, []).append(found)
    read = [point for point in study.points if by_point.get(point.index)]
    extra = redundant(study.points)
    points = tuple(pooled_point(study, point, extra, tuple(by_point[point.index])) for point in read)
    missing = tuple(point for point in study.points if not by_point.get(point.index))
    series = series_of(points, study.fit)
    comparisons = compare(study.reference, points, series)
    turning = rotations(points, [swept(point, extra) for point in missing])
    judged = judge(study.reference, points, series, turning)
    changed = numerical(study.points, points, study.accuracy.numerics)
    return Results(study, points, missing, tuple(unreadable), series, comparisons, turning, judged, changed)


def find(
    study: Study, catalogue: Catalogue, backend: str, progress: Callable[[int], None] = lambda done: None
) -> Results:
    """What the lab holds of a study from `backend`; what was not evaluated yet is evaluated now, and kept.

    `progress` is told how many runs are done.
    """
    runs, lost = finished(catalogue, study, backend), unreadable(catalogue, study, backend)
    observe = Observe(measure=study.measure, start=study.window.start, end=study.window.end)
    found = numbers(catalogue, runs, observe, progress)
    results = results_of(study, runs, found.measured, found.problems, lost)
    try:
        installed = load(backend).capabilities.cache_version
    except BackendMissing:  # the lab may be read where its backend is not installed
        return results
    return replace(results, stale=frozenset({run.cache_version for run in runs} - {installed}))
