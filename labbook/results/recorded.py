"""Flow pattern of a point: mean velocities of its recorded runs, one frame of one run, means above the orifice."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from labbook.fields import Fields, Layer, Pattern, Ring
from labbook.measure.acceleration import AccelerationProfile, pooled_profile
from labbook.measure.recorded import Bed, FlowMoments, FlowPattern, FreeFall, KindPatterns
from labbook.results.points import PointResult, RunResult
from labbook.stats import Pooled, pool


@dataclass(frozen=True, eq=False)
class PlaneSection:
    """Fields in the plane y = 0: x and z [m] of points, and of shape [z, x] velocities u along x, w along z [m/s]."""

    x: np.ndarray
    z: np.ndarray
    u: np.ndarray
    w: np.ndarray
    bed: np.ndarray
    stagnant: np.ndarray


@dataclass(frozen=True, eq=False)
class Flowing:
    """Fields of a recorded run of a point, averaged over some time; `orifice`: means above the orifice and the stagnant
    fraction, by name, where they were taken."""

    result: PointResult
    bed: Bed
    orifice: Mapping[str, float]

    @property
    def container(self) -> Any:
        """Of the point."""
        return self.result.point.scene.container

    @property
    def fields(self) -> Fields:
        """Mean fields."""
        return self.bed.fields

    @property
    def pattern(self) -> Pattern:
        """Bed and stagnant zone on the grid."""
        return self.bed.pattern

    @property
    def moment(self) -> Mapping[str, np.ndarray]:
        """Rows of one frame near y = 0."""
        return self.bed.moment

    @property
    def frames(self) -> int:
        """Number of averaged frames."""
        return self.bed.frames

    @property
    def window(self) -> tuple[float, float]:
        """Begin and end [s]."""
        return self.bed.window

    def section(self) -> PlaneSection:
        """The plane y = 0; what is averaged over the azimuth appears on both sides of the axis."""
        grid, v, p = self.fields.grid, self.fields.velocity, self.pattern
        if isinstance(grid, Layer):
            z, x = grid.points
            return PlaneSection(x, z, v[0], v[2], p.bed, p.stagnant)
        assert isinstance(grid, Ring)
        x, z = across(grid)
        return PlaneSection(x, z, both(v[0], -1.0), both(v[2]), both(p.bed), both(p.stagnant))


def across(grid: Ring) -> tuple[np.ndarray, np.ndarray]:
    """x and z [m] of a plane through the axis, on both of its sides."""
    r, z = grid.points
    return np.concatenate([-r[::-1], r]), z


def both(a: np.ndarray, sign: float = 1.0) -> np.ndarray:
    """A field over r and z on both sides of the axis, shape [z, x]; on the left times `sign`."""
    return np.concatenate([a[::-1] if sign == 1 else sign * a[::-1], a]).T


def flow_patterns(result: PointResult) -> list[Flowing]:
    """The patterns of all recorded runs of a point that flowed and have frames enough; none where nothing was recorded.

    Of quasi-2D hoppers and of silos round the axis; there are none of other containers. Raises ImportError without
    Numba, unless they were evaluated before.
    """
    return [found for run in _recorded(result) if (found := _of_run(result, run)) is not None]


def kind_patterns(result: PointResult) -> dict[str, Flowing]:
    """Mean fields of each kind of grains in the first recorded run of a point that flowed, by name; none without
    kinds. Raises ImportError without Numba, unless they were evaluated before."""
    kinds = result.point.scene.grains.kinds
    for run in _recorded(result) if kinds else ():
        evaluation = run.evaluation(KindPatterns())
        beds = {kind.name: Bed.of(evaluation, kind.name) for kind in kinds}
        return {name: Flowing(result, bed, {}) for name, bed in beds.items() if bed is not None}
    return {}


def moments(result: PointResult) -> list[Flowing]:
    """The first recorded run of a point about three instants of the window of its flow rate (Pongo et al. 2022, Figs 6
    and 7); empty where there are too few frames."""
    for run in _recorded(result):
        if run.trace is not None and run.trace.window is not None:
            return [Flowing(result, bed, {}) for bed in FlowMoments.beds(run.evaluation(FlowMoments()))]
    return []


def acceleration(result: PointResult) -> AccelerationProfile | None:
    """Acceleration against height in the middle of the outlet, up to half of its half width.

    The mean over the runs of a point that measured `orifice`, else of its first recorded run; None without any, or with
    frames too far apart.
    """
    beds: dict[int, list[AccelerationProfile]] = {}
    for run in result.runs:
        if run.counted and run.acceleration is not None:
            beds.setdefault(run.seed, []).append(run.acceleration)
    if beds:
        return pooled_profile([pooled_profile(discharges) for discharges in beds.values()])
    profiles = (AccelerationProfile.of(run.evaluation(FreeFall())) for run in _recorded(result))
    return next((profile for profile in profiles if profile is not None), None)


def pooled_means(patterns: list[Flowing]) -> dict[str, Pooled]:
    """Means above the orifice and the stagnant part of the bed, pooled over recorded runs; where the point measured
    `orifice`, its means are those of all runs."""
    rows = [pattern.orifice for pattern in patterns]
    measured = patterns[0].result.pooled if patterns else {}
    names = dict.fromkeys(name for row in rows for name in row)
    means = {name: pool([row[name] for row in rows if name in row]) for name in names}
    # of mean fields: not the mean of what S is in single frames
    measured_names = {name: f"orifice_{'S_of_mean' if name == 'S' else name}" for name in means}
    return {name: measured.get(measured_names[name], mean) for name, mean in means.items()}


def _recorded(result: PointResult) -> list[RunResult]:
    if result.point.scene.container.symmetry is None:
        return []
    return [run for run in result.runs if run.recorded and run.counted]


def _of_run(result: PointResult, run: RunResult) -> Flowing | None:
    evaluation = run.evaluation(FlowPattern())
    bed = Bed.of(evaluation)
    if bed is None:
        return None
    means = {
        number.quantity.removeprefix("orifice."): number.value
        for number in evaluation.numbers
        if math.isfinite(number.value)
    }
    return Flowing(result, bed, means)
