"""Totals of a member: energies, momenta, and the work that contacts have done."""

import math

import numpy as np

from labbook.backend import Status
from labbook.scene import Scene

Weight = float | np.ndarray
"""A mass [kg] or moment of inertia [kg m^2]: of every grain, or of each, shape [n]."""


def weighted(weight: Weight, values: np.ndarray) -> np.ndarray:
    """Sum over grains of weight times `values`, shape [n, ...]; shape [...]."""
    return weight @ values if isinstance(weight, np.ndarray) else weight * values.sum(axis=0)


def kinetic(mass: Weight, inertia: Weight, v: np.ndarray, w: np.ndarray) -> float:
    """Kinetic energy [J] of velocities v [m/s] and spins w [rad/s]."""
    return _half(mass, v) + _half(inertia, w)


def _half(weight: Weight, v: np.ndarray) -> float:
    if isinstance(weight, np.ndarray):
        return 0.5 * float(weight @ np.sum(v**2, axis=1))
    return 0.5 * weight * float(np.sum(v**2))


def energy_scale(scene: Scene) -> float:
    """m g d [J], m the mean mass, by which kinetic energies per grain are counted; m d^2/s^2 without gravity."""
    d = scene.grains.diameter
    return scene.grains.mass * (scene.gravity * d or d**2)


def status(scene: Scene, step: int, time: float, grains: int, energy: float) -> Status:
    """Where a member stands, given the kinetic energy [J] of its grains."""
    return Status(step, time, grains, energy / max(grains, 1) / energy_scale(scene))


def totals(
    mass: Weight, inertia: Weight, gravity: float, x: np.ndarray, v: np.ndarray, w: np.ndarray, v_half: np.ndarray,
    w_half: np.ndarray, since_half: float, work: float,
) -> dict[str, float]:  # fmt: skip
    """Energies [J], mass [kg], momentum [kg m/s] and angular momentum [kg m^2/s] about the origin.

    x, v, w at the whole step; v_half, w_half: half a step before, `since_half` [s] ago (0 at the start). work: that of
    all kicks so far; the work of the last half kick is its gain in kinetic energy, less what gravity did.
    """
    energy, weight = kinetic(mass, inertia, v, w), mass * gravity
    gained = energy - kinetic(mass, inertia, v_half, w_half)
    by_gravity = -0.5 * float(weighted(weight * since_half, v[:, 2] + v_half[:, 2]))
    momentum = weighted(mass, v)
    angular = weighted(mass, np.cross(x, v)) + weighted(inertia, w)
    return {
        "kinetic": energy,
        "potential": math.fsum(weight * x[:, 2]) if isinstance(weight, np.ndarray) else weight * math.fsum(x[:, 2]),
        "contact_work": work + gained - by_gravity,
        "mass": math.fsum(mass) if isinstance(mass, np.ndarray) else mass * len(x),
        **dict(zip(("px", "py", "pz"), momentum.tolist(), strict=True)),
        **dict(zip(("lx", "ly", "lz"), angular.tolist(), strict=True)),
    }
