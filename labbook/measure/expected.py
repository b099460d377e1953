"""Forecasts of an outflow before any measurement, for plans only."""

import math

from labbook.backend.numerics import Numerics
from labbook.scene import Scene
from labbook.scene.timescales import gravity_time

FLOW = (0.58, 1.5)
"""C (normalised by the density of the grains) and k of W = C rho sqrt(g) (D - k d)^{3/2} Z (Fan et al.
2023)."""


def mass_flow(scene: Scene) -> float:
    """Expected mass flow rate [kg/s] through a slot or a round outlet, by Beverloo's law; 0 for other outlets."""
    silo, (c, k) = scene.container, FLOW
    if silo.outlet_form is None:
        return 0.0
    free = max(0.0, silo.outlets[0].width - k * scene.grains.equivalent_diameter)
    area = free**1.5 * silo.front_to_back if silo.outlet_form == "slot" else free**2.5
    return c * scene.grains.mean_density * math.sqrt(scene.gravity) * area


def window_time(scene: Scene) -> float:
    """Expected duration [s] of a window of usual width, 0.45 of the mass; infinite without a forecast."""
    flow = mass_flow(scene)
    return 0.45 * scene.grains.count * scene.grains.mass / flow if flow > 0 else math.inf


def rounded(time: float, scene: Scene, digits: int) -> float:
    """Round a `time` [s] to some digits in units of sqrt(d*/g).

    Similar scenes are then sampled on the same beats, and can share an ensemble.
    """
    scale = gravity_time(scene)
    return float(f"{time / scale:.{digits}g}") * scale


def beats_of(time: float, numerics: Numerics) -> int:
    """Number of whole beats in `time` [s], at least one."""
    return max(1, round(time / numerics.beat))
