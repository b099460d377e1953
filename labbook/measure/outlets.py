"""Flow rates of several outlets of one container, by the points at which grains cross the plane of the outlets."""

import math

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Probe
from labbook.measure.data import RunData
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
from labbook.measure.scales import gap
from labbook.measure.series import crossed_outlets, crossings, mean_mass
from labbook.measure.steady import BLOCKS, FEWEST, TimeWindow, outflow, steady_flow
from labbook.scene import Outlet, Scene
from labbook.stats import Measured


class OutletRates(Measure):
    """Measure the mass flow rate W of each outlet of a container with several, in the window of the total flow.

    A grain leaves through the outlet whose lid is nearest to the point at which it crosses the plane. Too few grains of
    an outlet give a rate of NaN with a note.

    Quantities:
        flow_rate_NAME: Mass flow rate [kg/s] of the outlet NAME; of a run that clogged it ends in `_flowing`.

    Arrays:
        outlet: Index of its outlet for each grain that left, in the order of time, shape [n].

    Raises:
        MeasureError: The container has fewer than two outlets.
    """

    name = "outlets"
    version = 1
    declared = ()

    def check(self, scene: Scene) -> None:
        if len(scene.container.outlets) < 2:
            reason = f"outlets tells several outlets apart, and the container ({scene.container.kind}) has no two"
            remedy = "take outlets out of measure, or close each outlet of listed walls by a part with opens: start"
            raise MeasureError(reason, remedy)

    def quantities(self, scene: Scene) -> tuple[Quantity, ...]:
        rates = [_rate(outlet) for outlet in scene.container.outlets]
        return (*rates, *map(while_flowing, rates)) if len(rates) > 1 else ()

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        self.check(scene)
        return (Crossing(scene.container.outlets[0].plane),)

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        self.check(run.scene)
        flow, _ = outflow(run, window)
        times, weights = crossings(run)
        outlets, through = run.scene.container.outlets, crossed_outlets(run)
        within = None if flow is None else TimeWindow(flow.begin, flow.end)
        numbers = []
        for index, outlet in enumerate(outlets):
            mask, name = through == index, _rate(outlet).name + flow_suffix(run)
            outlet_flow = None
            if within is not None:
                outlet_flow = steady_flow(times[mask], len(run.start), within, weights[mask], gap(run.scene, window))
            if within is None or outlet_flow is None:
                few = f"too few grains: {int(mask.sum())} left through {outlet.name}; {FEWEST} in the window are needed"
                where = window_in_words(within or window)
                numbers.append(Measured(name, math.nan, math.nan, 0, where, "crossings", "kg/s", few))
                continue
            where = f"{within.start:.4g} s to {within.end:.4g} s, as of all outlets"
            how = f"crossings nearest to {outlet.name}; error from {BLOCKS} blocks of equally many grains"
            value, error = mean_mass(run) * outlet_flow.rate, mean_mass(run) * outlet_flow.error
            numbers.append(Measured(name, value, error, outlet_flow.n_effective, where, how, "kg/s", ""))
        return Evaluation(tuple(numbers), {"outlet": through})


def _rate(outlet: Outlet) -> Quantity:
    meaning = f"mass flow rate through {outlet.name} in the window"
    return Quantity(f"flow_rate_{outlet.name}", f"W of {outlet.name}", "kg/s", meaning, "g/s", 1e3)
