"""The outflow of a run against time."""

import math

import numpy as np

from labbook.backend.probes import Table
from labbook.measure.data import RunData
from labbook.measure.measure import MeasureError
from labbook.scene import Grains, Packing
from labbook.scene.bodies import masses


def crossings(run: RunData) -> tuple[np.ndarray, np.ndarray]:
    """List the crossings of the outlet in the order of time.

    Returns:
        Times [s], and the mass of each grain in units of the mean mass, shape [n].

    Raises:
        MeasureError: The run recorded no crossings.
    """
    crossing_times(run)
    return passages(run.scene.grains, run.start, run.tables["crossing"])


def passages(grains: Grains, start: Packing, table: Table) -> tuple[np.ndarray, np.ndarray]:
    """List the crossings from rows of the probe `Crossing`, for a run from the packing `start`; as `crossings`."""
    order = np.argsort(table["time"], kind="stable")
    times, mass = np.asarray(table["time"], float)[order], masses(grains, start)
    if not isinstance(mass, np.ndarray):
        return times, np.ones(len(times))
    return times, mass[start.rows(np.asarray(table["id"])[order])] / mass.mean()


def crossed_outlets(run: RunData) -> np.ndarray:
    """Find the outlet of each grain that left: the one whose lid is nearest.

    Returns:
        Its index among the container's outlets, in the order of `crossings`, shape [n].
    """
    table = run.tables["crossing"]
    x = np.column_stack([np.asarray(table[axis], float) for axis in "xyz"])
    return run.scene.container.outlet_of(x[np.argsort(table["time"], kind="stable")])


def mean_mass(run: RunData) -> float:
    """Mean mass [kg] of the grains at the start."""
    return float(np.mean(masses(run.scene.grains, run.start)))


def crossing_times(run: RunData) -> np.ndarray:
    """List ascending times of crossings [s], shape [n].

    Raises:
        MeasureError: The run recorded no crossings.
    """
    if "crossing" not in run.tables:
        raise MeasureError("flow_rate: the run recorded no crossings of the outlet; run it again with this measure")
    return np.sort(np.asarray(run.tables["crossing"]["time"], float))


def flow_series(run: RunData, bin_width: float) -> tuple[np.ndarray, np.ndarray]:
    """Compute the mass flow rate in bins of time.

    Bins cover the run from the opening to its end; an incomplete last one is left out.

    Args:
        run: The run.
        bin_width: Width of a bin [s].

    Returns:
        Bin centres [s] and W [kg/s], each of shape [m].

    Raises:
        ValueError: The run is shorter than a bin.
        MeasureError: The run recorded no crossings.
    """
    count = math.floor(run.duration / bin_width * (1 + 1e-12)) if bin_width > 0 else 0
    if count < 1:
        raise ValueError(f"a bin of {bin_width} s does not fit into a run of {run.duration} s")
    edges = bin_width * np.arange(count + 1)
    times, weights = crossings(run)
    grains, _ = np.histogram(times, edges, weights=weights)
    return (edges[:-1] + edges[1:]) / 2, grains * mean_mass(run) / bin_width


def smooth_flow(run: RunData, at: np.ndarray, width: float) -> np.ndarray:
    """Compute the mass flow rate from crossings smoothed by a Gaussian.

    Near the opening and the end of the run the rate is normalised by the part of the Gaussian that lies within.

    Args:
        run: The run.
        at: Times [s], shape [m].
        width: Standard deviation of the Gaussian [s].

    Returns:
        W at these times [kg/s], shape [m].

    Raises:
        ValueError: The width is not positive.
        MeasureError: The run recorded no crossings.
    """
    from scipy.special import ndtr

    (times, weights), at = crossings(run), np.asarray(at, float)
    if not width > 0:
        raise ValueError("the width of a smoothing must be positive")
    rate = np.empty(len(at))
    near = 6 * width
    low, high = np.searchsorted(times, at - near), np.searchsorted(times, at + near)
    for k, (a, b) in enumerate(zip(low, high, strict=True)):
        rate[k] = (weights[a:b] * np.exp(-0.5 * ((times[a:b] - at[k]) / width) ** 2)).sum()
    within = ndtr((run.duration - at) / width) - ndtr(-at / width)
    return mean_mass(run) * rate / (math.sqrt(2 * math.pi) * width * within)


def flow_curve(run: RunData) -> tuple[np.ndarray, np.ndarray] | None:
    """Compute W(t) for pictures, smoothed over about 30 grains.

    Returns:
        Times from the opening to the end [s] and rates [g/s], each of shape [n]; None if fewer than two grains left.
    """
    if "crossing" not in run.tables or len(times := crossing_times(run)) < 2:
        return None
    width = _GRAINS_SMOOTHED / math.sqrt(2 * math.pi) * float(times[-1] - times[0]) / (len(times) - 1)
    at = np.linspace(0, run.duration, _TIMES)
    return (at, smooth_flow(run, at, width) * 1e3) if width > 0 else None


_GRAINS_SMOOTHED, _TIMES = 30, 500


def discharged(run: RunData) -> tuple[np.ndarray, np.ndarray]:
    """List times [s] of all crossings, and the mass [kg] discharged just after each, shape [n]."""
    times, weights = crossings(run)
    return times, mean_mass(run) * np.cumsum(weights)
