"""What recorded frames show of how a bed flows: mean fields, some moments, and how grains accelerate above the outlet.

These are no measures that a study asks for: they are evaluated of runs that were recorded, when they are first shown.
"""

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe
from labbook.fields import Fields, Pattern, coarse_grain, orifice_means, pattern_of
from labbook.measure.acceleration import acceleration_profile
from labbook.measure.bed import bed_grid, grains_between, omega_of
from labbook.measure.data import RunData
from labbook.measure.flow import FlowRate
from labbook.measure.measure import Evaluation, Measure, MeasureError, Quantity, Window, packed
from labbook.measure.orifice import BINS, UP_TO
from labbook.measure.scales import interval, layer, moment
from labbook.measure.steady import in_gap, outflow
from labbook.scene import Scene
from labbook.stats import Measured

FEWEST = 8
"""Recorded frames within the window below which there is no mean field."""
_MOMENTS = 3
_FEWEST_ABOUT_AN_INSTANT = 4  # frames: means over the azimuth of few already tell maps
_OF_FRAMES = ("x", "z", "vx", "vz")


def instant(scene: Scene, window: Window, flow: tuple[float, float]) -> float:
    """How long [s] a bed is averaged about each instant of a `flow` that begins and ends at these times [s]; `window`:
    what the study states of it."""
    return min(moment(scene, window), (flow[1] - flow[0]) / _MOMENTS)


@dataclass(frozen=True, eq=False)
class Bed:
    """Mean fields of a bed over `frames` recorded frames between the instants `window` [s]; `moment`: columns x, z [m],
    vx, vz [m/s] of the grains near y = 0 in one frame."""

    fields: Fields
    moment: Mapping[str, np.ndarray]
    frames: int
    window: tuple[float, float]

    @property
    def pattern(self) -> Pattern:
        """Where grains stand still."""
        return pattern_of(self.fields)

    @classmethod
    def of(cls, evaluation: Evaluation, name: str = "") -> "Bed | None":
        """The bed that a measure of this module has given; one of its several beds by `name`. None without it."""
        start = f"{name}." if name else ""
        arrays = {key.removeprefix(start): a for key, a in evaluation.arrays.items() if key.startswith(start)}
        if "frames" not in arrays:
            return None
        begin, end = arrays["window"].tolist()
        moment = {column: arrays[f"moment_{column}"] for column in _OF_FRAMES}
        return cls(Fields.of(arrays), moment, int(arrays["frames"]), (begin, end))

    def arrays(self, name: str = "") -> dict[str, np.ndarray]:
        """The bed as arrays, by names that begin with `name`."""
        moment = {f"moment_{column}": values for column, values in self.moment.items()}
        arrays = {**self.fields.arrays(), **moment, "frames": np.array(self.frames), "window": np.array(self.window)}
        return {f"{name}.{key}" if name else key: array for key, array in arrays.items()}


class OfRecording(Measure):
    """What is evaluated of recorded frames within the window of the flow rate, without its gaps."""

    def check(self, scene: Scene) -> None:
        FlowRate().check(scene)
        if scene.container.symmetry is None:
            raise MeasureError(f"{self.name} needs a hopper or a silo about an axis, not a {scene.container.kind}")

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        return ()

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        self.check(run.scene)
        flow, times = outflow(run, window)
        frames = run.frames() if flow is not None else None
        if flow is None or frames is None:
            return Evaluation()
        flowed = ~in_gap(np.asarray(frames["time"], float), times, flow)
        frames = {name: np.asarray(column)[flowed] for name, column in frames.items()}
        return self.of(run.scene, frames, window, (flow.begin, flow.end))

    @abstractmethod
    def of(
        self, scene: Scene, frames: Mapping[str, np.ndarray], window: Window, times: tuple[float, float]
    ) -> Evaluation:
        """What recorded frames give between the instants `times` [s] at which the window begins and ends; nothing of
        too few frames."""


class FlowPattern(OfRecording):
    """Mean fields of a recorded run over the window of its flow rate, their means above the orifice, and the stagnant
    part of the bed. Of rods also their orientation: in a hopper O_xx and O_yy, about an axis O_rr and O_tt. Where no
    grain is above the orifice in any frame, there is one number of NaN for the means, and the note says so. Arrays:
    those of `Bed`."""

    name = "flow_pattern"
    version = 3
    declared = (
        Quantity("orifice.packing_fraction", "φ", "", "packing fraction above the orifice, of recorded frames"),
        Quantity("orifice.v_z", "v_z", "m/s", "vertical velocity in this layer, weighted by φ"),
        Quantity("orifice.kinetic_pressure", "p_k", "Pa", "trace of the kinetic stress in this layer"),
        Quantity("orifice.O_xx", "O_xx", "", "mean square of the cosine between rods and the width of a hopper"),
        Quantity("orifice.O_yy", "O_yy", "", "mean square of the cosine with its thickness"),
        Quantity("orifice.O_rr", "O_rr", "", "mean square of the cosine between rods and the radial direction"),
        Quantity("orifice.O_tt", "O_tt", "", "mean square of the cosine with the azimuthal direction"),
        Quantity("orifice.O_zz", "O_zz", "", "mean square of the cosine with the vertical"),
        Quantity("orifice.S", "S", "", "largest eigenvalue of the orientation tensor averaged over time"),
        Quantity(
            "orifice.stagnant_fraction", "stagnant", "", "part of the mass of the bed that stands still", "%", 100
        ),
    )

    def of(
        self, scene: Scene, frames: Mapping[str, np.ndarray], window: Window, times: tuple[float, float]
    ) -> Evaluation:
        bed = bed_between(scene, frames, times)
        if bed is None:
            return Evaluation()
        where, how = f"{bed.window[0]:.4g} s to {bed.window[1]:.4g} s", "recorded frames, coarse-grained"
        units = {quantity.name: quantity.unit for quantity in self.declared}

        def measured(name: str, value: float, frames: int = bed.frames, note: str = "") -> Measured:
            quantity = f"orifice.{name}"
            return Measured(quantity, value, math.nan, frames, where, how, units.get(quantity, ""), note)

        outlet = scene.container.outlets[0]
        try:
            above = orifice_means(bed.fields, outlet.width, layer(scene, window), centre=outlet.centre)
        except ValueError as problem:  # no grain is there, or the layer is thinner than a cell: the fields are known
            numbers = (measured("v_z", math.nan, 0, str(problem)),)
        else:
            numbers = tuple(measured(name, value) for name, value in above.items())
        return Evaluation((*numbers, measured("stagnant_fraction", bed.pattern.fraction)), bed.arrays())


class KindPatterns(OfRecording):
    """Mean fields of each kind of grains of a recorded run over the window of its flow rate, on one grid. Arrays: those
    of `Bed`, by the names of the kinds; none without kinds."""

    name = "kind_patterns"
    version = 1
    declared = ()

    def of(
        self, scene: Scene, frames: Mapping[str, np.ndarray], window: Window, times: tuple[float, float]
    ) -> Evaluation:
        arrays = {}
        for number, kind in enumerate(scene.grains.kinds):
            bed = bed_between(scene, frames, times, among=np.asarray(frames["kind"]) == number)
            arrays |= bed.arrays(kind.name) if bed is not None else {}
        return Evaluation(arrays=arrays)


class FlowMoments(OfRecording):
    """The bed within `window.moment` (a third of the window, if that is shorter) about three instants of the window
    (Pongo et al. 2022, Figs 6 and 7). Arrays: those of `Bed`, by `moment-1` and so on."""

    name = "flow_moments"
    version = 3
    declared = ()

    def of(
        self, scene: Scene, frames: Mapping[str, np.ndarray], window: Window, times: tuple[float, float]
    ) -> Evaluation:
        begin, end = times
        part = (end - begin) / _MOMENTS
        half = instant(scene, window, times) / 2
        arrays = {}
        for number in range(_MOMENTS):
            middle = begin + part * (number + 0.5)
            bed = bed_between(scene, frames, (middle - half, middle + half), _FEWEST_ABOUT_AN_INSTANT)
            arrays |= bed.arrays(f"moment-{number + 1}") if bed is not None else {}
        return Evaluation(arrays=arrays)

    @staticmethod
    def beds(evaluation: Evaluation) -> list[Bed]:
        """The beds at the instants that have frames enough."""
        beds = (Bed.of(evaluation, f"moment-{number + 1}") for number in range(_MOMENTS))
        return [bed for bed in beds if bed is not None]


class FreeFall(OfRecording):
    """Acceleration against height in the middle of the outlet, up to half of its half width, of recorded frames.
    Arrays: those of `AccelerationProfile`."""

    name = "free_fall"
    version = 3
    declared = ()

    def of(
        self, scene: Scene, frames: Mapping[str, np.ndarray], window: Window, times: tuple[float, float]
    ) -> Evaluation:
        outlet, D = scene.container.outlets[0], scene.container.outlets[0].width
        try:
            profile = acceleration_profile(
                frames,
                interval=interval(scene, window),
                radius=D / 4,
                edges=np.linspace(0.0, UP_TO * D, BINS + 1),
                gravity=scene.gravity,
                begin=times[0],
                end=times[1],
                centre=outlet.centre,
                planar=scene.container.symmetry == "planar",
            )
        except ValueError:  # no two frames are far enough apart
            return Evaluation()
        return Evaluation(arrays=packed(profile))


def bed_between(
    scene: Scene,
    frames: Mapping[str, np.ndarray],
    window: tuple[float, float],
    fewest: int = FEWEST,
    among: np.ndarray | None = None,
) -> Bed | None:
    """Mean fields of the recorded frames within `window` [s]; None of fewer than `fewest`. Raises ImportError without
    Numba.

    among: rows of the grains that count (None: all). The grid is that of all grains.
    """
    time = np.asarray(frames["time"], float)
    times = np.unique(time[(time >= window[0]) & (time <= window[1])])
    if len(times) < fewest:
        return None
    grains, omega = grains_between(scene, frames, *window), omega_of(scene)
    grid = bed_grid(scene, omega, grains.x)
    if among is not None:
        frames = {name: np.asarray(column)[among] for name, column in frames.items()}
        grains, time = grains_between(scene, frames, *window), time[among]
    fields = coarse_grain(grid, omega, grains)
    now = (time == times[len(times) // 2]) & (np.abs(frames["y"]) <= scene.grains.equivalent_diameter / 2)
    moment = {name: np.asarray(frames[name], float)[now] for name in _OF_FRAMES}
    return Bed(fields, moment, len(times), window)
