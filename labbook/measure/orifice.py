"""Means over a layer above a round outlet, and the height of the free fall (Pongo et al. 2022)."""

import math
from collections.abc import Mapping

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Probe, Zone
from labbook.fields import Ring, coarse_grain, orifice_means
from labbook.fields.kernel import CUTOFF
from labbook.measure.acceleration import AccelerationProfile, acceleration_profile
from labbook.measure.bed import cells, grains_between, omega_of, round_outlet
from labbook.measure.data import RunData
from labbook.measure.expected import beats_of, rounded, window_time
from labbook.measure.measure import (
    FLOWING,
    Evaluation,
    Measure,
    MeasureError,
    Quantity,
    Window,
    as_arrays,
    flow_suffix,
    while_flowing,
    window_in_words,
)
from labbook.measure.scales import interval, layer
from labbook.measure.steady import SteadyFlow, in_gap, outflow, too_few
from labbook.scene import Scene
from labbook.stats import Measured

NAME = "orifice"
BINS, UP_TO = 16, 2.0
"""Bins of height for accelerations, and the height that they reach in widths of the outlet."""
_PAIRS = 16
"""Pairs of frames within the window, if the outflow is as expected; slower flows have more."""
_FEWEST = 8
"""Frames below which there are no means."""
_MEANS = (
    Quantity("orifice_packing_fraction", "⟨φ⟩", "", "packing fraction of the layer above the orifice"),
    Quantity("orifice_v_z", "⟨v_z⟩", "m/s", "vertical velocity in this layer, weighted by φ"),
    Quantity("orifice_kinetic_pressure", "⟨p_k⟩", "Pa", "trace of the kinetic stress in this layer"),
    Quantity("orifice_kinetic_pressure_fine", "⟨p_k⟩ at ω/2", "Pa", "kinetic pressure with a kernel half as wide"),
    Quantity("orifice_O_rr", "⟨O_rr⟩", "", "mean square of the cosine between rods and the radial direction"),
    Quantity("orifice_O_tt", "⟨O_tt⟩", "", "mean square of the cosine with the azimuthal direction"),
    Quantity("orifice_O_zz", "⟨O_zz⟩", "", "mean square of the cosine with the vertical"),
    Quantity("orifice_S", "⟨S⟩", "", "mean over time of the largest eigenvalue of the orientation tensor"),
    Quantity("orifice_S_of_mean", "S of ⟨O⟩", "", "largest eigenvalue of the orientation tensor averaged over time"),
    Quantity(
        "free_fall_height",
        "free fall",
        "m",
        "height below which grains fall freely",
        "mm",
        1e3,
    ),
)
_OF_RODS = {f"orifice_{name}" for name in ("O_zz", "O_rr", "O_tt", "S", "S_of_mean")}
_UNITS = {quantity.name.removeprefix("orifice_"): quantity.unit for quantity in _MEANS}


class OrificeMeans(Measure):
    """Measure means above the orifice and the height of the free fall (Pongo et al. 2022).

    Means are <X> = int X phi dV / int phi dV over a cylinder above the orifice, `window.layer` high, from frames within
    the window of the flow rate without its gaps. Frames, in single precision, have the grains that reach into the
    cylinder and those of a column above the middle: some hundred grains instead of the whole bed. They come in pairs,
    `window.interval` apart, or evenly where pairs would be too close. Quantities of a run that clogged end in
    `_flowing`.

    Quantities:
        orifice_packing_fraction: Packing fraction.
        orifice_v_z: Vertical velocity [m/s].
        orifice_kinetic_pressure: Trace of the kinetic stress [Pa].
        orifice_kinetic_pressure_fine: The same with a kernel half as wide, which counts less of the spatial variation
            of the velocity as fluctuation.
        orifice_O_zz, orifice_O_rr, orifice_O_tt: Orientation tensor of rods (`labbook.fields.orifice_means`).
        orifice_S: Largest eigenvalue of each frame's tensor, averaged over frames, as in the paper. It is larger for
            fewer rods, since some 30 rods are never quite isotropic.
        orifice_S_of_mean: Largest eigenvalue of the tensor averaged over frames.
        free_fall_height: Area under a_eff/g up to two widths of the outlet, in its middle [m].

    Arrays:
        edges, acceleration, error, count, interval, left: Those of `AccelerationProfile`, for runs that did not clog.

    Raises:
        MeasureError: The outlet is not round, grains differ, or there is no gravity.
    """

    name = NAME
    version = 3
    declared = (*_MEANS, *map(while_flowing, _MEANS))

    def check(self, scene: Scene) -> None:
        round_outlet(scene, NAME)
        if scene.gravity == 0:
            raise MeasureError("orifice needs gravity", "take orifice out of measure, or use a gravity above 0 m/s^2")

    def quantities(self, scene: Scene) -> tuple[Quantity, ...]:
        rods = scene.grains.elongated
        return tuple(
            quantity for quantity in self.declared if rods or quantity.name.removesuffix(FLOWING) not in _OF_RODS
        )

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        return self.observed(scene, numerics)

    def observed(self, scene: Scene, numerics: Numerics, window: Window | None = None) -> tuple[Probe, ...]:
        self.check(scene)
        outlet, reach = round_outlet(scene, NAME), CUTOFF * omega_of(scene)
        R, plane = outlet.width / 2, outlet.plane
        # accelerations are taken within D/4 of the axis; grains at the edge need a row in both frames of a pair
        core = min(R + reach, R / 2 + scene.grains.equivalent_diameter)
        low, high = plane - reach, plane + layer(scene, window) + reach
        every, again = _beats(scene, numerics, interval(scene, window))
        top = max(high, plane + UP_TO * outlet.width)
        return (Crossing(plane), Zone(R + reach, low, high, core, top, every, again))

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        round_outlet(run.scene, NAME)
        flow, times = outflow(run, window)
        height = layer(run.scene, window)
        where = window_in_words(window, "grains")
        frames = {} if flow is None else frames_of(run, flow, times)
        count = len(np.unique(frames["step"])) if frames else 0
        clogged = run.outcome == "clogged"
        suffix = flow_suffix(run)
        profile = _profile(run.scene, frames, interval(run.scene, window)) if count else None
        arrays = {} if profile is None or clogged else as_arrays(profile)
        if flow is None or count < _FEWEST:
            fewer = f"only {count} frames while grains flowed within the window, fewer than {_FEWEST}"
            note = too_few(len(times), len(run.start)) if flow is None else fewer
            none = (math.nan, math.nan, 0, where, "coarse-grained frames", "m/s", note)
            return Evaluation((Measured(f"orifice_v_z{suffix}", *none),), arrays)
        how = f"{count} frames, coarse-grained over {height * 1e3:.4g} mm; error from seeds only"
        means = _means(run.scene, frames, height)
        numbers = [
            Measured(f"orifice_{name}{suffix}", value, math.nan, count, where, how, _UNITS.get(name, ""))
            for name, value in means.items()
        ]
        if profile is not None:
            fallen = profile.free_fall_height(run.scene.gravity)
            how = f"changes of velocity within {profile.interval * 1e3:.3g} ms"
            numbers.append(Measured(f"free_fall_height{suffix}", fallen, math.nan, count, where, how, "m"))
        return Evaluation(tuple(numbers), arrays)


def frames_of(run: RunData, flow: SteadyFlow, times: np.ndarray) -> dict[str, np.ndarray]:
    """Select the rows of grains at the outlet within the window, without its gaps.

    Args:
        run: The run.
        flow: Its outflow within the window.
        times: Ascending times of all crossings [s], shape [n].

    Raises:
        MeasureError: The run recorded no grains at the outlet.
    """
    if "zone" not in run.tables:
        raise MeasureError("orifice: the run recorded no grains around the outlet; run it again with this measure")
    rows = run.tables["zone"]
    time = np.asarray(rows["time"], float)
    flowing = (time >= flow.begin) & (time <= flow.end) & ~in_gap(time, times, flow)
    return {name: np.asarray(column)[flowing] for name, column in rows.items()}


def _means(scene: Scene, frames: dict[str, np.ndarray], height: float) -> dict[str, float]:
    omega = omega_of(scene)
    means = _layer_means(scene, frames, height, omega)
    means["kinetic_pressure_fine"] = _layer_means(scene, frames, height, omega / 2)["kinetic_pressure"]
    if "S" in means:
        means["S_of_mean"] = means.pop("S")
        means["S"] = _mean_order(scene, frames, height, omega)
    return means


def _layer_means(scene: Scene, frames: Mapping[str, np.ndarray], height: float, omega: float) -> dict[str, float]:
    """Compute means over a layer of a `height` [m], through a kernel of the width omega [m]."""
    outlet = round_outlet(scene, NAME)
    R, bottom = outlet.width / 2, outlet.plane
    grid = Ring(R, (bottom, bottom + height), cells(R, omega / 2), max(4, cells(height, omega / 2)))
    fields = coarse_grain(grid, omega, grains_between(scene, frames, -math.inf, math.inf))
    return dict(orifice_means(fields, outlet.width, height, bottom=bottom))


def _mean_order(scene: Scene, frames: Mapping[str, np.ndarray], height: float, omega: float) -> float:
    """Mean over frames of the nematic order of each; frames without a grain in the layer do not count."""
    orders = []
    for step in np.unique(frames["step"]):
        rows = frames["step"] == step
        try:
            orders.append(
                _layer_means(scene, {name: column[rows] for name, column in frames.items()}, height, omega)["S"]
            )
        except ValueError:  # no grain is above the orifice
            continue
    return float(np.mean(orders)) if orders else math.nan


def _profile(scene: Scene, frames: dict[str, np.ndarray], after: float) -> AccelerationProfile | None:
    """Profile of accelerations from velocities about `after` [s] apart; None if no two frames are."""
    D, plane = round_outlet(scene, NAME).width, round_outlet(scene, NAME).plane
    edges = plane + np.linspace(0.0, UP_TO * D, BINS + 1)
    try:
        return acceleration_profile(frames, interval=after, radius=D / 4, edges=edges, gravity=scene.gravity)
    except ValueError:
        return None


def _beats(scene: Scene, numerics: Numerics, after: float) -> tuple[int, int]:
    """Number of beats between pairs of frames, and within a pair whose frames are `after` [s] apart.

    The latter is 0 where frames follow each other evenly.
    """
    between = min(rounded(window_time(scene) / _PAIRS, scene, 2), 10 * after)
    if between < 2 * after:
        return beats_of(min(between / 2, after), numerics), 0
    every, again = beats_of(between, numerics), beats_of(after, numerics)
    return every, again if again < every else 0
