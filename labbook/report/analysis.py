"""What a study found: every point with its replicates pooled, series with fits, and the comparison with a reference."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from labbook.fit import COVERAGE, CROSSINGS
from labbook.fit.outlet import Outlet
from labbook.lab import Unreadable
from labbook.measure import MEASURES, MeasureError, RunData
from labbook.measure.orifice import OrificeMeans, acceleration_of
from labbook.measure.outlet import outlet_profile
from labbook.measure.series import crossings, flow_series
from labbook.measure.steady import steady_flow
from labbook.measure.stress import ContactStress, stress_fields
from labbook.report.comparison import Comparison, compare
from labbook.report.numerical import Numerical, numerical
from labbook.report.points import ORIFICE, Finished, PointResult, RunResult, Trace, frames_of
from labbook.report.rotation import Rotation, rotations
from labbook.report.series import Series, series_of
from labbook.report.statements import Judged, judge
from labbook.stats import StoppingRule
from labbook.study import Point, Study

UNPOOLED = frozenset({"waiting_time"})
"""A waiting time of a clogged run is censored: its mean over replicates would mean nothing."""
_GRAINS_PER_BIN, _BINS = 25, 80  # of W(t): as fine as counting allows, and no finer than a figure shows


@dataclass(frozen=True, eq=False)
class Analysis:
    """All that a report shows of a study.

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

    @property
    def source(self) -> str:
        """What the reference is called; empty without one."""
        return self.study.reference.source if self.study.reference is not None else ""


def analyse(
    study: Study,
    finished: Sequence[Finished],
    progress: Callable[[int], None] = lambda done: None,
    lost: Sequence[str] = (),
) -> Analysis:
    """Measure the finished runs of a study, pool replicates, fit series and compare with the study's reference.

    `progress` is told how many runs have been measured. A run that cannot be read or measured is left out and reported,
    after those of which that was known before (`lost`: why).
    """

    by_point: dict[int, list[RunResult]] = {}
    unreadable = list(lost)
    for done, run in enumerate(sorted(finished, key=lambda run: (run.point.index, run.seed)), start=1):
        try:
            result = _run(study, run)
            by_point.setdefault(run.point.index, []).append(result)
        except Unreadable as error:
            unreadable.append(str(error))
        except MeasureError as error:
            unreadable.append(f"run {run.run_key} of {run.point.label}, seed {run.seed}: {error}")
        progress(done)
    read = [point for point in study.points if by_point.get(point.index)]
    extra = redundant(study.points)
    points = tuple(_point(study, point, extra, tuple(by_point[point.index])) for point in read)
    missing = tuple(point for point in study.points if not by_point.get(point.index))
    series = series_of(points, study.fit)
    comparisons = compare(study.reference, points, series)
    turning = rotations(points, [_swept(point, extra) for point in missing])
    judged = judge(study.reference, points, series, turning)
    changed = numerical(study.points, points, study.accuracy.numerics)
    return Analysis(study, points, missing, tuple(unreadable), series, comparisons, turning, judged, changed)


def redundant(points: Sequence[Point]) -> frozenset[str]:
    """Swept keys that follow from another one, such as a number of grains given for every width.

    The orifice counts by itself: what varies with it makes series of its own.
    """
    names = list(dict.fromkeys(name for point in points for name in point.at if name != ORIFICE))
    extra: set[str] = set()
    for place, name in enumerate(names):
        for other in (other for other in names[:place] if other not in extra):
            pairs = {(point.at.get(other), point.at.get(name)) for point in points}
            if len(pairs) == len({first for first, _ in pairs}) == len({second for _, second in pairs}) > 1:
                extra.add(name)
    return frozenset(extra)


def _point(study: Study, point: Point, extra: frozenset[str], runs: tuple[RunResult, ...]) -> PointResult:
    cap = max(study.replicates, study.accuracy.max_replicates)
    rule = StoppingRule(study.accuracy.flow_rate, study.replicates, cap)
    values: dict[str, list[float]] = {}
    for run in runs:
        for name, measured in run.measured.items():
            if run.outcome != "diverged" and name not in UNPOOLED and math.isfinite(measured.value):
                values.setdefault(name, []).append(measured.value)
    pooled = {name: rule.pool(found) for name, found in values.items()}
    return PointResult(point, _swept(point, extra), runs, pooled, study.accuracy.flow_rate, study.replicates)


def _swept(point: Point, extra: frozenset[str]) -> dict[str, float | str]:
    return {name: value for name, value in point.at.items() if name not in extra}


def _run(study: Study, finished: Finished) -> RunResult:
    data = finished.data()
    measured = {m.quantity: m for name in study.measure for m in MEASURES[name].evaluate(data, study.window)}
    outlets = _outlets(study, data) if COVERAGE in study.measure else {}
    trace = _trace(study, data)
    above = acceleration_of(data, study.window) if OrificeMeans.name in study.measure else None
    stressed = ContactStress.name in study.measure
    return RunResult(
        finished.seed,
        finished.run_key,
        finished.outcome,
        measured,
        trace,
        finished.provenance,
        outlets,
        frames_of(finished, data),
        above,
        lambda: stress_fields(finished.data(), study.window) if stressed else None,
    )


def _outlets(study: Study, data: RunData) -> dict[str, Outlet]:
    """The profiles of a run that flowed through the window; none of a clogged one, as for its flow rate."""
    found = outlet_profile(data, study.window) if data.outcome not in ("clogged", "diverged") else None
    if found is None:
        return {}
    reach = 1 - data.scene.grains.radius / found.R
    return {
        COVERAGE: Outlet(found.R, found.edges, found.area_fraction, found.flux, reach, found.counted),
        CROSSINGS: Outlet(found.R, found.edges, found.crossing_fraction, found.crossing_flux, 1.0, found.counted),
    }


def _trace(study: Study, data: RunData) -> Trace | None:
    """W(t) of a run, if it recorded crossings and any grain left."""
    if "crossing" not in data.tables or not len(data.tables["crossing"]["time"]):
        return None
    times, weights = crossings(data)
    width = min(max(times[-1] / _BINS, _GRAINS_PER_BIN * times[-1] / len(times)), data.duration)
    steady = steady_flow(times, len(data.start), study.window, weights)
    window = (steady.begin, steady.end) if steady is not None else None
    return Trace(*flow_series(data, float(width)), window)
