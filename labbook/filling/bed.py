"""Of a bed: when it is at rest although a grain goes on rolling, and how high it stands or will stand."""

import math
from collections.abc import Callable

import numpy as np

from labbook.scene import ContactLaw, Grains, Scene, Spherocylinders
from labbook.scene.bodies import Bodies
from labbook.scene.packing import Packing

PACKED = 0.55
"""Packing fraction that is assumed of a bed before there is one."""


def unbraked(grains: Grains, contact: ContactLaw) -> bool:
    """Whether grains are taken to roll for ever: spheres without rolling friction, and rods, whatever theirs is."""
    return isinstance(grains, Spherocylinders) or contact.rolling_friction == 0


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


def astray(closed: Scene, packing: Packing) -> np.ndarray:
    """Which grains of a packing, made in the scene `closed`, are outside the container, shape [n]: behind a wall, below
    the plane of its outlet, or below all that could hold them up."""
    container = closed.container
    lowest = min((wall.shape.ground for wall in container.walls()), default=math.inf)
    floors = [-math.inf if lowest == math.inf else lowest]
    if container.outlet_plane is not None:
        floors.append(container.outlet_plane)
    return ~container.inside(packing.x) | (packing.x[:, 2] < max(floors))


def parts_of_mass(grains: Grains, packing: Packing) -> np.ndarray:
    """Of the mass of all grains, the part that each is, by id."""
    mass = Bodies.of(grains, packing).mass
    return mass[packing.rows(np.arange(len(mass)))] / mass.sum()


def bed_height(grains: Grains, packing: Packing, floor: float) -> float:
    """Height [m] of a settled bed above z = `floor`: of a column, twice that of its centre of mass."""
    z = packing.x[:, 2]
    middle = parts_of_mass(grains, packing)[packing.ids] @ z if grains.varied else np.mean(z)
    return 2 * float(middle - floor)


def bed_height_ahead(scene: Scene) -> float | None:
    """Height [m] above the outlet (or the bottom of a box) that a level bed will have at a packing fraction of PACKED;
    None where the container does not tell."""
    if scene.container.volume_below(0.0) is None:
        return None
    return _level(
        scene.container.volume_below, scene.grains.count * scene.grains.volume / PACKED, scene.grains.diameter
    )


def _level(below: Callable[[float], float | None], volume: float, high: float) -> float | None:
    """Height [m] below which there is this volume [m^3], as `below` has it; `high` [m]: a height to begin with. None
    where `below` does not tell.

    By chords (the Illinois method): above an inclined bottom, where most beds end, the first is exact.
    """
    low, under = 0.0, -volume
    while (held := below(high)) is not None and held < volume:
        low, under, high = high, held - volume, 2 * high
    if held is None:
        return None
    over, level, before = held - volume, high, 0.0
    for _ in range(100):
        level = high - over * (high - low) / (over - under)
        off = (below(level) or 0.0) - volume
        if abs(off) <= 1e-14 * volume:
            break
        if off > 0:
            high, over, under = level, off, under / 2 if before > 0 else under
        else:
            low, under, over = level, off, over / 2 if before < 0 else over
        before = off
    return level


def discharged_at(scene: Scene, height: float) -> float | None:
    """Discharged fraction at which a level bed has fallen to a height [m] above the outlet, at a packing fraction of
    PACKED; below 0 if it never was as high, None where the container does not tell."""
    below = scene.container.volume_below(height)
    return None if below is None else 1 - below * PACKED / (scene.grains.count * scene.grains.volume)
