"""A calibration from the runs of a study: what its numerics did to the flow rate, by one regression a scene."""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from labbook.accuracy.calibration import Effects
from labbook.accuracy.groups import Groups, groups
from labbook.accuracy.regression import Observation, Slopes, curved, regress
from labbook.results.points import FLOW_RATE, PointResult, by_seed, values_by_run
from labbook.scene.quantities import percent
from labbook.study import Point


class NotCalibrated(ValueError):
    """A study that gives no calibration; the message says why."""


class PilotStopped(NotCalibrated):
    """A pilot that was stopped early; asked for again, it goes on."""

    def __init__(self) -> None:
        super().__init__("its pilot was stopped early; give the same command again to go on")


@dataclass(frozen=True)
class Change:
    """Effect of a setting of numerics on W, against the first setting of its scene, seed by seed.

    Args:
        label: Label of the point.
        flow: Dimensionless groups of the discharge.
        filled: Dimensionless groups of the filling.
        change: Mean change of ln W.
        error: Its standard error over seeds.
        seeds: Number of seeds with W at both settings.
        fitted: Change of ln W by the regression.
    """

    label: str
    flow: Groups
    filled: Groups
    change: float
    error: float
    seeds: int
    fitted: float

    def line(self) -> str:
        """In words."""
        return (
            f"{self.label}: overlap {self.flow.overlap:.2g} d (filled {self.filled.overlap:.2g}), "
            f"dt/t_c {self.flow.step:.3g}: W {percent(self.change, '+.2f')} +- {percent(self.error, '.2f')} "
            f"({self.seeds} seeds), by the fit {percent(self.fitted, '+.2f')}"
        )


@dataclass(frozen=True)
class Calibrated:
    """Effect of numerics on W in one scene.

    Args:
        slopes: Slopes of ln W with their errors.
        changes: Effect of each setting.
        effects: Entry of a calibration file.
    """

    slopes: Slopes
    changes: tuple[Change, ...]
    effects: Effects

    def lines(self) -> list[str]:
        """Slopes and effects as lines of text."""
        here, errors = self.effects.here, np.sqrt(np.diag(self.slopes.covariance))
        words = ("overlap", "(dt/t_c)^2", "overlap while filling")
        slope_lines = (
            f"d ln W/d {w} = {v:.3g} +- {e:.2g}"
            for w, v, e in zip(words, self.slopes.values, errors, strict=True)
            if math.isfinite(e)
        )
        bend = () if self.slopes.curvature is None else (_in_words(self.slopes),)
        precisions = (("flow", self.slopes.mixed_flow), ("flow and filling", self.slopes.mixed))
        rounded = (
            f"{setting} in mixed precision: W {percent(effect[0], '+.2f')} +- {percent(math.sqrt(effect[1]), '.2f')}"
            for setting, effect in precisions
            if effect is not None
        )
        return [
            f"{here.law}, D/d = {here.ratio:.3g}, friction {here.friction:g}, restitution {here.restitution:g}, "
            f"rolling friction {here.rolling:g}: {self.slopes.runs} runs from {self.slopes.beds} beds",
            *(change.line() for change in self.changes),
            *slope_lines,
            *bend,
            *rounded,
            f"scatter between seeds {percent(self.slopes.between, '.2f')}, "
            f"between settings in one bed {percent(self.slopes.within, '.2f')}",
        ]


def _in_words(slopes: Slopes) -> str:
    """The quadratic term of a scene."""
    assert slopes.curvature is not None
    value, (*_, variance) = slopes.curvature
    why = f"ln W is not linear in the overlap (p = {slopes.curvature_p:.2g})"
    return f"d ln W/d overlap^2 = {value:.3g} +- {math.sqrt(variance):.2g}: {why}"


def calibrate(name: str, points: Sequence[PointResult]) -> tuple[Calibrated, ...]:
    """The calibration that the points of the study `name` give, for every scene that has enough runs. Where ln W is not
    linear in the overlap, by a test that all scenes share, it has a quadratic term. Raises NotCalibrated where no scene
    has enough runs."""
    if not points:
        raise NotCalibrated("no run is finished")
    scenes: dict[str, list[PointResult]] = defaultdict(list)
    for result in points:
        scenes[_scene_key(result)].append(result)
    makers = sorted({f"{run.backend} version {run.cache_version}" for point in points for run in point.runs})
    runs = sum(len(values_by_run(point, FLOW_RATE)) for point in points)
    source = f"{name}, {runs} runs on {', '.join(makers)}, {datetime.now(UTC):%Y-%m-%d}"
    calibrated, reasons = [], []
    for some in scenes.values():
        try:
            calibrated.append((some, _scene(some, source)))
        except ValueError as reason:
            reasons.append(f"{some[0].label}: {reason}")
    if not calibrated:
        raise NotCalibrated(reasons[0])
    bends = curved([calibration.slopes.curvature_p for _, calibration in calibrated])
    return tuple(
        _scene(of_scene, source, bend) if bend else calibration
        for (of_scene, calibration), bend in zip(calibrated, bends, strict=True)
    )


def _scene(points: Sequence[PointResult], source: str, bend: bool = False) -> Calibrated:
    """Of one scene with several numerics. Raises ValueError for too few runs, or for those by an older law."""
    if outdated := next((run.outdated for result in points for run in result.runs if run.outdated), ""):
        raise ValueError(f"its runs are stale ({outdated}); labbook run makes them again")
    numerics = {result.point.index: flow_and_filling(result.point) for result in points}
    observed = [run for result in points for run in _observed(result, *numerics[result.point.index])]
    slopes, effects = effects_of_scene(observed, list(numerics.values()), source, bend)
    return Calibrated(slopes, tuple(_changes(points, numerics, slopes)), effects)


def effects_of_scene(
    observed: Sequence[Observation], numerics: Sequence[tuple[Groups, Groups]], source: str, bend: bool = False
) -> tuple[Slopes, Effects]:
    """Regress ln W of one scene by its numerics.

    Args:
        observed: Its runs.
        numerics: Groups of the flow and of the filling of each setting.
        source: Study, number of runs, backend and date, in words.
        bend: Whether ln W has a quadratic term in the overlap.

    Returns:
        The slopes, and the entry of a calibration file.

    Raises:
        ValueError: Too few runs.
    """
    slopes = regress(observed, bend)
    groups = [group for pair in numerics for group in pair]
    overlap, step = max(group.overlap for group in groups), max(flow.step for flow, _ in numerics)
    return slopes, Effects(
        here=replace(groups[0], overlap=overlap, step=step),
        slopes=tuple(slopes.values.tolist()),
        covariance=tuple(tuple(row) for row in slopes.covariance.tolist()),
        freedom=slopes.freedom,
        scatter=slopes.between,
        source=source,
        mixed=slopes.mixed,
        curvature=slopes.curvature,
    )


def flow_and_filling(point: Point) -> tuple[Groups, Groups]:
    """The dimensionless groups of a point's flow and of its filling. Raises NotCalibrated."""
    scene, numerics = point.scene, point.numerics
    own = point.fill.numerics or numerics
    flow, filled = (groups(scene, chosen.dt, chosen.stiffness_scale) for chosen in (numerics, own))
    if flow is None or filled is None:
        raise NotCalibrated("scenes with such an outlet, bed or materials cannot be calibrated")
    return flow, filled


def _scene_key(point: PointResult) -> str:
    """Swept values other than numerics, as a text that is equal for the points of one scene."""
    return repr(
        [(key, value) for key, value in point.at.items() if not key.startswith(("numerics.", "fill.numerics."))]
    )


def _observed(point: PointResult, flow: Groups, filled: Groups) -> list[Observation]:
    rates, mixed = values_by_run(point, FLOW_RATE), are_mixed(point.point)
    return [Observation(run.packing_key, filled.overlap, flow.overlap, flow.step, rate, *mixed) for run, rate in rates]


def are_mixed(point: Point) -> tuple[bool, bool]:
    """Tell whether flow and filling of a point are in mixed precision."""
    flow = point.numerics
    return flow.precision == "mixed", (point.fill.numerics or flow).precision == "mixed"


def _changes(points: Sequence[PointResult], numerics: dict[int, tuple[Groups, Groups]], slopes: Slopes) -> list[Change]:
    changes = []
    first = points[0]
    (reference, bed), a = numerics[first.point.index], by_seed(first, FLOW_RATE)
    for point in points:
        (flow, filled), b = numerics[point.point.index], by_seed(point, FLOW_RATE)
        change = np.array([math.log(b[seed] / a[seed]) for seed in sorted(a.keys() & b.keys())])
        x = [flow.overlap - reference.overlap, flow.step**2 - reference.step**2, filled.overlap - bed.overlap]
        bend = slopes.curvature[0] * (flow.overlap**2 - reference.overlap**2) if slopes.curvature else 0.0
        error = float(change.std(ddof=1)) / math.sqrt(len(change)) if len(change) > 1 else math.nan
        mean = float(change.mean()) if len(change) else math.nan
        fitted = (
            float(slopes.values @ x)
            + bend
            + _rounding(slopes, *are_mixed(point.point))
            - _rounding(slopes, *are_mixed(first.point))
        )
        changes.append(Change(point.label, flow, filled, mean, error, len(change), fitted))
    return changes


def _rounding(slopes: Slopes, flow: bool, filled: bool) -> float:
    """Change of ln W by mixed precision, from the fit; 0 for what was not measured."""
    of_flow = slopes.mixed_flow[0] if slopes.mixed_flow else 0.0
    of_filling = slopes.mixed[0] - of_flow if slopes.mixed else 0.0
    return of_flow * flow + of_filling * filled
