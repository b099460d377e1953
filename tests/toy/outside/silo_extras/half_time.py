"""A measure of another package, with a number and an array."""

import math

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Probe
from labbook.measure import Evaluation, Measure, MeasureError, Quantity, RunData, Window
from labbook.scene import Scene
from labbook.stats import Measured


class HalfTime(Measure):
    """The time until half of the grains of a run that left had left. Array: the `times` of all."""

    name = "half_time"
    version = 1
    declared = (Quantity("half_time", "t½", "s", "time until half of the grains had left", "ms", 1e3),)

    def check(self, scene: Scene) -> None:
        if scene.container.outlet_plane is None:
            raise MeasureError("half_time needs an outlet", "take half_time out of measure")

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        assert scene.container.outlet_plane is not None
        return (Crossing(scene.container.outlet_plane),)

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        times = np.sort(run.tables["crossing"]["time"])
        number = Measured("half_time", float(np.median(times)), math.nan, len(times), "all grains", "median", "s")
        return Evaluation((number,), {"times": times})
