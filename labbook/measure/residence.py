"""Residence times: of a fed silo as a distribution, of a batch discharge as a map over the initial position."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe
from labbook.measure.composition import OutflowShares, outflow_shares
from labbook.measure.data import RunData
from labbook.measure.flow import FlowRate
from labbook.measure.measure import Evaluation, Measure, Quantity, Window, as_arrays, from_arrays, window_in_words
from labbook.measure.series import crossing_times
from labbook.measure.steady import SteadyFlow, outflow
from labbook.scene import Bodies, Scene
from labbook.stats import Measured
from labbook.stats.survival import kaplan_meier

LAYERS = 5
"""Layers of equal mass by initial height."""
BIN_OF_LAYERS = 100
"""Grains in a bin of the outflow of layers, at least."""
CELL = 3.0
"""Edge of the cells of the initial position, in equivalent diameters."""
LEFT_OVER = 0.01
"""Part of the residence times that may be longer than the longest observed one."""
_LAYER = "layer_"
_AGES = 60
"""Steps of the distribution that is kept."""


@dataclass(frozen=True, eq=False)
class ResidenceCurve:
    """Distribution F(t) of residence times of a fed silo; the exit-age distribution is E = dF/dt.

    Attributes:
        age: Residence times t [s], shape [k].
        part: F, the fraction of the outflow that has stayed shorter than t, shape [k].
        mean: Mean residence time, the integral of 1 - F [s].
    """

    age: np.ndarray
    part: np.ndarray
    mean: float

    @classmethod
    def of(cls, evaluation: Evaluation) -> "ResidenceCurve | None":
        """Read the distribution from an evaluation; None of a batch discharge."""
        names = ("age", "part", "mean")
        return from_arrays(cls, {name: evaluation.arrays[name] for name in names if name in evaluation.arrays})


@dataclass(frozen=True, eq=False)
class ResidenceMap:
    """Residence times of a batch discharge over the initial position.

    Attributes:
        across: Edges of the cells in the distance from the axis, or in x where the container has none [m], shape
            [c + 1].
        z: Edges of the cells in height [m], shape [r + 1].
        median: Time at which half of the grains of a cell had left [s], shape [r, c]; NaN of an empty cell, and
            infinite if they had not.
        grains: Number of grains of a cell, shape [r, c].
    """

    across: np.ndarray
    z: np.ndarray
    median: np.ndarray
    grains: np.ndarray

    @classmethod
    def of(cls, evaluation: Evaluation) -> "ResidenceMap | None":
        """Read the map from an evaluation; None of a fed silo."""
        names = ("across", "z", "median", "grains")
        return from_arrays(cls, {name: evaluation.arrays[name] for name in names if name in evaluation.arrays})


def layers_of(evaluation: Evaluation) -> OutflowShares | None:
    """Read the composition of the outflow by initial layers, from the lowest; None without one."""
    layers = {name: array for name, array in evaluation.arrays.items() if name.startswith(_LAYER)}
    return from_arrays(OutflowShares, {name.removeprefix(_LAYER): array for name, array in layers.items()})


def durations(grain: np.ndarray, time: np.ndarray, begin: float, end: float) -> tuple[np.ndarray, np.ndarray]:
    """Find times between passages of the same grain that begin within a window.

    A silo of which every grain comes back has as many residence times as passages. Those that had not ended at the end
    of the window are censored, and not left out: the window would favour short ones.

    Args:
        grain: Identity of the grain of each passage, shape [n].
        time: Time of each passage [s], shape [n].
        begin: Begin of the window [s].
        end: End of the window [s].

    Returns:
        Durations [s], and a mask of those that ended within the window; shape [passages in the window].
    """
    order = np.lexsort((time, grain))
    grain, time = grain[order], time[order]
    # The next row is the next passage of the same grain, unless the grain changes there.
    following = np.append(time[1:], math.inf)
    following[np.append(grain[1:] != grain[:-1], True)] = math.inf
    first = (time >= begin) & (time < end)
    ended = following[first] <= end
    return np.where(ended, following[first], end) - time[first], ended


def survival(duration: np.ndarray, ended: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Estimate the fraction of residence times longer than each age [s] (`kaplan_meier`); it begins with 1 at age 0."""
    curve = kaplan_meier(duration, ended)
    return np.concatenate([[0.0], curve.x]), np.concatenate([[1.0], curve.p])


def moments(age: np.ndarray, longer: np.ndarray) -> tuple[float, float]:
    """Integrate mean [s] and variance [s^2] of residence times; `longer`: fraction above each age, a step function."""
    mean = float(longer[:-1] @ np.diff(age))
    return mean, float(longer[:-1] @ np.diff(age**2)) - mean**2


def peclet(variance: float) -> float:
    """Péclet number of axial dispersion between closed ends; NaN where the spread is wider than that of a mixed tank.

    Solves s^2 = 2/Pe - 2 (1 - e^-Pe)/Pe^2 (van der Laan, Chem. Eng. Sci. 7 (1958) 187).

    Args:
        variance: of the residence time, over the square of its mean.
    """
    from scipy.optimize import root_scalar

    def spread(pe: float) -> float:
        return 2 / pe + 2 * math.expm1(-pe) / pe**2

    # beyond these ends both terms cancel to round-off
    low, high = 1e-3, 1e9
    if not spread(high) < variance < spread(low):
        return math.nan
    return root_scalar(lambda pe: spread(pe) - variance, bracket=(low, high), method="brentq").root


_OF_TIMES = (
    Quantity("residence_mean", "⟨t⟩", "s", "mean residence time in a fed silo"),
    Quantity(
        "dead_fraction", "dead", "", "part of a fed bed that takes no part in the flow", "%", 100, about_zero=True
    ),
    Quantity("residence_variance", "σ²/⟨t⟩^(2)", "", "variance of the residence time over its mean squared"),
    Quantity("peclet", "Pe", "", "Péclet number of axial dispersion with this variance"),
)


class Residence(Measure):
    """Measure residence times: between two passages of a grain of a fed silo, or until a grain of a batch leaves.

    The fall from the outlet to the return onto the bed counts as residence. If more than 1 % of the times are longer
    than the window, all quantities but the first are NaN with a note. A batch discharge gives arrays only.

    Quantities:
        holdup_time: Number of grains over grains per second [s], the mean residence time if all grains take part in
            the flow.
        residence_mean: Mean residence time [s].
        dead_fraction: 1 - mean / hold-up time, the fraction of grains that take no part in the flow.
        residence_variance: Variance over the square of the mean.
        peclet: Péclet number of axial dispersion with this variance (van der Laan, Chem. Eng. Sci. 7 (1958) 187).

    Arrays:
        age, part, mean: Those of `ResidenceCurve`, of a fed silo.
        across, z, median, grains: Those of `ResidenceMap`, of a batch.
        layer_*: Those of `OutflowShares` of a batch, for 5 layers of equal mass by initial height. Layers are labels of
            the evaluation: they change no run.

    Raises:
        MeasureError: The container has no outlet.
    """

    name = "residence"
    version = 1
    needs_all = True
    declared = (Quantity("holdup_time", "N/Q", "s", "grains in a fed silo over grains per second"), *_OF_TIMES)

    def check(self, scene: Scene) -> None:
        FlowRate().check(scene)

    def quantities(self, scene: Scene) -> tuple[Quantity, ...]:
        return () if scene.feed is None else self.declared

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        return FlowRate().probes(scene, numerics)

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        self.check(run.scene)
        if run.scene.feed is None:
            return Evaluation(arrays=_batch(run))
        flow, _ = outflow(run, window)
        table = run.tables["crossing"]
        if flow is None:
            where, few = window_in_words(window), "too few grains left for a window"
            none = Measured("holdup_time", math.nan, math.nan, 0, where, "passages", "s", few)
            return Evaluation((none, *_undetermined(where, few)))
        time = np.asarray(table["time"], float)
        age, longer = survival(*durations(np.asarray(table["id"]), time, flow.begin, flow.end))
        return Evaluation(tuple(self._numbers(len(run.start), flow, age, longer)), _curve(age, longer))

    def _numbers(self, count: int, flow: SteadyFlow, age: np.ndarray, longer: np.ndarray) -> Iterator[Measured]:
        where, holdup = f"{flow.begin:.4g} s to {flow.end:.4g} s", count / flow.grain_rate
        how = "grains in the silo over grains per second; error from blocks"
        error = holdup * flow.grain_error / flow.grain_rate
        yield Measured("holdup_time", holdup, error, flow.grain_n_effective, where, how, "s", "")
        if longer[-1] > LEFT_OVER:
            note = f"{100 * longer[-1]:.2g} % of the grains stay longer than {age[-1]:.3g} s; let the run last longer"
            yield from _undetermined(where, note)
            return
        mean, variance = moments(age, longer)
        values = (mean, 1 - mean / holdup, variance / mean**2)
        how = "times between passages of the same grain, censored at the end of the window; error from seeds only"
        for quantity, value in zip(_OF_TIMES, (*values, peclet(values[-1])), strict=True):
            note = "" if math.isfinite(value) else "the spread is wider than that of a mixed tank"
            yield Measured(quantity.name, value, math.nan, flow.grains, where, how, quantity.unit, note)


def _undetermined(where: str, note: str) -> Iterator[Measured]:
    for quantity in _OF_TIMES:
        yield Measured(quantity.name, math.nan, math.nan, 0, where, "passages", quantity.unit, note)


def _curve(age: np.ndarray, longer: np.ndarray) -> dict[str, np.ndarray]:
    """Arrays of a `ResidenceCurve` at equal steps of the age."""
    mean, _ = moments(age, longer)
    grid = np.linspace(0.0, age[-1], _AGES + 1)
    fraction = 1 - longer[np.searchsorted(age, grid, side="right") - 1]
    return as_arrays(ResidenceCurve(grid, fraction, mean))


def _batch(run: RunData) -> dict[str, np.ndarray]:
    """Arrays of a `ResidenceMap`, and of `OutflowShares` of initial layers."""
    # raises MeasureError for a run without recorded crossings
    crossing_times(run)
    table = run.tables["crossing"]
    order = np.argsort(table["time"], kind="stable")
    rows = run.start.rows(np.asarray(table["id"])[order])
    left = np.full(len(run.start), math.inf)
    left[rows] = np.asarray(table["time"], float)[order]
    mass, x = Bodies.of(run.scene.grains, run.start).mass, run.start.x
    by_height = np.argsort(x[:, 2], kind="stable")
    layer = np.empty(len(x), np.int64)
    middle = np.cumsum(mass[by_height]) - mass[by_height] / 2
    layer[by_height] = np.minimum(middle / mass.sum() * LAYERS, LAYERS - 1).astype(np.int64)
    shares = outflow_shares(mass, layer, rows, LAYERS, BIN_OF_LAYERS)
    layers = {f"{_LAYER}{name}": array for name, array in as_arrays(shares).items()} if shares.share.size else {}
    return as_arrays(_map(run.scene, x, left)) | layers


def _map(scene: Scene, x: np.ndarray, left: np.ndarray) -> ResidenceMap:
    """Medians over cells. `left`: time at which each grain left [s], infinite if it did not, shape [n]."""
    edge, axial = CELL * scene.grains.equivalent_diameter, scene.container.symmetry == "axial"
    across = np.hypot(x[:, 0], x[:, 1]) if axial else x[:, 0]
    columns = np.floor(across / edge).astype(np.int64)
    lines = np.floor(x[:, 2] / edge).astype(np.int64)
    first, lowest = (0 if axial else int(columns.min())), int(lines.min())
    shape = int(lines.max()) - lowest + 1, int(columns.max()) - first + 1
    cell = (lines - lowest) * shape[1] + columns - first
    order = np.lexsort((left, cell))
    grains = np.bincount(cell, minlength=shape[0] * shape[1])
    begin, median = np.cumsum(grains) - grains, np.full(len(grains), math.nan)
    filled = grains > 0
    # both middle values; of an odd number they are the same one
    low, high = (left[order][(begin + (grains - odd) // 2)[filled]] for odd in (1, 0))
    median[filled] = (low + high) / 2
    edges = [edge * (np.arange(n + 1) + start) for n, start in ((shape[1], first), (shape[0], lowest))]
    return ResidenceMap(edges[0], edges[1], median.reshape(shape), grains.reshape(shape))
