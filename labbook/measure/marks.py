"""Marks at planes: the time from the passage of a plane above the outlet until the grain leaves, of recorded runs."""

import math
from collections.abc import Iterator, Mapping

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe
from labbook.measure.data import RunData
from labbook.measure.flow import FlowRate
from labbook.measure.measure import Evaluation, Measure, Quantity, Window
from labbook.measure.residence import LEFT_OVER, moments, survival
from labbook.measure.steady import outflow
from labbook.scene import Scene
from labbook.scene.container_shape import CountingPlane
from labbook.stats import Measured

_FEWEST = 60
"""Marked grains below which no time is given."""
HALF = 0.5
PREFIX = "marks."


class Marks(Measure):
    """Measure times from a plane of `container.planes` above the outlet to the outlet, of a recorded run.

    A grain is marked when it first passes the plane downwards, after the opening or after its last return. The passage
    is interpolated between two frames. Marks are those of the window of the flow rate; times that have not ended with
    it are censored (Kaplan-Meier). If more than 1 % of the times are longer than the window, as where grains are caught
    in a corner, mean and variance are NaN with a note.

    Quantities:
        marks.NAME.median: Median time from the plane NAME [s].
        marks.NAME: Mean time [s].
        marks.NAME.variance: Variance of the time over the square of its mean.

    Raises:
        MeasureError: The container has no outlet.
    """

    name = "marks"
    version = 1
    declared = ()

    def check(self, scene: Scene) -> None:
        FlowRate().check(scene)

    def quantities(self, scene: Scene) -> tuple[Quantity, ...]:
        """List the times of each plane above the outlet."""
        return tuple(quantity for plane in planes_above(scene) for quantity in _quantities(plane))

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        return ()

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        self.check(run.scene)
        flow, _ = outflow(run, window)
        frames = run.frames() if flow is not None and planes_above(run.scene) else None
        if flow is None or frames is None:
            return Evaluation()
        crossing = run.tables["crossing"]
        left = np.asarray(crossing["id"]), np.asarray(crossing["time"], float)
        numbers: list[Measured] = []
        for plane in planes_above(run.scene):
            grain, time = first_passages(frames, plane.z, *left)
            begun = (time >= flow.begin) & (time < flow.end)
            until = _next(grain[begun], time[begun], *left)
            ended = until <= flow.end
            numbers += _numbers(plane, np.where(ended, until, flow.end) - time[begun], ended, flow.begin, flow.end)
        return Evaluation(tuple(numbers))


def planes_above(scene: Scene) -> tuple[CountingPlane, ...]:
    """Planes of the container above its outlet."""
    outlet = scene.container.outlet_plane
    return () if outlet is None else tuple(plane for plane in scene.container.planes if plane.z > outlet)


def first_passages(
    frames: Mapping[str, np.ndarray], z: float, left: np.ndarray, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find the first downward passage of each grain through the plane at `z`, and the first after each of its returns.

    Args:
        frames: Recorded frames with the columns id, time [s] and z [m].
        z: Height of the plane [m].
        left: Identity of the grain of each passage of the outlet, shape [n].
        at: Time of these passages [s].

    Returns:
        Identity of the grain and time [s] of each passage, interpolated between frames.
    """
    grain, time, height = (np.asarray(frames[name]) for name in ("id", "time", "z"))
    order = np.lexsort((time, grain))
    grain, time, height = grain[order], time[order].astype(float), height[order].astype(float)
    down = (grain[1:] == grain[:-1]) & (height[:-1] >= z) & (height[1:] < z)
    fraction = (height[:-1][down] - z) / (height[:-1][down] - height[1:][down])
    passed, when = grain[1:][down], time[:-1][down] + fraction * np.diff(time)[down]
    turn = _passages_before(passed, when, left, at)
    first = np.ones(len(passed), bool)
    first[1:] = (passed[1:] != passed[:-1]) | (turn[1:] != turn[:-1])
    return passed[first], when[first]


def _passages_before(grain: np.ndarray, time: np.ndarray, left: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Number of passages of the outlet, in the order of grains and times, up to each grain and time."""
    order = np.lexsort((at, left))
    # Records compare by their first field, then by the second: one sorted list serves all grains.
    keys = np.rec.fromarrays([left[order], at[order]])
    return np.searchsorted(keys, np.rec.fromarrays([grain.astype(left.dtype), time]))


def _next(grain: np.ndarray, time: np.ndarray, left: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Time [s] of the next passage of the outlet of each grain; infinite without any."""
    order = np.lexsort((at, left))
    index = _passages_before(grain, time, left, at)
    there = np.append(left[order], -1)[index] == grain  # -1: no grain is behind the last passage
    return np.where(there, np.append(at[order], math.inf)[index], math.inf)


def _quantities(plane: CountingPlane) -> tuple[Quantity, ...]:
    name, way = f"{PREFIX}{plane.name}", f"from the plane {plane.name} to the outlet"
    return (
        Quantity(f"{name}.median", f"median from {plane.name}", "s", f"median time {way}"),
        Quantity(name, f"⟨t⟩ from {plane.name}", "s", f"mean time {way}"),
        Quantity(
            f"{name}.variance", f"σ²/⟨t⟩^(2) from {plane.name}", "", f"variance of the time {way} over its mean squared"
        ),
    )


def _numbers(
    plane: CountingPlane, duration: np.ndarray, ended: np.ndarray, begin: float, end: float
) -> Iterator[Measured]:
    median = mean = variance = math.nan
    few = note = f"fewer than {_FEWEST} grains passed the plane {plane.name} and left within the window"
    if ended.sum() >= _FEWEST:
        age, longer = survival(duration, ended)
        half = np.flatnonzero(longer <= HALF)
        median, few = (float(age[half[0]]), "") if len(half) else (math.nan, "half of the grains take longer")
        note = f"{100 * longer[-1]:.2g} % of the grains take longer than {age[-1]:.3g} s; let the run last longer"
        if longer[-1] <= LEFT_OVER:
            (mean, spread), note = moments(age, longer), ""
            variance = spread / mean**2
    where = f"{begin:.4g} s to {end:.4g} s"
    how = f"from the first passage of z = {1e3 * plane.z:g} mm in recorded frames to the outlet; error from seeds only"
    for quantity, value, lacking in zip(_quantities(plane), (median, mean, variance), (few, note, note), strict=True):
        yield Measured(quantity.name, value, math.nan, int(ended.sum()), where, how, quantity.unit, lacking)
