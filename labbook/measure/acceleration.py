"""Acceleration of grains above an orifice against height: where the free fall begins (Pongo et al. 2022, Fig. 10)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labbook.measure.measure import Evaluation, from_arrays


@dataclass(frozen=True, eq=False)
class AccelerationProfile:
    """Mean acceleration (v_z(t + dt) - v_z(t)) / dt of the grains that start within a bin of height.

    Attributes:
        edges: Edges of the bins of height [m], shape [m + 1].
        acceleration: Mean acceleration [m/s^2], shape [m]; NaN for an empty bin.
        error: Its standard error over pairs [m/s^2], shape [m]. It is a lower bound, since pairs of one grain in
            several frames are correlated.
        count: Number of pairs, shape [m].
        interval: Median time dt between both velocities [s].
        left: Fraction of the pairs whose grain had left before the second frame, and was continued by free fall.
    """

    edges: np.ndarray
    acceleration: np.ndarray
    error: np.ndarray
    count: np.ndarray
    interval: float
    left: float

    @classmethod
    def of(cls, evaluation: Evaluation) -> "AccelerationProfile | None":
        """Read the profile from an evaluation; None without one."""
        return from_arrays(cls, evaluation.arrays)

    def free_fall_height(self, gravity: float) -> float:
        """Integrate a_eff/g over height.

        With a short interval the area is the height from which free fall would give the square of the velocity that
        grains gain on their way. A longer interval gives more, since the gain counts where the grain started.

        Args:
            gravity: Acceleration of gravity g [m/s^2].

        Returns:
            The area [m] over the bins with grains; NaN if all are empty.
        """
        occupied = self.count > 0
        gained = -(self.acceleration * np.diff(self.edges))[occupied].sum() / gravity
        return float(gained) if occupied.any() else np.nan


def pooled_profile(profiles: Sequence[AccelerationProfile]) -> AccelerationProfile:
    """Average profiles of replicates with equal weights.

    Returns:
        The mean profile. From two replicates on its error is that between replicates.

    Raises:
        ValueError: There are no profiles, or their bins differ.
    """
    if not profiles or any(not np.array_equal(profile.edges, profiles[0].edges) for profile in profiles):
        raise ValueError("profiles of the same bins are needed, and at least one")
    if len(profiles) == 1:
        return profiles[0]
    values = np.array([profile.acceleration for profile in profiles])
    n = np.isfinite(values).sum(axis=0)
    filled = np.where(np.isfinite(values), values, 0.0)
    mean = np.divide(filled.sum(axis=0), n, out=np.full(len(n), np.nan), where=n > 0)
    square = np.where(np.isfinite(values), (values - mean) ** 2, 0.0).sum(axis=0)
    error = np.sqrt(np.divide(square, n * (n - 1), out=np.full(len(n), np.nan), where=n > 1))
    count, left = sum(profile.count for profile in profiles), float(np.mean([profile.left for profile in profiles]))
    return AccelerationProfile(profiles[0].edges, mean, error, np.asarray(count), profiles[0].interval, left)


def acceleration_profile(
    sample: Mapping[str, np.ndarray],
    *,
    interval: float,
    radius: float,
    edges: np.ndarray,
    gravity: float,
    begin: float = 0.0,
    end: float = np.inf,
    centre: float = 0.0,
    planar: bool = False,
) -> AccelerationProfile:
    """Compute the effective acceleration of grains near the axis, by height (Pongo et al. 2022, Fig. 10).

    A grain is binned by the height at which it starts: in 50 ms a falling grain passes 30 mm. If it has left by the
    second frame, or is a `radius` higher since it was fed back, its last earlier row is continued by free fall.

    Args:
        sample: Rows with the columns step, time [s], id, x, y, z [m] and vz [m/s].
        interval: Time between the velocities of a pair [s]. Each frame is paired with the frame nearest to it; pairs
            shorter than half or longer than one and a half intervals are left out.
        radius: Largest distance of grains from the axis [m].
        edges: Edges of the bins of height [m], shape [m + 1].
        gravity: Acceleration of gravity [m/s^2].
        begin: First instant at which pairs may start [s].
        end: Last such instant [s].
        centre: x of the axis [m].
        planar: Distances are from the plane x = `centre`, not from the axis.

    Raises:
        ValueError: No two frames are an `interval` apart.
    """
    time, first = np.unique(np.asarray(sample["time"], float), return_inverse=True)
    starts, ends = _pairs(time, interval)
    if not len(starts):
        raise ValueError(f"no two of {len(time)} frames are about {interval:g} s apart")
    after = time[ends] - time[starts]
    # A row for each frame and a column for each identity: values of grains that are not in a frame stay NaN.
    columns = int(np.max(sample["id"])) + 1
    v = np.full((len(time), columns), np.nan)
    height = np.full((len(time), columns), np.nan)
    ids = np.asarray(sample["id"], int)
    v[first, ids], height[first, ids] = sample["vz"], sample["z"]
    off = np.asarray(sample["x"], float) - centre
    near = np.zeros((len(time), columns), bool)
    near[first, ids] = (abs(off) if planar else np.hypot(off, sample["y"])) <= radius
    start = near[starts] & ((time >= begin) & (time <= end))[starts, None]
    # a grain that is higher than before has left and was fed back between both frames
    later = np.where(height[ends] > height[starts] + radius, np.nan, v[ends])
    absent = np.isnan(later) & start
    for back in range(1, int((ends - starts).max()) + 1):  # of a grain that has left, its latest row
        row = np.maximum(ends - back, starts)
        earlier = v[row] - gravity * (time[ends] - time[row])[:, None]
        earlier[height[row] > height[starts] + radius] = np.nan
        later = np.where(np.isnan(later), earlier, later)
    gained = ((later - v[starts]) / after[:, None])[start]
    index = np.searchsorted(edges, height[starts][start], side="right") - 1
    within = (index >= 0) & (index < len(edges) - 1)
    gained, index = gained[within], index[within]
    count = np.bincount(index, minlength=len(edges) - 1)
    total, square = (np.bincount(index, gained**power, len(edges) - 1) for power in (1, 2))
    mean = np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)
    spread = np.maximum(np.divide(square, count, out=np.full(len(count), np.nan), where=count > 0) - mean**2, 0)
    error = np.sqrt(np.divide(spread, count - 1, out=np.full(len(count), np.nan), where=count > 1))
    left = float(absent.sum() / start.sum()) if start.any() else np.nan
    return AccelerationProfile(np.asarray(edges, float), mean, error, count, float(np.median(after)), left)


def _pairs(time: np.ndarray, interval: float) -> tuple[np.ndarray, np.ndarray]:
    """Pair frames: rows of the first ones, and of the frames about an `interval` [s] later."""
    above = np.minimum(np.searchsorted(time, time + interval), len(time) - 1)
    below = np.maximum(above - 1, 0)
    nearest = np.where(abs(time[below] - time - interval) < abs(time[above] - time - interval), below, above)
    starts = np.flatnonzero(abs(time[nearest] - time - interval) < interval / 2)
    return starts, nearest[starts]
