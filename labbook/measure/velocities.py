"""Mean velocities in steady flow: over the outlet and in stated zones, of mixtures by class of grains."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Probe, Slab
from labbook.measure.composition import class_names, classes_of
from labbook.measure.data import RunData
from labbook.measure.expected import beats_of, rounded, window_time
from labbook.measure.flow import FlowRate
from labbook.measure.measure import (
    Evaluation,
    Measure,
    MeasureError,
    Quantity,
    Window,
    as_arrays,
    flow_suffix,
    from_arrays,
    while_flowing,
    window_in_words,
)
from labbook.measure.steady import SteadyFlow, in_gap, outflow
from labbook.scene import Bodies, Scene
from labbook.scene.container_shape import VelocityZone
from labbook.scene.timescales import gravity_time
from labbook.stats import Measured
from labbook.stats.correlation import block_mean

NAME = "velocities"
BINS = 8
"""Bins of the profile over the outlet."""
_FRAMES = 100
"""Frames of the zones within the window, if the outflow is as expected."""
_BLOCKS = 8
_OUTLET = Quantity("velocity_outlet", "v_z at outlet", "m/s", "mean downward velocity of the grains in the plane of "
                   "the outlet", "mm/s", 1e3)  # fmt: skip
_AXES = "xyz"


@dataclass(frozen=True, eq=False)
class OutletVelocities:
    """Profiles over the outlet of all grains and, for mixtures, of each of k classes, in b bins.

    Attributes:
        edges: Edges of the bins [m], shape [b + 1]: distance from the axis of a round outlet, with rings of equal area,
            or x from the middle of a slot.
        velocity: Mean downward velocity of the grains in the plane [m/s], shape [1 + k, b]; NaN without any.
        flux: Mass that crossed per time and area [kg/m^2/s], shape [1 + k, b].
        grains: Number of grains that crossed, shape [1 + k, b].
    """

    edges: np.ndarray
    velocity: np.ndarray
    flux: np.ndarray
    grains: np.ndarray

    @classmethod
    def of(cls, evaluation: Evaluation) -> "OutletVelocities | None":
        """Read the profiles from an evaluation; None without any."""
        return from_arrays(cls, evaluation.arrays)


class Velocities(Measure):
    """Measure mean velocities over the outlet and in zones, within the window of the flow rate.

    The mean velocity of the grains in the plane of the outlet is N / sum(1/v) over the N grains that cross it, since
    each is in the plane for a time proportional to 1/v. That in each of `container.zones` is the mean over grains and
    frames, with an error from 8 blocks of frames.

    Quantities:
        velocity_outlet: Mean downward velocity in the plane of the outlet [m/s].
        velocity_x_ZONE, velocity_y_ZONE, velocity_z_ZONE: Mean velocity in a zone [m/s].
        velocity_z_ZONE_of_CLASS: Mean vertical velocity of a class of a mixture in a zone [m/s].

    Arrays:
        edges, velocity, flux, grains: Those of `OutletVelocities`.

    Raises:
        MeasureError: There is not exactly one slot or hole, or no gravity.
    """

    name = NAME
    version = 1
    declared = (_OUTLET, while_flowing(_OUTLET))

    def check(self, scene: Scene) -> None:
        FlowRate().check(scene)
        outlets = scene.container.outlets
        if len(outlets) != 1 or outlets[0].form is None:
            reason = f"{NAME} needs one outlet, a slot or a hole"
            raise MeasureError(reason, f"take {NAME} out of measure, or use a container with one outlet")
        if scene.gravity == 0:
            reason = f"{NAME} samples zones at a multiple of sqrt(d/g), and there is no gravity"
            raise MeasureError(reason, f"take {NAME} out of measure, or use a gravity above 0 m/s^2")

    def quantities(self, scene: Scene) -> tuple[Quantity, ...]:
        """List also the velocities in each zone."""
        zones = [quantity for zone in scene.container.zones for quantity in of_zone(zone, scene)]
        return (*self.declared, *zones, *map(while_flowing, zones))

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        self.check(scene)
        zones, crossing = scene.container.zones, Crossing(scene.container.outlets[0].plane)
        if not zones:
            return (crossing,)
        expected = window_time(scene)
        time = rounded(expected / _FRAMES, scene, 1) if math.isfinite(expected) else gravity_time(scene)
        low, high = min(zone.low[2] for zone in zones), max(zone.high[2] for zone in zones)
        return crossing, Slab(low, high, every=beats_of(time, numerics))

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        self.check(run.scene)
        zones = run.scene.container.zones
        if zones and "slab" not in run.tables:
            raise MeasureError(f"{NAME}: the run recorded no grains in zones; run it again with this measure")
        flow, times = outflow(run, window)
        if flow is None:
            none = (
                math.nan,
                math.nan,
                0,
                window_in_words(window),
                "crossings",
                "m/s",
                "too few grains left for a window",
            )
            quantities = (_OUTLET, *(quantity for zone in zones for quantity in of_zone(zone, run.scene)))
            return Evaluation(tuple(Measured(quantity.name + flow_suffix(run), *none) for quantity in quantities))
        profile, number = _outlet(run, flow)
        in_zones = [number for zone in zones for number in _zone(run, zone, flow, times)]
        return Evaluation((number, *in_zones), as_arrays(profile))


def outlet_edges(scene: Scene) -> np.ndarray:
    """Edges [m] of the bins over the outlet: of a hole rings of equal area, of a slot from its middle."""
    outlet = scene.container.outlets[0]
    if outlet.form == "hole":
        return outlet.width / 2 * np.sqrt(np.linspace(0, 1, BINS + 1))
    return outlet.width / 2 * np.linspace(-1, 1, BINS + 1)


def _outlet(run: RunData, flow: SteadyFlow) -> tuple[OutletVelocities, Measured]:
    scene, table = run.scene, run.tables["crossing"]
    outlet, edges = scene.container.outlets[0], outlet_edges(run.scene)
    time, speed = np.asarray(table["time"], float), -np.asarray(table["vz"], float)
    inside = (time > flow.begin) & (time <= flow.end) & (speed > 0)
    speed, x = speed[inside], np.asarray(table["x"], float)[inside] - outlet.centre
    across = np.hypot(x, np.asarray(table["y"], float)[inside]) if outlet.form == "hole" else x
    rows = run.start.rows(np.asarray(table["id"])[inside])
    bodies = Bodies.of(scene.grains, run.start)
    groups = np.full(len(rows), -1) if not class_names(scene.grains) else classes_of(scene.grains, bodies)[rows]
    index = (np.searchsorted(edges, across, side="right") - 1).clip(0, BINS - 1)  # at the rim a centre may lie beyond
    area = math.pi * np.diff(edges**2) if outlet.form == "hole" else np.diff(edges) * scene.container.front_to_back
    duration = flow.end - flow.begin - flow.gap_time
    masks = [np.ones(len(rows), bool), *(groups == k for k in range(len(class_names(scene.grains))))]
    sums = [
        [np.bincount(index[mask], of[mask], BINS) for of in (np.ones(len(rows)), 1 / speed, bodies.mass[rows])]
        for mask in masks
    ]
    grains, slowness, mass = np.array(sums).transpose(1, 0, 2)
    velocity = np.divide(grains, slowness, out=np.full(grains.shape, math.nan), where=grains > 0)
    profile = OutletVelocities(edges, velocity, mass / (duration * area), grains)
    blocks = block_mean(1 / speed, _BLOCKS)  # of 1/v; the error of v is v^2 times as large, to first order
    where, how = f"{flow.begin:.4g} s to {flow.end:.4g} s", f"crossings; error from {_BLOCKS} blocks"
    mean = float(len(speed) / (1 / speed).sum())
    name = _OUTLET.name + flow_suffix(run)
    return profile, Measured(name, mean, mean**2 * blocks.error, len(speed), where, how, "m/s", "")


def _zone(run: RunData, zone: VelocityZone, flow: SteadyFlow, times: np.ndarray) -> Iterator[Measured]:
    """Mean velocities in a zone, weighted by grains, in frames within the window without its gaps."""
    table, names = run.tables["slab"], class_names(run.scene.grains)
    time = np.asarray(table["time"], float)
    inside = (time >= flow.begin) & (time <= flow.end) & ~in_gap(time, times, flow)
    inside &= zone.holds(np.column_stack([np.asarray(table[axis], float) for axis in _AXES]))
    rows = run.start.rows(np.asarray(table["id"])[inside])
    groups = classes_of(run.scene.grains, Bodies.of(run.scene.grains, run.start))[rows] if names else None
    _, frame = np.unique(np.asarray(table["step"])[inside], return_inverse=True)
    velocity = {axis: np.asarray(table[f"v{axis}"], float)[inside] for axis in _AXES}
    where = f"{flow.begin:.4g} s to {flow.end:.4g} s"
    quantities = iter(of_zone(zone, run.scene))
    for axis in _AXES:
        yield _mean(next(quantities), run, frame, velocity[axis], where)
    for index in range(len(names)):
        assert groups is not None
        mask = groups == index
        yield _mean(next(quantities), run, frame[mask], velocity["z"][mask], where)


def _mean(quantity: Quantity, run: RunData, frame: np.ndarray, velocity: np.ndarray, where: str) -> Measured:
    name = quantity.name + flow_suffix(run)
    if not len(velocity):
        note = "no grain of it was in the zone in a frame of the window"
        return Measured(name, math.nan, math.nan, 0, where, "frames", "m/s", note)
    count, total = np.bincount(frame), np.bincount(frame, velocity)
    mean = float(velocity.mean())
    filled = count > 0
    # Frames have unequal numbers of grains: the error is that of a ratio of two sums, to first order.
    excess = (total - mean * count)[filled] / count.mean()
    error = block_mean(excess, _BLOCKS).error if filled.sum() >= 2 * _BLOCKS else math.nan
    how = f"mean over grains in {int(filled.sum())} frames; error from {_BLOCKS} blocks of frames"
    return Measured(name, mean, error, int(filled.sum()), where, how, "m/s", "")


def of_zone(zone: VelocityZone, scene: Scene) -> list[Quantity]:
    """Quantities of a zone: along each axis and, of mixtures, the vertical one of each class."""
    quantities = [
        Quantity(f"velocity_{axis}_{zone.name}", f"v_{axis} in {zone.name}", "m/s",
                 f"mean velocity along {axis} in the zone {zone.name}", "mm/s", 1e3, about_zero=True)
        for axis in _AXES
    ]  # fmt: skip
    for name in class_names(scene.grains):
        quantities.append(
            Quantity(f"velocity_z_{zone.name}_of_{name}", f"v_z of {name} in {zone.name}", "m/s",
                     f"mean velocity along z of {name} in the zone {zone.name}", "mm/s", 1e3, about_zero=True)
        )  # fmt: skip
    return quantities
