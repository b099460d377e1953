"""Frames as they are kept: in single precision and, for a recording, no more of them than it needs."""

import numpy as np

from labbook.backend.probes import Table

MOST_FRAMES = 200

_WHOLE = {"id": np.int32, "i": np.int32, "j": np.int32, "wall": np.int16, "step": np.int64, "time": np.float64}


def frame_rows(table: Table) -> Table:
    """Rows of grains or contacts in single precision, but for ids, step and time.

    Positions are then known to 1e-8 m and velocities to 1e-7 of themselves: far below what fields resolve.
    """
    return {name: np.asarray(column).astype(_WHOLE.get(name, np.float32)) for name, column in table.items()}


def thinned(table: Table, steps_between: int) -> Table:
    """Every frame, every second, every fourth ... so that at most 200 are left.

    Frames lie on multiples of `steps_between`. Which are kept depends only on the last one, so that a run that is
    thinned, continued and thinned again keeps the same frames as one that was never interrupted.
    """
    frame = np.asarray(table["step"]) // steps_between
    stride = 1
    while frame.max(initial=0) // stride > MOST_FRAMES:
        stride *= 2
    kept = frame % stride == 0
    return {name: np.asarray(column)[kept] for name, column in table.items()}
