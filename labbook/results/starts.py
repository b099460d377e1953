"""Flow rates and fitted laws of a study for other starts of the window."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

from labbook.fit import Parameter
from labbook.lab.evaluations import NotEvaluated
from labbook.measure.outlet import ProfileAcross
from labbook.measure.starts import ShiftedWindow, StartResult, WindowStarts
from labbook.results.points import FLOW_RATE, PointResult, RunResult, pooled_point, redundant
from labbook.results.series import PACKING_FRACTION, Series, series_of
from labbook.results.study import StudyResults
from labbook.scene.quantities import percent
from labbook.stats import Measured

SENSIBLE = (0.1, 0.15, 0.2)
"""Starts that, with the end of the start-up, give the window's share of the error of a fitted parameter: each is a
choice that a careful author could make. Windows that open earlier contain the start-up and measure another quantity."""


@dataclass(frozen=True, eq=False)
class _RunFrom(RunResult):
    """A run with another start of the window: its flow rate and its profiles along the outlet, and nothing else."""

    start: StartResult | None = None

    @cached_property
    def outlets(self) -> Mapping[str, ProfileAcross]:
        """Profiles along its outlet, as those of `RunResult`."""
        profile = None if self.start is None else self.start.profile
        if profile is None or self.outcome == "clogged" or not self.counted:
            return {}
        return profile.outlets(self.run.point.scene.grains.radius)


@dataclass(frozen=True, eq=False)
class AtStart:
    """Points and series of a study with another start of the window; points have their flow rates only.

    `opens`: discharged fraction when the window opens, mean over runs; `unsteady`: number of runs whose start-up takes
    too long to be left out, by index of their point; `of_study`: True for the window of the study.
    """

    window: ShiftedWindow
    points: tuple[PointResult, ...]
    series: tuple[Series, ...]
    opens: float
    unsteady: Mapping[int, int]
    of_study: bool

    @property
    def label(self) -> str:
        """`0.15`, `0.15 (stated)`, `auto (0.08)`, the latter with the mean over runs."""
        name = f"auto ({self.opens:.2f})" if self.window.auto else f"{self.window.start:g}"
        return f"{name} (stated)" if self.of_study else name

    def unsteady_in(self, series: Series) -> int:
        """Number of runs of a series without a steady part, if the window opens at the end of the start-up."""
        return (
            sum(self.unsteady.get(result.point.index, 0) for result in series.whole_points) if self.window.auto else 0
        )

    def of(self, series: Series) -> Series | None:
        """The same series with this start; None if it rests on other points, for want of grains."""
        candidates = (moved for moved in self.series if (moved.at, moved.outlet) == (series.at, series.outlet))
        moved = next(candidates, None)
        return moved if moved is not None and moved.used == series.used else None


_CACHE: WeakKeyDictionary[StudyResults, tuple[AtStart, ...]] = WeakKeyDictionary()
"""For as long as someone holds the results: page, tables and budget need the same."""


def at_starts(results: StudyResults) -> tuple[AtStart, ...]:
    """Evaluate a study that fits a law for several starts of its window.

    Returns:
        In the order of `labbook.measure.starts.shifted_windows`. Empty for a study that fits nothing, for windows by
        time and for fed beds; also where runs were not evaluated and nothing is evaluated now.
    """
    if results not in _CACHE:
        study = results.study
        fitted = any(series.fits or series.further for series in results.series)
        usable = fitted and not (study.fed or study.window.timed)
        try:
            _CACHE[results] = tuple(_at_starts(results)) if usable else ()
        except NotEvaluated:
            _CACHE[results] = ()
    return _CACHE[results]


def _at_starts(results: StudyResults) -> list[AtStart]:
    study, extra = results.study, redundant(results.study.points)
    runs = {point: [(run, moved) for run in point.runs if (moved := _from_starts(run))] for point in results.points}
    windows = next(([start.window for start in moved] for pairs in runs.values() for _, moved in pairs), [])
    starts = []
    for index, window in enumerate(windows):
        points = [
            pooled_point(study, point.point, extra, tuple(_run_from(run, moved[index]) for run, moved in pairs))
            for point, pairs in runs.items()
        ]
        counting = [(point, moved[index]) for point, pairs in runs.items() for run, moved in pairs if run.counted]
        fractions = [start.fraction for _, start in counting if math.isfinite(start.fraction)]
        unsteady = Counter(point.point.index for point, start in counting if not start.plateau)
        auto = study.window.auto
        of_study = window.auto if auto else not window.auto and window.start == study.window.start
        opens = sum(fractions) / len(fractions) if fractions else math.nan
        starts.append(AtStart(window, tuple(points), series_of(points, study.fit), opens, unsteady, of_study))
    return starts


def _from_starts(run: RunResult) -> tuple[StartResult, ...]:
    evaluation = run.evaluation(WindowStarts())
    return tuple(WindowStarts.of(evaluation, run.window)) if evaluation.arrays else ()


def _run_from(run: RunResult, start: StartResult) -> _RunFrom:
    """The run with the flow rate of a start; none for a run that clogged, as for the window of the study. Laws also
    need the packing fraction at rest, which has no window."""
    measured = {name: run.measured[name] for name in (PACKING_FRACTION,) if name in run.measured}
    if run.outcome != "clogged":
        where = f"from {start.fraction:.3g} of the mass discharged"
        measured[FLOW_RATE] = Measured(FLOW_RATE, start.flow_rate, math.nan, 0, where, "crossings", "kg/s")
    return _RunFrom(run.run, measured, run.measures, run.window, run.counted, start)


def parameters_at(starts: Sequence[AtStart], series: Series, law: str, name: str) -> list[tuple[AtStart, Parameter]]:
    """A fitted parameter of a series for each start that has it."""
    moved = [(at, at.of(series)) for at in starts]
    return [(at, parameters[name]) for at, moved_series in moved
            if moved_series is not None and name in (parameters := moved_series.parameters(law))]  # fmt: skip


def window_share(results: StudyResults, series: Series, law: str, name: str) -> tuple[float, str] | None:
    """Largest change of a fitted parameter between SENSIBLE starts of the window.

    Returns:
        The difference to its value, relative to the value, and what that rests on; None if it is not known.
    """
    value = series.parameters(law)[name].value
    sensible = [
        (at, parameter.value)
        for at, parameter in parameters_at(at_starts(results), series, law, name)
        if not at.of_study and (not at.unsteady_in(series) if at.window.auto else at.window.start in SENSIBLE)
    ]
    if not sensible or not value:
        return None
    labels = ", ".join("auto" if at.window.auto else percent(at.window.start, ".0f") for at, _ in sensible)
    return max(abs(other / value - 1) for _, other in sensible), f"largest difference to starts of {labels}"
