"""The arrays that a member's kernels work on."""

from typing import NamedTuple

import numpy as np

# counters, in State.count
GRAINS, PAIRS, WALLS, STEP, CROSSED, REBUILDS, TOUCHING, FAIL_GRAIN, LEAVING = range(9)
COUNTERS = 9
# sums and clocks, in State.sums
MOVED, WORK, MAX_OVERLAP, FAIL_VALUE = range(4)
SUMS = 4
# columns of a row of State.cross
CROSS_COLUMNS = ("id", "step", "time", "x", "y", "z", "vx", "vy", "vz", "wx", "wy", "wz")


class State(NamedTuple):
    """Grains are rows 0..GRAINS-1 of arrays of n rows; vectors are columns 0..2, in double.

    x [m] at whole steps; v [m/s], w [rad/s] at half steps; u, o: v and w predicted for the whole step; f [N], t [N m].
    Contacts: pair_j of grain i in rows row[i]..row[i+1] ascending, spring of each [m]; wall contacts likewise.
    """

    x: np.ndarray
    v: np.ndarray
    w: np.ndarray
    u: np.ndarray
    o: np.ndarray
    f: np.ndarray
    t: np.ndarray
    ids: np.ndarray
    gone: np.ndarray  # 1 once the grain has crossed the outlet plane
    row: np.ndarray
    pair_j: np.ndarray
    spring: np.ndarray
    wall_row: np.ndarray
    wall_of: np.ndarray
    wall_spring: np.ndarray
    cross: np.ndarray
    count: np.ndarray
    sums: np.ndarray


class Params(NamedTuple):
    """What does not change during a run. c: coefficients between grains; wall_c: the same of each wall [W, 8].

    wall_shape [W, 6], wall_kind [W], wall_motion [W, 4]: velocity and spin of its surface.
    """

    c: tuple
    radius: float
    mass: float
    inertia: float
    gravity: float
    dt: float
    skin: float
    speed_limit: float
    overlap_limit: float
    plane: float
    drop: float
    wall_c: np.ndarray
    wall_shape: np.ndarray
    wall_kind: np.ndarray
    wall_motion: np.ndarray


def allocate(n: int, pairs: int, walls: int, crossings: int) -> State:
    """Zeroed arrays for n grains, that many listed pairs and wall neighbours, and crossings to be recorded."""
    vector = lambda: np.zeros((n, 3))  # noqa: E731
    return State(
        x=vector(), v=vector(), w=vector(), u=vector(), o=vector(), f=vector(), t=vector(),
        ids=np.zeros(n, np.int64),
        gone=np.zeros(n, np.uint8),
        row=np.zeros(n + 1, np.int64),
        pair_j=np.zeros(pairs, np.int32),
        spring=np.zeros((pairs, 3)),
        wall_row=np.zeros(n + 1, np.int64),
        wall_of=np.zeros(walls, np.int32),
        wall_spring=np.zeros((walls, 3)),
        cross=np.zeros((crossings, len(CROSS_COLUMNS))),
        count=np.zeros(COUNTERS, np.int64),
        sums=np.zeros(SUMS),
    )  # fmt: skip
