"""How many bytes a grain-step must move, and how many a second the device can."""

from functools import lru_cache

import numpy as np
import warp as wp

from labbook.backend import Load
from labbook_warp import devices
from labbook_warp.arrays import Arrays, fetch
from labbook_warp.stage import Stage

_WORD = 16
_INTS = 4
_COPIED = 1 << 28  # bytes; far beyond any cache
_COPIES = 20


def weigh(stage: Stage) -> Load:
    """Averages over the grains that are there now."""
    arrays, runs = stage.arrays, stage.runs
    listed = touching = walls = rows = rebuilds = 0
    for run in runs:
        here = arrays.read("count", run.slot, run.rows) > 0
        rows += int(here.sum())
        listed += int(arrays.read("count", run.slot, run.rows).sum())
        touching += int(np.bitwise_count(arrays.read("held", run.slot, run.rows)).sum())
        walls += int(np.bitwise_count(arrays.read("wall_held", run.slot, run.rows)).sum())
        rebuilds += int(fetch(arrays.system.rebuilds, run.slot, 1)[0])
    grains = max(rows, 1)
    return Load(
        listed=listed / grains,
        touching=(touching + walls) / grains,
        bytes=_bytes(arrays, listed / grains, (touching + walls) / grains, bool(walls)),
        bandwidth=_bandwidth(arrays.device),
        lanes=arrays.module.LANES,
        rebuilds=rebuilds / max(len(runs), 1),
    )


def _bytes(arrays: Arrays, listed: float, touching: float, walls: bool) -> float:
    """At least: state in and out, list in, springs of what touches in and out, bits and counts."""
    spring = 3 * (4 if arrays.codec.mixed else 8) * (2 if arrays.module.ROLLING_SPRING else 1)
    masks = 2 * _INTS + (2 * _INTS if walls else 0)  # neighbours: how many, which are held; walls: near, held
    what = 2 * _WORD if arrays.module.VARIED else 0
    if arrays.module.ORIENTED:
        what += 2 * (2 * _WORD + (_WORD if arrays.codec.mixed else 2 * _WORD))  # orientation, momentum
    return what + 2 * arrays.codec.words * _WORD + listed * _INTS + 2 * touching * spring + masks


@lru_cache(maxsize=16)
def present_bandwidth(name: str) -> float | None:
    """Measure the bandwidth of the device `name`, once in a process; None on a CPU, or if too little memory is free."""
    device = devices.find(name)
    return _bandwidth(device) if (devices.free(device) or 0) > 4 * _COPIED else None


def _bandwidth(device: wp.Device) -> float:
    """Bytes read and written per second by a plain copy of words of 16 bytes; 0 on a CPU, which it does not limit."""
    if not device.is_cuda:
        return 0.0
    count = _COPIED // _WORD
    a, b = (wp.zeros(count, dtype=wp.vec4f, device=device) for _ in range(2))
    wp.launch(_copy, count, [a, b], device=device)
    start, end = (wp.Event(device, enable_timing=True) for _ in range(2))
    wp.record_event(start)
    for _ in range(_COPIES):
        wp.launch(_copy, count, [a, b], device=device)
    wp.record_event(end)
    return 2 * _COPIED * _COPIES / (wp.get_event_elapsed_time(start, end) * 1e-3)


@wp.kernel(enable_backward=False)
def _copy(a: wp.array(dtype=wp.vec4f), b: wp.array(dtype=wp.vec4f)):  # pyright: ignore[reportInvalidTypeForm]
    k = wp.tid()
    b[k] = a[k]
