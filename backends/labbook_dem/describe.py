"""What a scene and a time step come to, for the catalogue: the restitution that a time step gives back."""

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
    """Restitution asked for and realised by this step (head-on at sqrt(g d), ten phases: mean and spread), damping."""
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
    """Restitution that a time step gives back: head-on collisions at ten positions of the touch within a step.

    None is at a whole step, where rounding would decide whether the grains touch yet.

    normal: a law's `normal` in plain Python. c: its coefficients. rs, ms: effective radius [m] and mass [kg]. speed
    [m/s] of approach. Replicates have the same collisions, so that the array is remembered, and cannot be written to.
    """
    e = np.array([_collide(normal, c, rs, ms, dt, speed, (phase + 0.5) / 10) for phase in range(10)])
    e.flags.writeable = False
    return e


_STUCK = 1e-6
"""Part of the speed of approach below which grains that part are taken to stick, if they are still held back: where a
force may pull, damping can be so strong that they never part."""


def _collide(normal, c, rs, ms, dt, speed, phase) -> float:
    overlap, v, a = -phase * speed * dt, -speed, 0.0  # v: rate of change of the gap, half a step before
    touched = False
    while True:
        force = normal(c, rs, ms, overlap, predict(v, a, dt)) if overlap > 0 else 0.0
        touched = touched or overlap > 0
        a = force / ms
        v = kick(v, a, dt)
        if touched and not overlap > 0:  # or is no number, where the step is far too long
            return v / speed
        if a < 0 <= v < _STUCK * speed:
            return 0.0
        overlap = drift(overlap, -v, dt)
