"""Clogging: the avalanches between a start of the flow and its stop, with censoring."""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Probe
from labbook.measure.data import RunData
from labbook.measure.measure import Evaluation, Measure, MeasureError, Quantity, Window
from labbook.measure.series import crossings, mean_mass
from labbook.scene import Scene
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
    def of(cls, arrays: Mapping[str, np.ndarray]) -> "Avalanches | None":
        """Read the avalanches from the arrays of an evaluation; None if they could not be measured."""
        return cls(**{name: arrays[name] for name in cls.__dataclass_fields__}) if "stopped" in arrays else None

    @property
    def stops(self) -> int:
        """Stops beyond the transient."""
        return int((self.stopped & (self.counted > 0)).sum())


class Clogging(Measure):
    """Measure the probability that the flow stops, from the grains that leave between its start and its stop.

    A run that clogged is a stop, and each restart (`restart`) follows one. Runs that ended otherwise are censored:
    their grains count, and no stop. Without `feed` an avalanche is also censored at the end of the window, before the
    bed runs out.

    Quantities:
        clogging_probability: Stops over grains that left, both beyond the transient of each start; the maximum of the
            likelihood of avalanches with a constant probability, some of them censored.
        clogging_stops: Number of stops beyond the transient.
        outlet_exchange: Grains that leave while one falls by its diameter at the outlet.

    Arrays:
        grains, stopped, counted, mass, time, begin, end: Those of `Avalanches`.
        waits: Times between grains [s], where walls move.
        wait_ended: False of the last of these, which is censored by the end of the run.

    Raises:
        MeasureError: The container does not have exactly one outlet.
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
        if scene.container.outlet_plane is None or len(scene.container.outlets) != 1:
            reason = f"{NAME} needs one outlet, and the container ({scene.container.kind}) has "
            reason += f"{len(scene.container.outlets) or 'none'}"
            raise MeasureError(reason, f"take {NAME} out of measure, or use a container with one outlet")

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        self.check(scene)
        plane = scene.container.outlet_plane
        assert plane is not None
        return (Crossing(plane),)

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        self.check(run.scene)
        flows = avalanches(run, window)
        arrays = {**vars(flows), **waits(run)}
        k, passed = flows.stops, int(flows.counted.sum())
        first = transient(run.scene)
        where = f"after the first {first} grains of each start"
        how = "stops over grains (censored); error of a Poisson count"
        if not passed:
            note = f"no avalanche is longer than the transient of {first} grains"
            return Evaluation((Measured(PROBABILITY, math.nan, math.nan, 0, where, how, "", note),), arrays)
        numbers = [
            Measured(PROBABILITY, k / passed, math.sqrt(k) / passed, passed, where, how, ""),
            Measured(STOPS, k, math.nan, 1, where, "counted", ""),
        ]
        time = float(flows.time.sum())
        speed = -float(np.mean(np.asarray(run.tables["crossing"]["vz"], float)))
        if time > 0 and speed > 0:
            exchange = passed / time * run.scene.grains.equivalent_diameter / speed
            how = "grain rate times d over the speed of the grains at the outlet"
            numbers.append(Measured(EXCHANGE, exchange, math.nan, passed, where, how, ""))
        return Evaluation(tuple(numbers), arrays)


def width_ratio(scene: Scene) -> float:
    """Ratio D/d of the only outlet, with the diameter of spheres of the grains' volume."""
    return scene.container.outlets[0].width / scene.grains.equivalent_diameter


def dimension(scene: Scene) -> int:
    """Dimension of the region above the outlet in which arches form: 3 of a hole, 2 of a slot."""
    return 3 if scene.container.outlet_form == "hole" else 2


def transient(scene: Scene, opening: bool = False) -> int:
    """Number of grains of the transient of a start, which do not count.

    These are about the grains in the half ball, or half disc, of the outlet's width above it, which were at rest under
    or in an arch.

    Args:
        scene: The scene.
        opening: The start is the opening, whose transient is twice as long: a bed that has never flowed stops more
            often within it (docs/results/clogging-layer.md).
    """
    x, depth = width_ratio(scene), 1.0
    if dimension(scene) == 2:
        depth = max(1.0, scene.container.front_to_back / scene.grains.equivalent_diameter)
    return math.ceil(DENSE * x ** dimension(scene) / 2 * depth * (2 if opening else 1))


def avalanches(run: RunData, window: Window) -> Avalanches:
    """Divide the grains that left into avalanches.

    Args:
        run: With its crossings and, of a scene with `restart`, its restarts.
        window: Its end censors avalanches of a bed that is not fed.

    Returns:
        The avalanches, without those whose restart failed.

    Raises:
        MeasureError: The run recorded no crossings.
    """
    times, weights = crossings(run)
    restarts = np.asarray(run.tables.get("restart", {}).get("time", ()), float)
    limit, last = _limit(run, window, weights), run.outcome == "clogged"
    edges = np.concatenate([[0], np.searchsorted(times, restarts, "right"), [len(times)]]).astype(int)
    begins = np.concatenate([[0.0], restarts])
    rows = []
    for place, (low, high) in enumerate(itertools.pairwise(edges)):
        ends_here = place < len(restarts) or last
        if (place and low == high) or low > limit:  # a restart in vain, or one after the end of the window
            continue
        cut, first = min(high, limit), transient(run.scene, opening=place == 0)
        counted = max(0, cut - low - first)
        time = float(times[cut - 1] - times[low + first - 1]) if counted else 0.0
        mass = float(weights[cut - counted : cut].sum()) * mean_mass(run)
        end = float(times[cut - 1]) if cut > low else float(begins[place])
        rows.append((cut - low, ends_here and cut == high, counted, mass, time, begins[place], end))
    grains, stopped, counted, mass, time, begin, end = (np.array(column) for column in zip(*rows, strict=True))
    return Avalanches(grains, stopped, counted, mass, time, begin, end)


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
