"""Mass flow or funnel flow: velocity at the wall over that in the middle, and material that does not move."""

import math
from collections.abc import Mapping

import numpy as np

from labbook.filling.bed import bed_height
from labbook.measure.data import RunData
from labbook.measure.measure import Evaluation, Quantity, Window
from labbook.measure.recorded import OfRecording
from labbook.measure.series import crossings
from labbook.scene import Bodies, Scene
from labbook.stats import Measured

BAND = 2.0
"""Height of the bands of the mass-flow index, in diameters d of the largest grains."""
AT_WALL, IN_MIDDLE = 1.0, 1.5
"""Distance from the outermost centres, and from the axis, within which grains count as at the wall and in the middle,
in d."""
STILL = 0.1
"""Displacement below which a grain has not moved, in d."""
HALF = 0.5
"""Discharged fraction of the mass at which displacements are judged."""
_FEWEST = 50


class FlowRegime(OfRecording):
    """Measure the mass-flow index and the stagnant fraction of a recorded run.

    Quantities:
        regime.mass_flow_index: Mean v_z at the wall over that in the middle, within the window of the flow rate, in
            the band at half of the initial height of the bed. It is 1 if the section sinks as a whole, and 0 if
            material at the wall stands still.
        regime.still: Fraction of the initial mass that has moved by less than 0.1 d when half has left.

    Arrays:
        height: Height of the middle of each band above the outlet [m], shape [n].
        index: Mass-flow index of each band, shape [n]; NaN for fewer than 50 grains at the wall or in the middle,
            over all frames.

    Raises:
        MeasureError: The container is neither planar nor axisymmetric, or has no outlet.
    """

    name = "flow_regime"
    version = 1
    declared = (
        Quantity("regime.mass_flow_index", "MFI", "", "velocity at the wall over that in the middle of a silo"),
        Quantity("regime.still", "not moved", "", "mass that has not moved when half has left", "%", 100),
    )

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        profile = super().evaluate(run, window)
        frames = run.frames()
        if frames is None:
            return profile
        height = bed_height(run.scene.grains, run.start, run.scene.container.outlet_plane or 0.0)
        return Evaluation((*_at_half(profile, height), *_still(run, frames)), profile.arrays)

    def of(
        self, scene: Scene, frames: Mapping[str, np.ndarray], window: Window, times: tuple[float, float]
    ) -> Evaluation:
        time = np.asarray(frames["time"], float)
        within = (time >= times[0]) & (time <= times[1])
        if not within.any():
            return Evaluation()
        x, z, speed = (np.asarray(frames[name], float)[within] for name in ("x", "z", "vz"))
        d, outlet = scene.grains.diameter, scene.container.outlets[0]
        if scene.container.symmetry == "axial":
            off = np.hypot(x, np.asarray(frames["y"], float)[within])
            to_wall, middle = off, off < IN_MIDDLE * d
        else:
            to_wall, middle = np.abs(x), np.abs(x - outlet.centre) < IN_MIDDLE * d
        band = np.floor((z - outlet.plane) / (BAND * d)).astype(np.int64)
        bands = np.arange(0, max(int(band.max()), 0) + 1)
        index = np.array([_index(to_wall[band == k], middle[band == k], speed[band == k], d) for k in bands])
        return Evaluation(arrays={"height": (bands + 0.5) * BAND * d, "index": index})


def _index(to_wall: np.ndarray, middle: np.ndarray, speed: np.ndarray, d: float) -> float:
    """Mean velocity at the wall over that in the middle of one band; NaN of too few grains."""
    if not len(to_wall):
        return math.nan
    # From the outermost grain of the band, not from the container: the wall of a hopper is inclined.
    wall = to_wall > to_wall.max() - AT_WALL * d
    if wall.sum() < _FEWEST or middle.sum() < _FEWEST:
        return math.nan
    return float(speed[wall].mean() / speed[middle].mean())


def _at_half(profile: Evaluation, height: float) -> tuple[Measured, ...]:
    if "index" not in profile.arrays:
        return ()
    heights, index = profile.arrays["height"], profile.arrays["index"]
    k = int(np.argmin(np.abs(heights - height / 2)))
    where = f"window of the flow rate, {heights[k] * 1e3:.4g} mm above the outlet"
    note = "" if math.isfinite(index[k]) else "too few grains at the wall or in the middle at this height"
    return (Measured("regime.mass_flow_index", float(index[k]), math.nan, 1, where, "recorded frames", "", note),)


def _still(run: RunData, frames: Mapping[str, np.ndarray]) -> tuple[Measured, ...]:
    times, weights = crossings(run)
    passed = np.cumsum(weights) / len(run.start)
    if run.scene.feed is not None or not len(passed) or passed[-1] < HALF:
        return ()
    at = times[np.searchsorted(passed, HALF)]
    time = np.asarray(frames["time"], float)
    frame = np.unique(time)
    near = frame[np.argmin(np.abs(frame - at))]
    now = time == near
    rows = run.start.rows(np.asarray(frames["id"])[now])
    moved = np.column_stack([np.asarray(frames[axis], float)[now] for axis in "xyz"]) - run.start.x[rows]
    mass = Bodies.of(run.scene.grains, run.start).mass
    still = np.linalg.norm(moved, axis=1) < STILL * run.scene.grains.diameter
    value = float(mass[rows][still].sum() / mass.sum())
    where = f"frame at {near:.4g} s, as half of the mass has left"
    how = f"displacement below {STILL:g} d since the opening"
    return (Measured("regime.still", value, math.nan, int(still.sum()), where, how, ""),)
