"""What a study found: every point with its replicates pooled, series with fits, and the comparison with a reference."""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from labbook.fit import COVERAGE, CROSSINGS
from labbook.fit.outlet import Outlet
from labbook.measure import MEASURES, MeasureError, RunData
from labbook.measure.acceleration import AccelerationProfile
from labbook.measure.flow import CUT_SHORT
from labbook.measure.orifice import OrificeMeans, acceleration_of
from labbook.measure.outlet import outlet_profile
from labbook.measure.series import crossings, flow_series
from labbook.measure.steady import steady_flow
from labbook.measure.stress import ContactStress, stress_fields
from labbook.report import display
from labbook.report.filmed import frames_of
from labbook.stats import Measured, Pooled, StoppingRule

if TYPE_CHECKING:
    from labbook.fields import Fields
    from labbook.report.comparison import Comparison
    from labbook.report.numerical import Numerical
    from labbook.report.rotation import Rotation
    from labbook.report.series import Series
    from labbook.report.statements import Judged
    from labbook.study import Point, Study

FLOW_RATE = "flow_rate"
ORIFICE = "container.orifice"
UNPOOLED = frozenset({"waiting_time"})
"""A waiting time of a clogged run is censored: its mean over replicates would mean nothing."""
_GRAINS_PER_BIN, _BINS = 25, 80  # of W(t): as fine as counting allows, and no finer than a figure shows


class Finished(Protocol):
    """A run that has ended, as the catalogue hands it out."""

    @property
    def point(self) -> "Point": ...
    @property
    def seed(self) -> int: ...
    @property
    def run_key(self) -> str: ...
    @property
    def outcome(self) -> str: ...
    @property
    def provenance(self) -> Mapping[str, Any]: ...
    def data(self) -> RunData:
        """What was observed."""
        ...

    def recording(self) -> Mapping[str, np.ndarray] | None:
        """Recorded frames, or None without any."""
        ...


@dataclass(frozen=True, eq=False)
class Trace:
    """W(t) of one run: times [s] and rates [kg/s], shape [n], and start and end [s] of the window of its mean."""

    time: np.ndarray
    rate: np.ndarray
    window: tuple[float, float] | None


@dataclass(frozen=True, eq=False)
class RunResult:
    """One run: how it ended, what was measured of it, by quantity, its W(t), and the profiles along its outlet.

    `outlets`: those profiles by definition (`labbook.fit.DEFINITIONS`); `frames` reads what was recorded of it, None if
    nothing was.
    """

    seed: int
    run_key: str
    outcome: str
    measured: Mapping[str, Measured]
    trace: Trace | None
    provenance: Mapping[str, Any]
    outlets: Mapping[str, Outlet] = field(default_factory=dict)
    frames: Callable[[], Mapping[str, np.ndarray] | None] = lambda: None
    acceleration: AccelerationProfile | None = None
    """Above the middle of the outlet, where `orifice` was measured."""
    stress: Callable[[], "tuple[Fields, int] | None"] = lambda: None
    """Fields with the contact stress of the bed, and of how many frames; None unless `contact_stress` was measured."""


@dataclass(frozen=True, eq=False)
class PointResult:
    """One point of a study with its replicates.

    `at`: what was swept, without what follows from the rest; `pooled`: means over seeds, by quantity, with Student
    intervals; `tolerance`: the relative half-width that the study asks for; `asked`: how many replicates it asks for at
    least.
    """

    point: "Point"
    at: Mapping[str, float | str]
    runs: tuple[RunResult, ...]
    pooled: Mapping[str, Pooled]
    tolerance: float | None
    asked: int

    @property
    def label(self) -> str:
        """What was swept, in the units of the field."""
        return display.label(self.at)

    @property
    def orifice(self) -> float:
        """Width of the outlet [m]; NaN where the container has none."""
        return float(getattr(self.point.scene.container, "orifice", math.nan))

    @property
    def flow_rate(self) -> Pooled | None:
        """Pooled W [kg/s], or None if no replicate gave one."""
        return self.pooled.get(FLOW_RATE)

    def outlets(self, definition: str) -> tuple[Outlet, ...]:
        """Profiles along the outlet, of every run that has them."""
        return tuple(run.outlets[definition] for run in self.runs if definition in run.outlets)

    @property
    def outcomes(self) -> Counter[str]:
        """How many replicates ended in which way."""
        return Counter(run.outcome for run in self.runs)

    @cached_property
    def notes(self) -> Counter[str]:
        """How many replicates carry which note on their flow rate (`trending` ...)."""
        carried = (run.measured[FLOW_RATE].notes for run in self.runs if FLOW_RATE in run.measured)
        return Counter(note for notes in carried for note in notes)

    @property
    def trending(self) -> bool:
        """Whether the flow of more than half of the replicates has no plateau."""
        return self.notes["trending"] > len(self.runs) / 2

    @property
    def precise(self) -> bool | None:
        """Whether the pooled flow rate meets the study's tolerance; None if none was asked for."""
        if self.tolerance is None:
            return None
        return self.flow_rate is not None and self.flow_rate.relative <= self.tolerance

    @property
    def partial(self) -> bool:
        """Whether replicates are lacking. Of runs that began together the first to end flow fast: no fair sample."""
        return len(self.runs) < self.asked

    @property
    def remark(self) -> str:
        """What a reader must know of this point, in a few words; empty if nothing."""
        parts = [f"{len(self.runs)} of {self.asked} runs so far"] if self.partial else []
        parts += ["trending"] if self.trending else []
        parts += ["stopped within the window"] if self.notes[CUT_SHORT] else []
        ended = {how: n for how, n in self.outcomes.items() if how in ("clogged", "diverged")}
        return ", ".join(parts + [f"{n} of {len(self.runs)} {how}" for how, n in ended.items()])


@dataclass(frozen=True, eq=False)
class Analysis:
    """All that a report shows of a study.

    `missing`: points without any finished run that could be read; `unreadable`: why runs could not be.
    """

    study: "Study"
    points: tuple[PointResult, ...]
    missing: tuple["Point", ...]
    unreadable: tuple[str, ...]
    series: tuple["Series", ...]
    comparisons: tuple["Comparison", ...]
    turning: tuple["Rotation", ...] = ()
    """Points that differ in the rotation of the bottom only."""
    judged: tuple["Judged", ...] = ()
    """Statements of the reference, held against ours."""
    numerical: tuple["Numerical", ...] = ()
    """Points that differ in numerics only."""

    @property
    def source(self) -> str:
        """What the reference is called; empty without one."""
        return self.study.reference.source if self.study.reference is not None else ""


def analyse(
    study: "Study",
    finished: Sequence[Finished],
    progress: Callable[[int], None] = lambda done: None,
    lost: Sequence[str] = (),
) -> Analysis:
    """Measure the finished runs of a study, pool replicates, fit series and compare with the study's reference.

    `progress` is told how many runs have been measured. A run that cannot be read or measured is left out and reported,
    after those of which that was known before (`lost`: why).
    """
    from labbook.lab import Unreadable
    from labbook.report.comparison import compare
    from labbook.report.numerical import numerical
    from labbook.report.rotation import rotations
    from labbook.report.series import series_of
    from labbook.report.statements import judge

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


def redundant(points: Sequence["Point"]) -> frozenset[str]:
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


def _point(study: "Study", point: "Point", extra: frozenset[str], runs: tuple[RunResult, ...]) -> PointResult:
    cap = max(study.replicates, study.accuracy.max_replicates)
    rule = StoppingRule(study.accuracy.flow_rate, study.replicates, cap)
    values: dict[str, list[float]] = {}
    for run in runs:
        for name, measured in run.measured.items():
            if run.outcome != "diverged" and name not in UNPOOLED and math.isfinite(measured.value):
                values.setdefault(name, []).append(measured.value)
    pooled = {name: rule.pool(found) for name, found in values.items()}
    return PointResult(point, _swept(point, extra), runs, pooled, study.accuracy.flow_rate, study.replicates)


def _swept(point: "Point", extra: frozenset[str]) -> dict[str, float | str]:
    return {name: value for name, value in point.at.items() if name not in extra}


def _run(study: "Study", finished: Finished) -> RunResult:
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


def _outlets(study: "Study", data: RunData) -> dict[str, Outlet]:
    """The profiles of a run that flowed through the window; none of a clogged one, as for its flow rate."""
    found = outlet_profile(data, study.window) if data.outcome not in ("clogged", "diverged") else None
    if found is None:
        return {}
    reach = 1 - data.scene.grains.radius / found.R
    return {
        COVERAGE: Outlet(found.R, found.edges, found.area_fraction, found.flux, reach, found.counted),
        CROSSINGS: Outlet(found.R, found.edges, found.crossing_fraction, found.crossing_flux, 1.0, found.counted),
    }


def _trace(study: "Study", data: RunData) -> Trace | None:
    """W(t) of a run, if it recorded crossings and any grain left."""
    if "crossing" not in data.tables or not len(data.tables["crossing"]["time"]):
        return None
    times, weights = crossings(data)
    width = min(max(times[-1] / _BINS, _GRAINS_PER_BIN * times[-1] / len(times)), data.duration)
    steady = steady_flow(times, len(data.start), study.window, weights)
    window = (steady.begin, steady.end) if steady is not None else None
    return Trace(*flow_series(data, float(width)), window)
