"""Of a bed: when it is at rest although a grain goes on rolling, and how high it stands."""

import math

import numpy as np

from labbook.scene import Grains, Scene, Spherocylinders
from labbook.scene.bodies import Bodies
from labbook.scene.packing import Packing

ROLLING = 0.01
"""Fraction of grains that may go on moving where nothing brakes rolling."""


def unbraked(scene: Scene) -> bool:
    """Whether a grain of the scene may roll for ever: rods, and spheres without rolling friction."""
    return isinstance(scene.grains, Spherocylinders) or scene.contact.rolling_friction == 0


def fastest_points(grains: Grains, packing: Packing) -> np.ndarray:
    """Speed [m/s] that no point of a grain exceeds, shape [n]: |v| + |omega| times half the grain's length."""
    reach = grains.radius + grains.half_length
    return np.linalg.norm(packing.v, axis=1) + reach * np.linalg.norm(packing.omega, axis=1)


def at_rest(scene: Scene, packing: Packing, below: float, moving: float) -> bool:
    """Whether all but the fraction `moving` of the grains (one grain at least, but never the only one) are so slow that
    the kinetic energy of each is less than `below` [m g d]."""
    still = fastest_points(scene.grains, packing) < math.sqrt(2 * below * scene.gravity * scene.grains.diameter)
    allowed = min(max(1, int(moving * len(still))), len(still) - 1)
    return len(still) - int(still.sum()) <= allowed


def parts_of_mass(grains: Grains, packing: Packing) -> np.ndarray:
    """Of the mass of all grains, the part that each is, by id."""
    mass = Bodies.of(grains, packing).mass
    return mass[packing.rows(np.arange(len(mass)))] / mass.sum()


def bed_height(grains: Grains, packing: Packing, floor: float) -> float:
    """Height [m] of a settled bed above z = `floor`: of a column, twice that of its centre of mass."""
    z = packing.x[:, 2]
    middle = parts_of_mass(grains, packing)[packing.ids] @ z if grains.varied else np.mean(z)
    return 2 * float(middle - floor)
