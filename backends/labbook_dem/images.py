"""Periodic sides: nearest images of grains in a container that repeats along y (`labbook.scene.periodic`)."""

from labbook_dem.words import PERIODIC, floor, func, wide, wide3


@func
def nearest(y: wide, period: wide):
    """A coordinate, or the difference of two [m], brought to -period/2 up to period/2."""
    return y - floor(y * (wide(1.0) / period) + wide(0.5)) * period


@func
def image(v: wide3, period: wide):
    """A place in the box, or the branch between two grains there as that between their nearest images [m]."""
    return wide3(v.x, nearest(v.y, period), v.z) if PERIODIC else v
