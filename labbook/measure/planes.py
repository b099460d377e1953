"""Mass flow rates through horizontal planes beside the outlet, such as in a pipe below it."""

import math
from collections.abc import Iterator

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Above, Crossing, Probe
from labbook.measure.data import RunData
from labbook.measure.flow import FlowRate
from labbook.measure.ledger import ledger_interval
from labbook.measure.measure import (
    Evaluation,
    Measure,
    MeasureError,
    Quantity,
    Window,
    flow_suffix,
    while_flowing,
    window_in_words,
)
from labbook.measure.series import mean_mass
from labbook.measure.steady import BLOCKS, outflow
from labbook.scene import Scene
from labbook.scene.container_shape import CountingPlane
from labbook.stats import Measured

NAME = "planes"
_FEWEST = 4
"""Parts of the window from which an error is taken, at least."""


class PlaneRates(Measure):
    """Measure the mass flow rate W through each plane of `container.planes`, in the window of the outlet.

    Quantities:
        flow_rate_NAME: Change of the mass above the plane NAME over the window [kg/s], with an error from twelve parts
            of it, or from all samples if there are fewer. For a run that clogged the name ends in `_flowing`.
        mass_below_NAME: Mass that is below the plane at the last sample or has left, also that in a bin [kg].

    Arrays:
        time: Sampled times [s], shape [n].
        above: Mass above each plane [kg], shape [n, p].

    Raises:
        MeasureError: There are no planes or no outlet, or the silo is fed.
    """

    name = NAME
    version = 1
    needs_all = True
    declared = ()

    def check(self, scene: Scene) -> None:
        FlowRate().check(scene)
        if not scene.container.planes:
            reason = "planes gives flow rates through planes, and container.planes has none"
            raise MeasureError(reason, "state container.planes: [{name: pipe, z: -80 mm}], or measure something else")
        if scene.feed is not None:
            reason = "planes follows the mass above a plane, to which grains that are fed add"
            raise MeasureError(reason, "take planes out of measure, or leave feed out")

    def quantities(self, scene: Scene) -> tuple[Quantity, ...]:
        """List the rate and the mass of each plane."""
        rates = [_rate(plane) for plane in scene.container.planes]
        return (*rates, *map(while_flowing, rates), *(_mass(plane) for plane in scene.container.planes))

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        self.check(scene)
        outlet, heights = scene.container.outlet_plane, tuple(plane.z for plane in scene.container.planes)
        assert outlet is not None
        return Crossing(outlet), Above(heights, every=ledger_interval(scene, numerics))

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        self.check(run.scene)
        if "above" not in run.tables:
            raise MeasureError("planes: the run recorded no masses above planes; run it again with this measure")
        table, count = run.tables["above"], len(run.scene.container.planes)
        # the probe has a row for each plane and sample, in the order of the planes
        time = np.asarray(table["time"], float)[::count]
        above = np.asarray(table["mass"], float).reshape(-1, count)
        return Evaluation(tuple(_numbers(run, window, time, above)), {"time": time, "above": above})


def _numbers(run: RunData, window: Window, time: np.ndarray, above: np.ndarray) -> Iterator[Measured]:
    flow, _ = outflow(run, window)
    total, suffix = mean_mass(run) * len(run.start), flow_suffix(run)
    inside = np.flatnonzero((time >= flow.begin) & (time <= flow.end)) if flow is not None else np.zeros(0, np.int64)
    for index, plane in enumerate(run.scene.container.planes):
        name = _rate(plane).name + suffix
        blocks = min(BLOCKS, len(inside) - 1)
        if blocks < _FEWEST:
            note = f"too few samples within the window: {len(inside)}, not {_FEWEST + 1}; lower numerics.steps_per_beat"
            yield Measured(name, math.nan, math.nan, 0, window_in_words(window), "mass above", "kg/s", note)
        else:
            ends = inside[np.linspace(0, len(inside) - 1, blocks + 1).round().astype(int)]
            rates = -np.diff(above[ends, index]) / np.diff(time[ends])
            value = (above[ends[0], index] - above[ends[-1], index]) / (time[ends[-1]] - time[ends[0]])
            error = float(rates.std(ddof=1)) / math.sqrt(blocks)
            where = f"{time[ends[0]]:.4g} s to {time[ends[-1]]:.4g} s"
            how = f"change of the mass above z = {1e3 * plane.z:g} mm; error from {blocks} parts of the window"
            yield Measured(name, float(value), error, blocks, where, how, "kg/s", "")
        if len(time):
            where, how = f"at {time[-1]:.4g} s", "mass of all grains less that above the plane"
            yield Measured(_mass(plane).name, total - float(above[-1, index]), math.nan, 1, where, how, "kg", "")


def _rate(plane: CountingPlane) -> Quantity:
    meaning = f"mass flow rate through the plane {plane.name} in the window"
    return Quantity(f"flow_rate_{plane.name}", f"W at {plane.name}", "kg/s", meaning, "g/s", 1e3)


def _mass(plane: CountingPlane) -> Quantity:
    meaning = f"mass below the plane {plane.name} at the end of the run, with what has left"
    return Quantity(f"mass_below_{plane.name}", f"mass below {plane.name}", "kg", meaning, "g", 1e3)
