"""Totals of a member: energies, momenta, and the work that contacts have done."""

import math

import numpy as np

from labbook.backend import Status
from labbook.scene import Grains, Scene
from labbook_dem.rotation import spins


def kinetic(grains: Grains, v: np.ndarray, m: np.ndarray, q: np.ndarray | None = None) -> float:
    """Kinetic energy [J] of velocities v [m/s] and reduced angular momenta m [rad/s] (of spheres: spins).

    q: orientations of rods (`labbook_dem.rotation`), whose rotational energy is I_t m.omega / 2.
    """
    omega = m if q is None else spins(grains, m, q)
    return 0.5 * grains.mass * float(np.sum(v**2)) + 0.5 * grains.inertia * float(np.sum(m * omega))


def energy_scale(scene: Scene) -> float:
    """m g d [J], by which kinetic energies per grain are counted; m d^2/s^2 without gravity."""
    d = scene.grains.diameter
    return scene.grains.mass * (scene.gravity * d or d**2)


def status(scene: Scene, step: int, time: float, grains: int, energy: float) -> Status:
    """Where a member stands, given the kinetic energy [J] of its grains."""
    return Status(step, time, grains, energy / max(grains, 1) / energy_scale(scene))


def totals(
    scene: Scene, x: np.ndarray, v: np.ndarray, m: np.ndarray, v_half: np.ndarray, m_half: np.ndarray,
    since_half: float, work: float, q: np.ndarray | None = None,
) -> dict[str, float]:  # fmt: skip
    """Energies [J], mass [kg], momentum [kg m/s] and angular momentum [kg m^2/s] about the origin.

    x, v, m, q at the whole step; v_half, m_half: half a step before, `since_half` [s] ago (0 at the start); m as in
    `kinetic`. work: that of all kicks so far; the work of the last half kick is its gain in kinetic energy, less what
    gravity did.
    """
    mass, inertia, gravity = scene.grains.mass, scene.grains.inertia, scene.gravity
    energy = kinetic(scene.grains, v, m, q)
    gained = energy - kinetic(scene.grains, v_half, m_half, q)  # m.a, and so the energy, stays while a rod drifts
    by_gravity = -mass * gravity * since_half * 0.5 * float(np.sum(v[:, 2] + v_half[:, 2]))
    momentum = mass * v.sum(axis=0)
    angular = mass * np.cross(x, v).sum(axis=0) + inertia * m.sum(axis=0)
    return {
        "kinetic": energy,
        "potential": mass * gravity * math.fsum(x[:, 2]),
        "contact_work": work + gained - by_gravity,
        "mass": mass * len(x),
        **dict(zip(("px", "py", "pz"), momentum.tolist(), strict=True)),
        **dict(zip(("lx", "ly", "lz"), angular.tolist(), strict=True)),
    }
