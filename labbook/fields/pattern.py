"""Flow pattern: stagnant zone of a flowing bed."""

from dataclasses import dataclass

import numpy as np

from labbook.fields.fields import Fields

SLOW = 0.1
"""A point is stagnant where the mean velocity is below this part of the speed at which the whole section would sink."""
_BED = 0.2
"""Part of the median density below which a point is above the surface. It is low since at a wall, from which centres
keep a radius away, the kernel leaves a sixth to a quarter of the density inside, and above an outlet grains are few."""


@dataclass(frozen=True, eq=False)
class Pattern:
    """Stagnant zone of a mean downward flow.

    Attributes:
        stagnant: True at points of the grid where grains stand still.
        bed: True at points of the grid inside the bed.
        fraction: Stagnant part of the bed's mass.
        sinking: Speed of plug flow at each height, downward momentum over mass of the section [m/s], shape [nz].
    """

    stagnant: np.ndarray
    bed: np.ndarray
    fraction: float
    sinking: np.ndarray


def pattern_of(fields: Fields, bottom: float = 0.0, top: float = np.inf) -> Pattern:
    """The pattern of the bed between the heights `bottom` and `top` [m].

    A point is stagnant where |V| < 0.1 times the speed at which the section at its height would sink as a whole. That
    speed is W over the section's mass per length, so that the criterion asks how far a point lags behind plug flow.
    Raises ValueError if there is no bed.
    """
    z_axis = fields.grid.axes.index("z")
    z = fields.grid.points[z_axis]
    shape = [1] * len(fields.grid.axes)
    shape[z_axis] = len(z)
    height = np.broadcast_to(z.reshape(shape), fields.grid.shape)
    filled = fields.density > 0
    if not filled.any():
        raise ValueError("there is no bed on the grid")
    bed = filled & (fields.density > _BED * np.median(fields.density[filled])) & (height >= bottom) & (height <= top)
    if not bed.any():
        raise ValueError(f"there is no bed between z = {bottom:g} and {top:g} m")
    horizontal = tuple(k for k in range(len(shape)) if k != z_axis)
    volumes = fields.grid.volumes
    mass = np.sum(fields.density * volumes * bed, axis=horizontal)
    down = -np.sum(fields.momentum[2] * volumes * bed, axis=horizontal)
    sinking = np.divide(down, mass, out=np.zeros(len(z)), where=mass > 0)
    speed = np.linalg.norm(np.where(bed, fields.velocity, 0.0), axis=0)
    stagnant = bed & (speed < SLOW * np.broadcast_to(sinking.reshape(shape), bed.shape))
    weight = fields.density * volumes
    return Pattern(stagnant, bed, float(weight[stagnant].sum() / weight[bed].sum()), sinking)
