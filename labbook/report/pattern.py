"""How the bed of a point flows: mean velocities of its recorded runs, one moment of one, means above the orifice."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from labbook.fields import Fields, Layer, Pattern, Ring, coarse_grain, orifice_means, pattern_of
from labbook.measure.acceleration import AccelerationProfile, acceleration_profile, pooled_profile
from labbook.measure.bed import bed_grid, grains_between, omega_of
from labbook.measure.orifice import BINS, INTERVAL, UP_TO
from labbook.report.points import PointResult, RunResult
from labbook.scene import WedgeHopper
from labbook.stats import Pooled, pool

FEWEST = 8
"""Recorded frames within the window below which there is no mean field."""
_MOMENT = 1.0  # s
_FEWEST_ABOUT_AN_INSTANT = 4  # frames: means over the azimuth of few already tell maps


@dataclass(frozen=True, eq=False)
class Section:
    """Fields in the plane y = 0: x and z [m] of points, and of shape [z, x] velocities u along x, w along z [m/s]."""

    x: np.ndarray
    z: np.ndarray
    u: np.ndarray
    w: np.ndarray
    bed: np.ndarray
    stagnant: np.ndarray


@dataclass(frozen=True, eq=False)
class FlowPattern:
    """Fields of a recorded run, averaged over the window of its flow rate; `moment`: rows of one frame near y = 0.

    `orifice`: means above the orifice, by quantity (`labbook.fields.orifice_means`).
    """

    result: PointResult
    container: Any
    fields: Fields
    pattern: Pattern
    orifice: Mapping[str, float]
    moment: Mapping[str, np.ndarray]
    frames: int
    window: tuple[float, float]
    """Begin and end [s]."""

    def section(self) -> Section:
        """The plane y = 0; what is averaged over the azimuth appears on both sides of the axis."""
        grid, v, p = self.fields.grid, self.fields.velocity, self.pattern
        if isinstance(grid, Layer):
            z, x = grid.points
            return Section(x, z, v[0], v[2], p.bed, p.stagnant)
        assert isinstance(grid, Ring)
        x, z = across(grid)
        return Section(x, z, both(v[0], -1.0), both(v[2]), both(p.bed), both(p.stagnant))


def across(grid: Ring) -> tuple[np.ndarray, np.ndarray]:
    """x and z [m] of a plane through the axis, on both of its sides."""
    r, z = grid.points
    return np.concatenate([-r[::-1], r]), z


def both(a: np.ndarray, sign: float = 1.0) -> np.ndarray:
    """A field over r and z on both sides of the axis, shape [z, x]; on the left times `sign`."""
    return np.concatenate([a[::-1] if sign == 1 else sign * a[::-1], a]).T


def flow_patterns(result: PointResult) -> list[FlowPattern]:
    """The patterns of all recorded runs of a point that flowed and have frames enough.

    Of quasi-2D hoppers and of silos round the axis; there are none of other containers.
    """
    container = result.point.scene.container
    if not isinstance(container, WedgeHopper) and not hasattr(container, "diameter"):
        return []
    return [found for run in result.runs if (found := _of_run(result, run)) is not None]


def acceleration(result: PointResult) -> AccelerationProfile | None:
    """Acceleration against height in the middle of the outlet, up to half of its half width.

    The mean over the runs of a point that measured `orifice`, else of its first recorded run; None without any, or with
    frames too far apart.
    """
    measured = [run.acceleration for run in result.runs if run.acceleration is not None]
    if measured:
        return pooled_profile(measured)
    scene, D = result.point.scene, result.orifice
    hopper = scene.container if isinstance(scene.container, WedgeHopper) else None
    for run in result.runs:
        window = run.trace.window if run.trace is not None else None
        frames = run.frames() if window is not None else None
        if window is None or frames is None:
            continue
        try:
            return acceleration_profile(
                frames,
                interval=INTERVAL,
                radius=D / 4,
                edges=np.linspace(0.0, UP_TO * D, BINS + 1),
                gravity=scene.gravity,
                begin=window[0],
                end=window[1],
                centre=hopper.eccentricity if hopper else 0.0,
                planar=hopper is not None,
            )
        except ValueError:
            continue
    return None


def pooled_means(patterns: list[FlowPattern]) -> dict[str, Pooled]:
    """Means above the orifice and the stagnant part of the bed, pooled over recorded runs; where the point measured
    `orifice`, its means are those of all runs."""
    rows = [{**one.orifice, "stagnant_fraction": one.pattern.fraction} for one in patterns]
    measured = patterns[0].result.pooled if patterns else {}
    means = {name: pool([row[name] for row in rows]) for name in rows[0]} if rows else {}
    return {name: measured.get(f"orifice_{name}", mean) for name, mean in means.items()}


def _of_run(result: PointResult, run: RunResult) -> FlowPattern | None:
    window = run.trace.window if run.trace is not None else None
    frames = run.frames() if window is not None else None
    return None if window is None or frames is None else _between(result, frames, window)


def moments(result: PointResult, count: int = 3) -> list[FlowPattern]:
    """The first recorded run of a point within 1 s (a part of the window, if that is shorter) about `count` instants of
    the window of its flow rate (Pongo et al. 2022, Figs 6 and 7); empty where there are too few frames."""
    for run in result.runs:
        window = run.trace.window if run.trace is not None else None
        frames = run.frames() if window is not None else None
        if window is None or frames is None:
            continue
        part = (window[1] - window[0]) / count
        middles = window[0] + part * (np.arange(count) + 0.5)
        half = min(_MOMENT, part) / 2
        spans = [(middle - half, middle + half) for middle in middles]
        found = [_between(result, frames, span, _FEWEST_ABOUT_AN_INSTANT) for span in spans]
        return [one for one in found if one is not None]
    return []


def _between(
    result: PointResult, frames: Mapping[str, np.ndarray], window: tuple[float, float], fewest: int = FEWEST
) -> FlowPattern | None:
    time = np.asarray(frames["time"], float)
    times = np.unique(time[(time >= window[0]) & (time <= window[1])])
    if len(times) < fewest:
        return None
    scene = result.point.scene
    grains, omega = grains_between(scene, frames, *window), omega_of(scene)
    fields = coarse_grain(bed_grid(scene, omega, grains.x), omega, grains)
    middle = 0.0 if not isinstance(scene.container, WedgeHopper) else scene.container.eccentricity
    above = orifice_means(fields, result.orifice, centre=middle)
    now = (time == times[len(times) // 2]) & (np.abs(frames["y"]) <= scene.grains.equivalent_diameter / 2)
    moment = {name: np.asarray(frames[name], float)[now] for name in ("x", "z", "vx", "vz")}
    return FlowPattern(result, scene.container, fields, pattern_of(fields), above, moment, len(times), window)
