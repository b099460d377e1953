"""Clogging: the avalanches between a start of the flow and its stop, with censoring."""

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Probe
from labbook.measure.data import RunData
from labbook.measure.measure import Evaluation, Measure, MeasureError, Quantity, Window
from labbook.measure.scales import gap
from labbook.measure.series import crossed_outlets, crossings, mean_mass
from labbook.scene import Outlet, Scene
from labbook.scene.lids import depth_between
from labbook.stats import Measured

NAME = "clogging"
PROBABILITY, STOPS, EXCHANGE = "clogging_probability", "clogging_stops", "outlet_exchange"
DENSE = 0.6
"""Packing fraction of spheres in the half ball above an outlet; of discs in a layer the half disc holds about as many
per (D/d)^2 as this times the half ball per (D/d)^3."""


@dataclass(frozen=True, eq=False)
class Avalanches:
    """Avalanches of one run in the order of time, shape [n].

    Attributes:
        grains: Grains that left in each.
        stopped: True where a stop ended it, false where it is censored: the run or the window ended first.
        counted: Grains beyond the transient, which are those that count for the probability of a stop.
        mass: Mass of the counted grains [kg].
        time: Time in which they left [s].
        begin: When it was started, by the opening or by a restart [s].
        end: When its last grain left [s].
    """

    grains: np.ndarray
    stopped: np.ndarray
    counted: np.ndarray
    mass: np.ndarray
    time: np.ndarray
    begin: np.ndarray
    end: np.ndarray

    @classmethod
    def of(cls, arrays: Mapping[str, np.ndarray], outlet: int | None = None) -> "Avalanches | None":
        """Read the avalanches from the arrays of an evaluation; None if they could not be measured.

        Args:
            arrays: Arrays of the evaluation.
            outlet: Index of an outlet, of a container with several.
        """
        if "stopped" not in arrays:
            return None
        rows = slice(None) if outlet is None else arrays["outlet"] == outlet
        return cls(**{name: arrays[name][rows] for name in cls.__dataclass_fields__})

    @property
    def stops(self) -> int:
        """Stops beyond the transient."""
        return int((self.stopped & (self.counted > 0)).sum())


class Clogging(Measure):
    """Measure the probability that the flow stops, from the grains that leave between its start and its stop.

    A run that clogged is a stop, and each restart (`restart`) follows one. Runs that ended otherwise are censored:
    their grains count, and no stop. Without `feed` an avalanche is also censored at the end of the window, before the
    bed runs out.

    Each of several outlets has avalanches of its own. A pause without a grain that is longer than `window.gap` is a
    stop of this outlet. The flow through others may end it, and then another avalanche begins.

    Quantities (of several outlets with the name of each, as in `clogging_probability_NAME`):
        clogging_probability: Stops over grains that left, both beyond the transient of each start; the maximum of the
            likelihood of avalanches with a constant probability, some of them censored.
        clogging_stops: Number of stops beyond the transient.
        outlet_exchange: Grains that leave while one falls by its diameter at the outlet.

    Arrays:
        grains, stopped, counted, mass, time, begin, end: Those of `Avalanches`.
        outlet: Index of the outlet of each, of a container with several.
        waits: Times between grains [s], where walls move and there is one outlet.
        wait_ended: False of the last of these, which is censored by the end of the run.

    Raises:
        MeasureError: The container has no outlet, or an outlet of unknown width.
    """

    name = NAME
    version = 1
    declared = (
        Quantity(
            PROBABILITY,
            "q",
            "",
            "probability that a grain is the last before a stop",
            estimator="rate",
            about_zero=True,
        ),
        Quantity(STOPS, "stops", "", "stops beyond the transient", pooled=False),
        Quantity(EXCHANGE, "s_m", "", "grains that leave while one falls by its diameter at the outlet"),
    )

    def check(self, scene: Scene) -> None:
        outlets = scene.container.outlets
        if not outlets or not all(math.isfinite(outlet.width) for outlet in outlets):
            lack = "an outlet of unknown width" if outlets else "none"
            reason = f"{NAME} needs outlets of a known width, and the container ({scene.container.kind}) has {lack}"
            remedy = f"take {NAME} out of measure, or use a hopper or silo, or walls with several lids"
            raise MeasureError(reason, remedy)

    def quantities(self, scene: Scene) -> tuple[Quantity, ...]:
        outlets = scene.container.outlets
        if len(outlets) < 2:
            return self.declared
        return tuple(_through(quantity, outlet) for outlet in outlets for quantity in self.declared)

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        self.check(scene)
        return (Crossing(scene.container.outlets[0].plane),)

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        self.check(run.scene)
        outlets = run.scene.container.outlets
        if len(outlets) < 2:
            flows = avalanches(run, window)
            return Evaluation(tuple(_numbers(run, flows)), {**vars(flows), **waits(run)})
        of_outlets = [avalanches(run, window, outlet_index) for outlet_index in range(len(outlets))]
        numbers = [
            replace(number, quantity=number.quantity + outlet_suffix(outlet))
            for outlet_index, (outlet, flows) in enumerate(zip(outlets, of_outlets, strict=True))
            for number in _numbers(run, flows, outlet_index)
        ]
        joined = {name: np.concatenate([vars(flows)[name] for flows in of_outlets]) for name in vars(of_outlets[0])}
        index = np.repeat(np.arange(len(outlets)), [len(flows.grains) for flows in of_outlets])
        return Evaluation(tuple(numbers), {**joined, "outlet": index})


def outlet_suffix(outlet: Outlet) -> str:
    """Suffix of quantities of one of several outlets."""
    return f"_{outlet.name}"


def _through(quantity: Quantity, outlet: Outlet) -> Quantity:
    """Declare a quantity of one of several outlets."""
    return replace(
        quantity,
        name=quantity.name + outlet_suffix(outlet),
        symbol=f"{quantity.symbol} of {outlet.name}",
        meaning=f"{quantity.meaning}, through {outlet.name}",
    )


def _numbers(run: RunData, flows: Avalanches, outlet_index: int = 0) -> Iterator[Measured]:
    """Yield the quantities of avalanches through the outlet of an index."""
    k, passed = flows.stops, int(flows.counted.sum())
    first = transient(run.scene, outlet_index=outlet_index)
    where = f"after the first {first} grains of each start"
    how = "stops over grains (censored); error of a Poisson count"
    if not passed:
        note = f"no avalanche is longer than the transient of {first} grains"
        yield Measured(PROBABILITY, math.nan, math.nan, 0, where, how, "", note)
        return
    yield Measured(PROBABILITY, k / passed, math.sqrt(k) / passed, passed, where, how, "")
    yield Measured(STOPS, k, math.nan, 1, where, "counted", "")
    time, velocity = float(flows.time.sum()), np.asarray(run.tables["crossing"]["vz"], float)
    if len(run.scene.container.outlets) > 1:
        order = np.argsort(run.tables["crossing"]["time"], kind="stable")
        velocity = velocity[order][crossed_outlets(run) == outlet_index]
    speed = -float(np.mean(velocity))
    if time > 0 and speed > 0:
        exchange = passed / time * run.scene.grains.equivalent_diameter / speed
        how = "grain rate times d over the speed of the grains at the outlet"
        yield Measured(EXCHANGE, exchange, math.nan, passed, where, how, "")


def width_ratio(scene: Scene, outlet_index: int = 0) -> float:
    """Ratio D/d of the outlet of an index, with the diameter of spheres of the grains' volume."""
    return scene.container.outlets[outlet_index].width / scene.grains.equivalent_diameter


def dimension(scene: Scene, outlet_index: int = 0) -> int:
    """Dimension of the region above the outlet of an index in which arches form: 3 of a hole, 2 of a slot."""
    return 3 if scene.container.outlets[outlet_index].form == "hole" else 2


def transient(scene: Scene, opening: bool = False, outlet_index: int = 0) -> int:
    """Number of grains of the transient of a start, which do not count.

    These are about the grains in the half ball, or half disc, of the outlet's width above it, which were at rest under
    or in an arch.

    Args:
        scene: The scene.
        opening: The start is the opening, whose transient is twice as long: a bed that has never flowed stops more
            often within it (docs/results/clogging-layer.md).
        outlet_index: Index of the outlet.
    """
    x, of, depth = width_ratio(scene, outlet_index), dimension(scene, outlet_index), 1.0
    if of == 2:
        deep = scene.container.front_to_back
        deep = depth_between(scene.container.walls()) if math.isinf(deep) else deep
        depth = max(1.0, deep / scene.grains.equivalent_diameter) if math.isfinite(deep) else 1.0
    return math.ceil(DENSE * x**of / 2 * depth * (2 if opening else 1))


def avalanches(run: RunData, window: Window, outlet_index: int | None = None) -> Avalanches:
    """Divide the grains that left into avalanches.

    Args:
        run: With its crossings and, of a scene with `restart`, its restarts.
        window: Its end censors avalanches of a bed that is not fed.
        outlet_index: Index of one of several outlets, whose pauses longer than `window.gap` are stops.

    Returns:
        The avalanches, without those whose restart failed.

    Raises:
        MeasureError: The run recorded no crossings.
    """
    times, weights = crossings(run)
    limit, last = _limit(run, window, weights), run.outcome == "clogged"
    if outlet_index is None:
        begins = np.concatenate([[0.0], np.asarray(run.tables.get("restart", {}).get("time", ()), float)])
    else:
        # the outlet is observed until the window of the whole outflow ends
        end = float(times[limit - 1]) if 0 < limit < len(times) else run.duration
        last = last and limit == len(times)
        mask = crossed_outlets(run) == outlet_index
        mask &= times <= end
        times, weights, limit = times[mask], weights[mask], int(mask.sum())
        begins, last = _starts(times, _opening(run.scene, outlet_index), end, gap(run.scene, window), last)
    edges = np.concatenate(
        [[0], np.searchsorted(times, begins[1:], "right" if outlet_index is None else "left"), [len(times)]]
    )
    rows = []
    for count, (low, high) in enumerate(itertools.pairwise(edges.astype(int))):
        ends_here = count < len(begins) - 1 or last
        # a restart in vain, or one after the end of the window
        if (count and low == high) or low > limit:
            continue
        cut, first = min(high, limit), transient(run.scene, opening=count == 0, outlet_index=outlet_index or 0)
        beyond = max(0, cut - low - first)
        time = float(times[cut - 1] - times[low + first - 1]) if beyond else 0.0
        mass = float(weights[cut - beyond : cut].sum()) * mean_mass(run)
        end = float(times[cut - 1]) if cut > low else float(begins[count])
        rows.append((cut - low, ends_here and cut == high, beyond, mass, time, begins[count], end))
    grains, stopped, beyond, mass, time, begin, end = (np.array(column) for column in zip(*rows, strict=True))
    return Avalanches(grains, stopped, beyond, mass, time, begin, end)


def _opening(scene: Scene, outlet_index: int) -> float:
    """Time [s] at which one of several outlets opens."""
    name = scene.container.outlets[outlet_index].name
    return next((part.removal or 0.0 for part in scene.container.parts if part.name == name), 0.0)


def _starts(times: np.ndarray, opening: float, end: float, longest: float, clogged: bool) -> tuple[np.ndarray, bool]:
    """Find the starts of the flow through one of several outlets.

    Args:
        times: Ascending times of its crossings [s], shape [n].
        opening: Time at which it opens [s].
        end: Time until which it is observed [s].
        longest: Longest pause that is no stop [s].
        clogged: No outlet flowed any more at the end.

    Returns:
        Times of the starts [s], the opening first, and true if a stop ends the last avalanche.
    """
    before = np.concatenate([[opening], times])
    again = times[np.diff(before) > longest]
    return np.concatenate([[opening], again]), clogged or end - float(before[-1]) > longest


def agitated(scene: Scene) -> bool:
    """True for a container whose walls move, so that arches break by themselves."""
    return any(not wall.is_static for wall in scene.container.walls())


def waits(run: RunData) -> dict[str, np.ndarray]:
    """Times between grains of an agitated silo as arrays by name; none of others, whose stops never end."""
    if not agitated(run.scene):
        return {}
    times, _ = crossings(run)
    between = np.diff(times, append=run.duration)
    return {"waits": between, "wait_ended": np.arange(len(between)) < len(between) - 1}


def _limit(run: RunData, window: Window, weights: np.ndarray) -> int:
    """Number of grains after which a bed that is not fed has run too low."""
    if run.scene.feed is not None or window.timed or math.isinf(window.end):
        return len(weights)
    return int(np.searchsorted(np.cumsum(weights), window.end * len(run.start) + 1e-9, "right"))
