"""How the bed of a point flows: mean velocities of its recorded run, and one moment of it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from labbook.fields import Fields, Layer, Pattern, coarse_grain, grains_of, pattern_of
from labbook.scene import WedgeHopper

if TYPE_CHECKING:
    from labbook.report.analysis import PointResult

FEWEST = 8
"""Recorded frames within the window below which there is no mean field."""
CELL = 0.5
"""Width of a cell, and omega, in grain diameters."""


@dataclass(frozen=True, eq=False)
class FlowPattern:
    """Fields of the recorded run of a point, averaged over the window of its flow rate; `moment`: rows of one frame."""

    result: "PointResult"
    hopper: WedgeHopper
    fields: Fields
    pattern: Pattern
    moment: Mapping[str, np.ndarray]
    frames: int


def flow_pattern(result: "PointResult") -> FlowPattern | None:
    """The pattern of the first recorded run of a point that flowed; None without one, or with too few frames."""
    scene = result.point.scene
    hopper = scene.container
    for run in result.runs if isinstance(hopper, WedgeHopper) else ():
        window = run.trace.window if run.trace is not None else None
        frames = run.frames() if window is not None else None
        if window is None or frames is None:
            continue
        time = np.asarray(frames["time"], float)
        times = np.unique(time[(time >= window[0]) & (time <= window[1])])
        if len(times) < FEWEST:
            continue
        assert isinstance(hopper, WedgeHopper)
        grains = grains_of(frames, scene.grains.mass, np.pi / 6 * scene.grains.diameter**3, *window)
        fields = coarse_grain(_grid(hopper, scene.grains.diameter, grains.x), CELL * scene.grains.diameter, grains)
        now = time == times[len(times) // 2]
        moment = {name: np.asarray(frames[name], float)[now] for name in ("x", "z", "vx", "vz")}
        return FlowPattern(result, hopper, fields, pattern_of(fields), moment, len(times))
    return None


def _grid(hopper: WedgeHopper, d: float, x: np.ndarray) -> Layer:
    """From below the outlet to above the highest grain."""
    cell, half = CELL * d, hopper.width / 2
    low, high = -2 * d, float(x[:, 2].max()) + d
    return Layer(
        (-half, half), (low, high), max(1, round(2 * half / cell)), max(1, round((high - low) / cell)), hopper.thickness
    )
