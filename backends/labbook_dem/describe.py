"""Restitution that a time step realises, for the catalogue."""

import math
from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.scene import Scene
from labbook_dem.coefficients import C_N
from labbook_dem.laws import LAWS
from labbook_dem.motion import drift, kick, predict


def describe(scene: Scene, numerics: Numerics) -> Mapping[str, float]:
    """Requested and realised restitution (head-on at sqrt(g d), ten phases of the step: mean and spread), and
    damping."""
    law, grains = LAWS[scene.contact.law], scene.grains
    c = law.coefficients(scene.law_between(0, 0), scene.surface_of_grains, numerics.stiffness_scale)
    speed = math.sqrt(scene.gravity * grains.diameter) or 1.0
    e = realised(law.normal, tuple(c), grains.radius / 2, grains.mass / 2, numerics.dt, speed)
    return {
        "restitution_asked": scene.contact.restitution,
        "restitution_realised": float(e.mean()),
        "restitution_spread": float(e.std()),
        "damping_coefficient": c[C_N],
    }


@lru_cache(maxsize=256)
def realised(normal, c, rs: float, ms: float, dt: float, speed: float) -> np.ndarray:
    """Restitution that a time step realises: head-on collisions with the first touch at ten positions within a step.

    None is at a whole step, where rounding would decide if the grains touch yet. The array is cached, since replicates
    have the same collisions, and read-only.

    Args:
        normal: a law's `normal` in plain Python.
        c: its coefficients.
        rs: effective radius [m].
        ms: effective mass [kg].
        dt: time step [s].
        speed: speed of approach [m/s].

    Returns:
        Restitutions, shape [10].
    """
    e = np.array([_collide(normal, c, rs, ms, dt, speed, (phase + 0.5) / 10) for phase in range(10)])
    e.flags.writeable = False
    return e


_STUCK = 1e-6
"""Part of the speed of approach below which separating grains count as stuck while a force still holds them back:
with a force that may pull, strong damping can keep them from ever separating."""


def _collide(normal, c, rs, ms, dt, speed, phase) -> float:
    overlap, v, a = -phase * speed * dt, -speed, 0.0  # v: rate of change of the gap, half a step before
    touched = False
    while True:
        force = normal(c, rs, ms, overlap, predict(v, a, dt)) if overlap > 0 else 0.0
        touched = touched or overlap > 0
        a = force / ms
        v = kick(v, a, dt)
        if touched and not overlap > 0:  # also NaN, from a step that is far too long
            return v / speed
        if a < 0 <= v < _STUCK * speed:
            return 0.0
        overlap = drift(overlap, -v, dt)
