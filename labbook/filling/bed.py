"""State of a bed: rest although single grains go on rolling, and present or expected height."""

import math
from collections.abc import Callable

import numpy as np

from labbook.scene import ContactLaw, Grains, Scene
from labbook.scene.bodies import Bodies
from labbook.scene.packing import Packing

PACKED = 0.55
"""Packing fraction assumed for a bed that does not exist yet."""


def rolls_without_end(grains: Grains, contact: ContactLaw) -> bool:
    """True if grains may roll without end: spheres without rolling friction; rods and clumps, whatever theirs is."""
    return grains.oriented or contact.rolling_friction == 0


def fastest_points(grains: Grains, packing: Packing) -> np.ndarray:
    """Upper bound of the speed of points of each grain [m/s], shape [n]: |v| + |omega| times half its length."""
    return np.linalg.norm(packing.v, axis=1) + grains.reach * np.linalg.norm(packing.omega, axis=1)


def at_rest(scene: Scene, packing: Packing, below: float, moving: float) -> bool:
    """Decide if a bed is at rest, but for a few grains.

    Args:
        scene: Scene of the bed.
        packing: The bed.
        below: Kinetic energy of a grain [m g d] below which it counts as still.
        moving: Fraction of the grains that may move; at least one grain, and at most all but one.
    """
    still = fastest_points(scene.grains, packing) < math.sqrt(2 * below * scene.gravity * scene.grains.diameter)
    allowed = min(max(1, int(moving * len(still))), len(still) - 1)
    return len(still) - int(still.sum()) <= allowed


def outside_container(closed: Scene, packing: Packing) -> np.ndarray:
    """Mark the grains of a packing outside the container, shape [n].

    They lie behind a wall, below the plane of the outlet, or below every wall that could carry them. `closed`: the
    scene in which the packing was made.
    """
    container = closed.container
    lowest = min((wall.shape.ground for wall in container.walls()), default=math.inf)
    floors = [-math.inf if lowest == math.inf else lowest]
    if container.outlet_plane is not None:
        floors.append(container.outlet_plane)
    return ~container.inside(packing.x) | (packing.x[:, 2] < max(floors))


def parts_of_mass(grains: Grains, packing: Packing) -> np.ndarray:
    """Mass of each grain over the mass of all, by id."""
    mass = Bodies.of(grains, packing).mass
    return mass[packing.rows(np.arange(len(mass)))] / mass.sum()


def bed_height(grains: Grains, packing: Packing, floor: float) -> float:
    """Height [m] of a settled bed above z = `floor`, taken as a column: twice the height of its centre of mass."""
    z = packing.x[:, 2]
    middle = parts_of_mass(grains, packing)[packing.ids] @ z if grains.varied else np.mean(z)
    return 2 * float(middle - floor)


def expected_bed_height(scene: Scene) -> float | None:
    """Expected height [m] of a level bed above the outlet (or the bottom of a box), at a packing fraction of PACKED.

    None if the container does not define its volume.
    """
    if scene.container.volume_below(0.0) is None:
        return None
    return _level(
        scene.container.volume_below, scene.grains.count * scene.grains.volume / PACKED, scene.grains.diameter
    )


def _level(below: Callable[[float], float | None], volume: float, high: float) -> float | None:
    """Find the height [m] below which a container has a volume.

    By the regula falsi with the Illinois modification: above an inclined bottom, where most beds end, the first chord
    is exact.

    Args:
        below: Volume below a height [m^3]; None if the container does not define it.
        volume: The volume [m^3].
        high: First trial height [m].

    Returns:
        The height; None if `below` does not define it.
    """
    low, low_residual = 0.0, -volume
    while (contained := below(high)) is not None and contained < volume:
        low, low_residual, high = high, contained - volume, 2 * high
    if contained is None:
        return None
    high_residual, level, before = contained - volume, high, 0.0
    for _ in range(100):
        level = high - high_residual * (high - low) / (high_residual - low_residual)
        off = (below(level) or 0.0) - volume
        if abs(off) <= 1e-14 * volume:
            break
        if off > 0:
            # Illinois: halve the residual of an end that stays twice, or convergence would be linear
            high, high_residual, low_residual = level, off, low_residual / 2 if before > 0 else low_residual
        else:
            low, low_residual, high_residual = level, off, high_residual / 2 if before < 0 else high_residual
        before = off
    return level


def discharged_at(scene: Scene, height: float) -> float | None:
    """Discharged fraction at which a level bed has fallen to a height [m] above the outlet, at the fraction PACKED.

    Negative if it never was as high; None if the container does not define its volume.
    """
    below = scene.container.volume_below(height)
    return None if below is None else 1 - below * PACKED / (scene.grains.count * scene.grains.volume)
