"""Copy bandwidth of a device."""

from functools import lru_cache

import warp as wp

from labbook_warp import devices

_WORD = 16
_COPIED = 1 << 28  # bytes; far beyond any cache
_COPIES = 20


@lru_cache(maxsize=16)
def present_bandwidth(name: str) -> float | None:
    """Measure the bandwidth of the device `name` [bytes/s], once a process; None on a CPU, or with too little free
    memory."""
    device = devices.find(name)
    return bandwidth(device) if (devices.free(device) or 0) > 4 * _COPIED else None


def bandwidth(device: wp.Device) -> float:
    """Bytes read and written per second by a copy of words of 16 bytes; 0 on a CPU, where it is no limit."""
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
