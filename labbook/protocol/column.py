"""How high a bed stands, by its centre of mass."""

import numpy as np

from labbook.protocol.bodies import Bodies
from labbook.protocol.packing import Packing
from labbook.scene import Grains


def parts_of_mass(grains: Grains, packing: Packing) -> np.ndarray:
    """Of the mass of all grains, the part that each is, by id."""
    mass = Bodies.of(grains, packing).mass
    return mass[packing.rows(np.arange(len(mass)))] / mass.sum()


def bed_height(grains: Grains, packing: Packing, floor: float) -> float:
    """Height [m] of a settled bed above z = `floor`: of a column, twice that of its centre of mass."""
    z = packing.x[:, 2]
    middle = parts_of_mass(grains, packing)[packing.ids] @ z if grains.varied else np.mean(z)
    return 2 * float(middle - floor)
