"""The arrays that a member's kernels work on."""

from typing import NamedTuple

import numpy as np

# counters, in State.count
GRAINS, PAIRS, STEP, CROSSED, REBUILDS, TOUCHING, FAIL_GRAIN, LEAVING, WANT_PAIRS, WANT_WALLS = range(10)
COUNTERS = 10
# sums and clocks, in State.sums
MOVED, WORK, MAX_OVERLAP, FAIL_VALUE = range(4)
SUMS = 4
BLOCK_COLUMNS = 20
# columns of a row of State.cross
CROSS_COLUMNS = ("id", "step", "time", "x", "y", "z", "vx", "vy", "vz", "wx", "wy", "wz")


class State(NamedTuple):
    """Grains are rows 0..GRAINS-1 of arrays of n rows; vectors are columns 0..2, in double.

    x [m] at whole steps; v [m/s], w [rad/s] half a step before; u: v predicted for now; f [N], t [N m].
    Near pairs: grains pair_i < pair_j, both ascending, with the spring [m] of each, shape [3, pairs], valid where
    `held`. Near walls likewise: those of wall w are wall_first[w]..wall_first[w + 1], grains ascending.
    """

    x: np.ndarray
    v: np.ndarray
    w: np.ndarray
    u: np.ndarray
    f: np.ndarray
    t: np.ndarray
    ids: np.ndarray
    gone: np.ndarray  # 1 once the grain has crossed the outlet plane
    pair_i: np.ndarray
    pair_j: np.ndarray
    held: np.ndarray
    spring: np.ndarray
    wall_first: np.ndarray
    wall_grain: np.ndarray
    wall_held: np.ndarray
    wall_spring: np.ndarray
    cross: np.ndarray
    count: np.ndarray
    sums: np.ndarray
    # scratch: a block of contacts and the list entries in it, squares of speeds; and the same memory as integers
    block: np.ndarray
    bits: np.ndarray
    slot: np.ndarray
    speed2: np.ndarray
    speed_bits: np.ndarray


SCRATCH = ("block", "bits", "slot", "speed2", "speed_bits")


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


def allocate(n: int, pairs: int, walls: int, near_walls: int, crossings: int) -> State:
    """Zeroed arrays for n grains, so many listed pairs, walls and grains near them, and crossings to be recorded."""
    block, speed2 = _aligned(BLOCK_COLUMNS * 128 + 8), _aligned(n + 1)
    return State(
        **{name: np.zeros((n, 3)) for name in ("x", "v", "w", "u", "f", "t")},
        ids=np.zeros(n, np.int64),
        gone=np.zeros(n, np.uint8),
        pair_i=np.zeros(pairs, np.int32),
        pair_j=np.zeros(pairs, np.int32),
        held=np.zeros(pairs, np.uint8),
        spring=np.zeros((3, pairs)),
        wall_first=np.zeros(walls + 1, np.int64),
        wall_grain=np.zeros(near_walls, np.int32),
        wall_held=np.zeros(near_walls, np.uint8),
        wall_spring=np.zeros((3, near_walls)),
        cross=np.zeros((crossings, len(CROSS_COLUMNS))),
        count=np.zeros(COUNTERS, np.int64),
        sums=np.zeros(SUMS),
        block=block,
        bits=block.view(np.int64),
        slot=np.zeros(128 + 1, np.int32),
        speed2=speed2,
        speed_bits=speed2.view(np.int64),
    )


def _aligned(n: int) -> np.ndarray:
    """Zeros that start on a cache line, as wide loads like it."""
    raw = np.zeros(n + 8)
    start = -(raw.ctypes.data // 8) % 8
    return raw[start : start + n]
