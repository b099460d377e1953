"""Frames of a recorded run, as films and recordings show them."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from labbook.measure import RunData
from labbook.scene import Packing, Scene

FRAMES = 200
"""Largest number of frames of a run in a recording, unless it has few grains."""
Q_COLUMNS = ("qw", "qx", "qy", "qz")


class NotRecorded(Exception):
    """The run kept no frames; the message says how to ask for them."""


class Frame(NamedTuple):
    """Grains at a time of a run.

    Attributes:
        time: Time since the opening [s].
        x: Centres [m], shape [n, 3], in single precision.
        v: Velocities [m/s], shape [n, 3], in single precision.
        ids: Names of the grains, shape [n].
        q: Orientations of rods and clumps as quaternions, shape [n, 4]; None for spheres.
    """

    time: float
    x: np.ndarray
    v: np.ndarray
    ids: np.ndarray
    q: np.ndarray | None = None

    @property
    def speed(self) -> np.ndarray:
        """Speeds [m/s], shape [n]."""
        return np.linalg.norm(self.v, axis=1)

    def empty(self, time: float) -> "Frame":
        """Make a frame without grains.

        Args:
            time: Time since the opening [s].

        Returns:
            Empty frame.
        """
        q = None if self.q is None else self.q[:0]
        return Frame(time, self.x[:0], self.v[:0], self.ids[:0], q)


def frames_of_run(data: RunData, sample: Mapping[str, np.ndarray] | None, limit: int) -> list[Frame]:
    """Select frames of a run from its opening to its end.

    Args:
        data: Run.
        sample: Its recorded frames, columns id, time, x, y, z, vx, vy, vz as the probe `Film` lists them.
        limit: Largest number of frames.

    Returns:
        Frames by time.

    Raises:
        NotRecorded: The run kept no frames.
    """
    late = sample is not None and float(np.min(sample["time"], initial=math.inf)) > 0
    frames = frames_of(sample, limit - late - (data.outcome == "emptied"))
    if late:
        frames.insert(0, at_opening(data.start, frames[0].q is not None))  # or nothing would be seen at first
    if data.outcome == "emptied" and data.duration > frames[-1].time:
        frames.append(frames[-1].empty(data.duration))  # or the last grains would be seen until the end
    return frames


def frames_of(table: Mapping[str, np.ndarray] | None, limit: int = FRAMES) -> list[Frame]:
    """Select frames of a sample: all, every second, every third ... from the first on.

    Args:
        table: Recorded frames, as of `frames_of_run`.
        limit: Largest number of frames.

    Returns:
        Frames by time.

    Raises:
        NotRecorded: There are none.
    """
    if table is None or not len(table["time"]):
        raise NotRecorded(
            "this run kept no frames: add `record: {every: 10 ms, replicates: 1}` to its study and run it"
        )
    times, starts = np.unique(table["time"], return_index=True)
    ends = np.append(starts[1:], len(table["time"]))
    frames = []
    for k in range(0, len(times), math.ceil(len(times) / limit)):
        rows = slice(starts[k], ends[k])
        x = np.stack([table[c][rows] for c in ("x", "y", "z")], axis=1)
        v = np.stack([table[c][rows] for c in ("vx", "vy", "vz")], axis=1)
        q = np.stack([table[c][rows] for c in Q_COLUMNS], axis=1) if "qw" in table else None
        frames.append(Frame(float(times[k]), x.astype(np.float32), v.astype(np.float32), table["id"][rows], q))
    return frames


def at_opening(start: Packing, oriented: bool) -> Frame:
    """Make the frame of the packing that a run started from.

    Args:
        start: Packing.
        oriented: Give orientations of rods.

    Returns:
        Frame at time 0.
    """
    start = start.entered
    assert start.ids is not None
    q = start.q.astype(np.float32) if oriented and start.q is not None else None
    return Frame(0.0, start.x.astype(np.float32), start.v.astype(np.float32), start.ids, q)


def top_speed(scene: Scene, frames: Sequence[Frame]) -> float:
    """Find the speed at the upper end of the colours: only one grain in 200 exceeds it.

    It is at least a hundredth of sqrt(g d), so that the last trembling of a bed at rest is not seen as motion.

    Args:
        scene: Scene of the run.
        frames: Frames of the run.

    Returns:
        Speed [m/s].
    """
    negligible = 0.01 * math.sqrt(scene.gravity * scene.grains.diameter)
    return max(negligible, float(np.quantile(np.concatenate([frame.speed for frame in frames]), 0.995)))
