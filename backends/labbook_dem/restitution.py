"""Restitution that a time step gives back, of a law and its damping."""

import numpy as np

from labbook_dem.motion import drift, kick, predict


def realised(normal, c, rs: float, ms: float, dt: float, speed: float, phases: int = 10) -> np.ndarray:
    """Restitution that a time step gives back: head-on collisions at `phases` positions of the touch within a step.

    None is at a whole step, where rounding would decide whether the grains touch yet.

    normal: a law's `normal` in plain Python. rs, ms: effective radius [m] and mass [kg]. speed [m/s] of approach.
    """
    return np.array([_collide(normal, c, rs, ms, dt, speed, (phase + 0.5) / phases) for phase in range(phases)])


def _collide(normal, c, rs, ms, dt, speed, phase) -> float:
    overlap, v, a = -phase * speed * dt, -speed, 0.0  # v: rate of change of the gap, half a step before
    touched = False
    while True:
        force = normal(c, rs, ms, overlap, predict(v, a, dt)) if overlap > 0 else 0.0
        touched = touched or overlap > 0
        a = force / ms
        v = kick(v, a, dt)
        if touched and overlap <= 0:
            return v / speed
        overlap = drift(overlap, -v, dt)
