"""Times and lengths by which an outflow is measured: as a study states them in `window`, or multiples of the scales of
the grains, d* (equivalent diameter) and sqrt(d*/g). So scenes that are similar give similar numbers.

The multiples are close to what Pongo et al. (2022) use for grains with d* = 9.9 mm: 1 s, 50 ms and 1 cm.
"""

import math

from labbook.measure.measure import Window, after_start_up
from labbook.scene import Scene
from labbook.scene.timescales import gravity_time, stop_time

GAP = 60.0
"""Longest time between two grains while the bed flows, in sqrt(d*/g)."""
MOMENT = 30.0
"""Time over which the bed is averaged about an instant, in sqrt(d*/g)."""
INTERVAL = 1.5
"""Time between two velocities whose difference gives an acceleration, in sqrt(d*/g)."""
LAYER = 1.0
"""Height of the layer above an orifice over which fields are averaged, in d*."""
KEYS = ("gap", "moment", "interval", "layer")
"""What a window may state, in SI units; None, or no such attribute: the multiples above."""


def gap(scene: Scene, window: Window | None = None) -> float:
    """Time [s] without a grain beyond which it is left out of the flow rate; infinite without gravity. Of a scene with
    `restart`, unless it is stated, that after which the flow counts as stopped."""
    return _value(window, "gap") or (GAP * gravity_time(scene) if scene.restart is None else stop_time(scene))


def moment(scene: Scene, window: Window | None = None) -> float:
    """Time [s] over which the bed is averaged about an instant, and at most between two frames of its contacts;
    infinite without gravity."""
    return _value(window, "moment") or MOMENT * gravity_time(scene)


def interval(scene: Scene, window: Window | None = None) -> float:
    """Time [s] between two velocities whose difference gives an acceleration; infinite without gravity."""
    return _value(window, "interval") or INTERVAL * gravity_time(scene)


def layer(scene: Scene, window: Window | None = None) -> float:
    """Height [m] of the layer above an orifice over which fields are averaged."""
    return _value(window, "layer") or LAYER * scene.grains.equivalent_diameter


def in_text(window: Window) -> str:
    """What a window states of these, such as `gap=1.0 layer=0.01`, and `start=auto`; empty for nothing. It tells
    evaluations apart."""
    values = ((key, _value(window, key)) for key in KEYS)
    start = ["start=auto"] if after_start_up(window) else []
    return " ".join([*start, *(f"{key}={value!r}" for key, value in values if value is not None)])


def _value(window: Window | None, key: str) -> float | None:
    value = getattr(window, key, None)
    return value if value is not None and math.isfinite(value) else None
