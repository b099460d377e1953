"""Memory traffic of a grain-step, and bandwidth of the device."""

import numpy as np

from labbook.backend import Load
from labbook_warp.arrays import Arrays, fetch
from labbook_warp.copies import bandwidth
from labbook_warp.stage import Stage

_WORD = 16
_INTS = 4


def weigh(stage: Stage) -> Load:
    """Averages over the present grains of all members."""
    arrays, runs = stage.arrays, stage.runs
    listed = touching = walls = rows = spheres = rebuilds = 0
    for run in runs:
        here = arrays.read("count", run.slot, run.rows) > 0
        spheres += int(here.sum())
        rows += int(here.sum()) // run.per_grain
        listed += int(arrays.read("count", run.slot, run.rows).sum())
        touching += int(np.bitwise_count(arrays.read("held", run.slot, run.rows)).sum())
        walls += int(np.bitwise_count(arrays.read("wall_held", run.slot, run.rows)).sum())
        rebuilds += int(fetch(arrays.system.rebuilds, run.slot, 1)[0])
    grains = max(rows, 1)
    return Load(
        listed=listed / grains,
        touching=(touching + walls) / grains,
        bytes=_bytes(arrays, max(spheres, 1) / grains, listed / grains, (touching + walls) / grains, bool(walls)),
        bandwidth=bandwidth(arrays.device),
        lanes=arrays.module.LANES,
        rebuilds=rebuilds / max(len(runs), 1),
    )


def _bytes(arrays: Arrays, rows: float, listed: float, touching: float, walls: bool) -> float:
    """Least bytes a grain-step: state of its rows read and written, list read, springs of contacts read and written,
    masks and counts."""
    spring_bytes = 3 * (4 if arrays.codec.mixed else 8) * (2 if arrays.module.ROLLING_SPRING else 1)
    mask_bytes = 2 * _INTS + (2 * _INTS if walls else 0)  # neighbours: count, mask of springs; walls: near, springs
    state = 2 * _WORD if arrays.module.VARIED else 0
    if arrays.module.ORIENTED:
        state += 2 * (2 * _WORD + (_WORD if arrays.codec.mixed else 2 * _WORD))  # orientation, momentum
    of_row = state + 2 * arrays.codec.words * _WORD + mask_bytes
    return rows * of_row + listed * _INTS + 2 * touching * spring_bytes
