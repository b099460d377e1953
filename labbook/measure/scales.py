"""Times and lengths by which an outflow is measured.

They are stated under `window` of a study, or multiples of the scales of the grains, d* (equivalent diameter) and
sqrt(d*/g). So scenes that are similar give similar numbers.

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
"""Optional attributes of a window [SI]; without a value the multiples above hold."""


def gap(scene: Scene, window: Window | None = None) -> float:
    """Longest time [s] between two grains that counts as flow; longer gaps are left out of the flow rate.

    It is infinite without gravity. The default of a scene with `restart` is the time after which the flow counts as
    stopped.
    """
    return _value(window, "gap") or (GAP * gravity_time(scene) if scene.restart is None else stop_time(scene))


def moment(scene: Scene, window: Window | None = None) -> float:
    """Time [s] over which the bed is averaged about an instant; infinite without gravity.

    It is also the longest time between two frames of contacts.
    """
    return _value(window, "moment") or MOMENT * gravity_time(scene)


def interval(scene: Scene, window: Window | None = None) -> float:
    """Time [s] between two velocities whose difference gives an acceleration; infinite without gravity."""
    return _value(window, "interval") or INTERVAL * gravity_time(scene)


def layer(scene: Scene, window: Window | None = None) -> float:
    """Height [m] of the layer above an orifice over which fields are averaged."""
    return _value(window, "layer") or LAYER * scene.grains.equivalent_diameter


def in_text(window: Window) -> str:
    """Write the stated values of a window, such as `start=auto gap=1.0 layer=0.01`; empty without any.

    Stored evaluations are distinguished by it.
    """
    values = ((key, _value(window, key)) for key in KEYS)
    start = ["start=auto"] if after_start_up(window) else []
    return " ".join([*start, *(f"{key}={value!r}" for key, value in values if value is not None)])


def _value(window: Window | None, key: str) -> float | None:
    value = getattr(window, key, None)
    return value if value is not None and math.isfinite(value) else None
