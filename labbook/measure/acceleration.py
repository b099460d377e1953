"""Acceleration of grains above an orifice against height: where the free fall begins (Pongo et al. 2022, Fig. 10)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np


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

    `sample`: rows with step, time, id, x, y, z, vz, at equal times; `interval` dt [s] is rounded to whole frames. A
    grain is binned by the height it starts from: in 50 ms a falling one passes 30 mm. Of a grain that has left by
    then, the last row that it has is continued by free fall. Raises ValueError if no two frames are `interval` apart.
    """
    time, first = np.unique(np.asarray(sample["time"], float), return_inverse=True)
    every = float(np.median(np.diff(time))) if len(time) > 1 else np.inf
    apart = round(interval / every)
    if apart < 1 or apart >= len(time):
        raise ValueError(f"no two of {len(time)} frames, {every:g} s apart, are {interval:g} s apart")
    most = int(np.max(sample["id"])) + 1
    v = np.full((len(time), most), np.nan)
    height = np.full((len(time), most), np.nan)
    ids = np.asarray(sample["id"], int)
    v[first, ids], height[first, ids] = sample["vz"], sample["z"]
    off = np.asarray(sample["x"], float) - centre
    near = np.zeros((len(time), most), bool)
    near[first, ids] = (abs(off) if planar else np.hypot(off, sample["y"])) <= radius
    start = near[:-apart] & ((time >= begin) & (time <= end))[: len(time) - apart, None]
    later = v[apart:].copy()
    gone = np.isnan(later) & start
    for back in range(1, apart + 1):  # the latest row that there is
        earlier = v[apart - back : len(time) - back] - gravity * back * every
        later = np.where(np.isnan(later), earlier, later)
    gained = ((later - v[:-apart]) / (apart * every))[start]
    place = np.searchsorted(edges, height[:-apart][start], side="right") - 1
    within = (place >= 0) & (place < len(edges) - 1)
    gained, place = gained[within], place[within]
    count = np.bincount(place, minlength=len(edges) - 1)
    total, square = (np.bincount(place, gained**power, len(edges) - 1) for power in (1, 2))
    mean = np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)
    spread = np.maximum(np.divide(square, count, out=np.full(len(count), np.nan), where=count > 0) - mean**2, 0)
    error = np.sqrt(np.divide(spread, count - 1, out=np.full(len(count), np.nan), where=count > 1))
    left = float(gone.sum() / start.sum()) if start.any() else np.nan
    return AccelerationProfile(np.asarray(edges, float), mean, error, count, apart * every, left)
