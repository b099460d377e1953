"""A measure: the time until half of the discharged grains had left."""

import math

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Probe
from labbook.measure import Evaluation, Measure, MeasureError, Quantity, RunData, Window
from labbook.scene import Scene
from labbook.stats import Measured


class HalfDischarge(Measure):
    """One number, the half time, and the times [s] at which grains left, as the array `times`."""

    name = "half_discharge"
    version = 1
    source = ""  # the publication of the method, for `labbook cite`
    declared = (Quantity("half_discharge", "t½", "s", "time until half of the discharged grains had left", "ms", 1e3),)

    def check(self, scene: Scene) -> None:
        """Raise MeasureError for a scene without an outlet."""
        if scene.container.outlet_plane is None:
            raise MeasureError("half_discharge needs an outlet", "take half_discharge out of measure")

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        """The first passage of every grain through the outlet."""
        self.check(scene)
        assert scene.container.outlet_plane is not None
        return (Crossing(scene.container.outlet_plane),)

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        """The median of the times at which grains left, after the opening; all grains count, whatever the window."""
        times = np.sort(run.tables["crossing"]["time"])
        if not len(times):
            raise MeasureError("no grain left")
        error = math.nan  # one run does not know it; means over replicates do
        number = Measured("half_discharge", float(np.median(times)), error, len(times), "all grains", "median", "s")
        return Evaluation((number,), {"times": times})
