"""Acceleration of grains above an orifice against height: where the free fall begins (Pongo et al. 2022, Fig. 10)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labbook.measure.measure import Evaluation, unpacked


@dataclass(frozen=True, eq=False)
class AccelerationProfile:
    """Mean of (v_z(t + dt) - v_z(t)) / dt [m/s^2] of grains that start within a bin of height.

    `edges` [m] of the bins, shape [m + 1]; `acceleration`, its standard `error` over grains (those of one grain in
    several frames hang together: a lower bound) and the `count` of pairs, shape [m]; NaN without any. `left`: part of
    the pairs whose end was not seen, because the grain had left, and was continued by free fall.
    """

    edges: np.ndarray
    acceleration: np.ndarray
    error: np.ndarray
    count: np.ndarray
    interval: float
    left: float

    @classmethod
    def of(cls, evaluation: Evaluation) -> "AccelerationProfile | None":
        """The profile as a measure has given it; None without any."""
        return unpacked(cls, evaluation.arrays)

    def free_fall_height(self, gravity: float) -> float:
        """Area under a_eff/g [m] over the bins that saw a grain; NaN if no bin did.

        With a short interval it is the height from which free fall would give the square of the velocity that grains
        gain on their way. With a longer one it is more, since what a grain gains is booked where it started.
        """
        occupied = self.count > 0
        gained = -(self.acceleration * np.diff(self.edges))[occupied].sum() / gravity
        return float(gained) if occupied.any() else np.nan


def pooled_profile(profiles: Sequence[AccelerationProfile]) -> AccelerationProfile:
    """Mean over replicates that have the same bins, each counting alike; of two and more, the error is that between
    replicates, of one its own. Raises ValueError for none or for other bins."""
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
    """Effective acceleration of the grains within `radius` [m] of the axis (of x = `centre` if `planar`).

    `sample`: rows with step, time, id, x, y, z, vz; to each frame belongs the later one that is nearest to `interval`
    [s] after it, and none if that is half as long or half as long again. A grain is binned by the height it starts
    from: in 50 ms a falling one passes 30 mm. Of a grain that has left by then, or is a `radius` higher since it was
    put back, the last row before is continued by free fall. Raises ValueError if no two frames are `interval` apart.
    """
    time, first = np.unique(np.asarray(sample["time"], float), return_inverse=True)
    starts, ends = _pairs(time, interval)
    if not len(starts):
        raise ValueError(f"no two of {len(time)} frames are about {interval:g} s apart")
    after = time[ends] - time[starts]
    columns = int(np.max(sample["id"])) + 1
    v = np.full((len(time), columns), np.nan)
    height = np.full((len(time), columns), np.nan)
    ids = np.asarray(sample["id"], int)
    v[first, ids], height[first, ids] = sample["vz"], sample["z"]
    off = np.asarray(sample["x"], float) - centre
    near = np.zeros((len(time), columns), bool)
    near[first, ids] = (abs(off) if planar else np.hypot(off, sample["y"])) <= radius
    start = near[starts] & ((time >= begin) & (time <= end))[starts, None]
    later = np.where(height[ends] > height[starts] + radius, np.nan, v[ends])
    absent = np.isnan(later) & start
    for back in range(1, int((ends - starts).max()) + 1):  # the latest row that there is
        row = np.maximum(ends - back, starts)
        earlier = v[row] - gravity * (time[ends] - time[row])[:, None]
        earlier[height[row] > height[starts] + radius] = np.nan
        later = np.where(np.isnan(later), earlier, later)
    gained = ((later - v[starts]) / after[:, None])[start]
    place = np.searchsorted(edges, height[starts][start], side="right") - 1
    within = (place >= 0) & (place < len(edges) - 1)
    gained, place = gained[within], place[within]
    count = np.bincount(place, minlength=len(edges) - 1)
    total, square = (np.bincount(place, gained**power, len(edges) - 1) for power in (1, 2))
    mean = np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)
    spread = np.maximum(np.divide(square, count, out=np.full(len(count), np.nan), where=count > 0) - mean**2, 0)
    error = np.sqrt(np.divide(spread, count - 1, out=np.full(len(count), np.nan), where=count > 1))
    left = float(absent.sum() / start.sum()) if start.any() else np.nan
    return AccelerationProfile(np.asarray(edges, float), mean, error, count, float(np.median(after)), left)


def _pairs(time: np.ndarray, interval: float) -> tuple[np.ndarray, np.ndarray]:
    """Frames, and those about `interval` later."""
    above = np.minimum(np.searchsorted(time, time + interval), len(time) - 1)
    below = np.maximum(above - 1, 0)
    nearest = np.where(abs(time[below] - time - interval) < abs(time[above] - time - interval), below, above)
    starts = np.flatnonzero(abs(time[nearest] - time - interval) < interval / 2)
    return starts, nearest[starts]
