"""Measures of recorded frames: mean fields, fields at some instants, and accelerations above the outlet.

Studies do not name them under `measure`: they are evaluated for recorded runs, when a report first shows them.
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
from labbook.measure.measure import Evaluation, Measure, MeasureError, Quantity, Window, as_arrays
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
    """Duration [s] over which a bed is averaged about each instant.

    Args:
        scene: The scene.
        window: Window of the study, which may state it.
        flow: Begin and end of the outflow within the window [s].
    """
    return min(moment(scene, window), (flow[1] - flow[0]) / _MOMENTS)


@dataclass(frozen=True, eq=False)
class Bed:
    """Mean fields of a bed over recorded frames.

    Attributes:
        fields: Mean fields [SI].
        moment: Columns x, z [m], vx and vz [m/s] of the grains near y = 0 in one frame.
        frames: Number of frames.
        window: Begin and end of the average [s].
    """

    fields: Fields
    moment: Mapping[str, np.ndarray]
    frames: int
    window: tuple[float, float]

    @property
    def pattern(self) -> Pattern:
        """Pattern of moving and stagnant grains."""
        return pattern_of(self.fields)

    @classmethod
    def of(cls, evaluation: Evaluation, name: str = "") -> "Bed | None":
        """Read a bed from an evaluation of this module, one of several by `name`; None without it."""
        start = f"{name}." if name else ""
        arrays = {key.removeprefix(start): a for key, a in evaluation.arrays.items() if key.startswith(start)}
        if "frames" not in arrays:
            return None
        begin, end = arrays["window"].tolist()
        moment = {column: arrays[f"moment_{column}"] for column in _OF_FRAMES}
        return cls(Fields.of(arrays), moment, int(arrays["frames"]), (begin, end))

    def arrays(self, name: str = "") -> dict[str, np.ndarray]:
        """Convert the bed to arrays, by names that begin with `name`."""
        moment = {f"moment_{column}": values for column, values in self.moment.items()}
        arrays = {**self.fields.arrays(), **moment, "frames": np.array(self.frames), "window": np.array(self.window)}
        return {f"{name}.{key}" if name else key: array for key, array in arrays.items()}


class OfRecording(Measure):
    """Base class of measures of recorded frames within the window of the flow rate, without its gaps."""

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
        """Evaluate recorded frames.

        Args:
            scene: The scene.
            frames: Columns of the recorded frames, without those in gaps of the flow.
            window: Window of the study.
            times: Begin and end of the window [s].

        Returns:
            Numbers and arrays; none for too few frames.
        """


class FlowPattern(OfRecording):
    """Measure mean fields of a recorded run over the window of its flow rate, and their means above the orifice.

    If no grain is above the orifice in any frame, `orifice.v_z` alone stands for the means: NaN with a note.

    Quantities:
        orifice.packing_fraction: Packing fraction above the orifice.
        orifice.v_z: Vertical velocity there, weighted by phi [m/s].
        orifice.kinetic_pressure: Trace of the kinetic stress there [Pa].
        orifice.O_xx, orifice.O_yy, orifice.O_rr, orifice.O_tt, orifice.O_zz, orifice.S: Orientation of rods there, in
            a hopper along x and y, about an axis in cylindrical coordinates (`labbook.fields.orifice_means`).
        orifice.stagnant_fraction: Fraction of the mass of the bed that stands still.

    Arrays:
        window, frames, moment_*, ...: Those of `Bed`.

    Raises:
        MeasureError: The container is neither planar nor axisymmetric, or has no outlet.
    """

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
            means = orifice_means(bed.fields, outlet.width, layer(scene, window), centre=outlet.centre)
        except ValueError as problem:  # no grain is there, or the layer is thinner than a cell: the fields are known
            numbers = (measured("v_z", math.nan, 0, str(problem)),)
        else:
            numbers = tuple(measured(name, value) for name, value in means.items())
        return Evaluation((*numbers, measured("stagnant_fraction", bed.pattern.fraction)), bed.arrays())


class KindPatterns(OfRecording):
    """Compute mean fields of each kind of grains of a recorded run over the window of its flow rate, on one grid.

    Arrays:
        KIND.*: Those of `Bed` for each kind; none without kinds.
    """

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
    """Compute mean fields of a bed about three instants of the window (Pongo et al. 2022, Figs 6 and 7).

    Each average takes `window.moment`, or a third of the window if that is shorter.

    Arrays:
        moment-1.*, moment-2.*, moment-3.*: Those of `Bed` at each instant.
    """

    name = "flow_moments"
    version = 3
    declared = ()

    def of(
        self, scene: Scene, frames: Mapping[str, np.ndarray], window: Window, times: tuple[float, float]
    ) -> Evaluation:
        begin, end = times
        length = (end - begin) / _MOMENTS
        half = instant(scene, window, times) / 2
        arrays = {}
        for number in range(_MOMENTS):
            middle = begin + length * (number + 0.5)
            bed = bed_between(scene, frames, (middle - half, middle + half), _FEWEST_ABOUT_AN_INSTANT)
            arrays |= bed.arrays(f"moment-{number + 1}") if bed is not None else {}
        return Evaluation(arrays=arrays)

    @staticmethod
    def beds(evaluation: Evaluation) -> list[Bed]:
        """Read the beds at the instants with enough frames."""
        beds = (Bed.of(evaluation, f"moment-{number + 1}") for number in range(_MOMENTS))
        return [bed for bed in beds if bed is not None]


class FreeFall(OfRecording):
    """Compute the acceleration against height in the middle of the outlet, within half of its half width.

    Arrays:
        edges, acceleration, error, count, interval, left: Those of `AccelerationProfile`; none if no two frames are
            an interval apart.
    """

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
        return Evaluation(arrays=as_arrays(profile))


def bed_between(
    scene: Scene,
    frames: Mapping[str, np.ndarray],
    window: tuple[float, float],
    fewest: int = FEWEST,
    among: np.ndarray | None = None,
) -> Bed | None:
    """Compute mean fields of recorded frames.

    Args:
        scene: The scene.
        frames: Columns of the frames.
        window: Times of the first and last frame [s].
        fewest: Number of frames below which there are no fields.
        among: Mask of the rows of grains that count; None: all. The grid is that of all grains.

    Returns:
        The mean fields; None for fewer frames.

    Raises:
        ImportError: Numba is not installed.
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
