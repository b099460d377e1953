"""Means of fields above an orifice (Pongo et al. 2022, Fig. 7): <X> = int X phi dV / int phi dV."""

from collections.abc import Mapping

import numpy as np

from labbook.fields.fields import Fields, nematic_order
from labbook.fields.grids import Layer, Ring

HEIGHT = 0.01
"""Height [m] of the volume above the orifice."""


def orifice_means(
    fields: Fields, width: float, *, centre: float = 0.0, bottom: float = 0.0, height: float = HEIGHT
) -> Mapping[str, float]:
    """Means, weighted by the packing fraction, over the points above an orifice of diameter or width `width` [m].

    The volume is a cylinder about the axis on a Ring, a box about x = `centre` on a Layer, `height` [m] high from
    `bottom`. Gives `packing_fraction` (its mean over the volume), `v_z` [m/s], `kinetic_pressure` [Pa] and, of rods,
    `O_zz`, `O_rr`, `O_tt` (on a Layer `O_xx`, `O_yy`) and `S`, the largest eigenvalue of the averaged tensor. Raises
    ValueError if no point of the grid lies there, or on another grid.
    """
    grid = fields.grid
    if isinstance(grid, Ring):
        r, z = grid.points
        within = (r[:, None] <= width / 2) & (z >= bottom) & (z <= bottom + height)
    elif isinstance(grid, Layer):
        z, x = grid.points
        within = (abs(x - centre) <= width / 2) & ((z >= bottom) & (z <= bottom + height))[:, None]
    else:
        raise ValueError("means above an orifice are taken on a ring or a layer")
    if not within.any():
        raise ValueError("no point of the grid lies above the orifice; use a finer grid")
    volume = grid.volumes[within]
    weight = volume * fields.packing_fraction[within]
    if not weight.sum() > 0:
        raise ValueError("no grain is above the orifice")

    def mean(field: np.ndarray) -> np.ndarray:
        found = field[..., within]
        return np.where(weight > 0, found, 0.0) @ weight / weight.sum()

    numbers = {
        "packing_fraction": float(weight.sum() / volume.sum()),
        "v_z": float(mean(fields.velocity[2])),
        "kinetic_pressure": float(mean(fields.kinetic_pressure)),
    }
    if fields.axes is not None:
        tensor = mean(fields.orientation)
        names = [f"O_{c}{c}" for c in grid.components]
        numbers |= {name: float(tensor[k, k]) for k, name in enumerate(names)}
        numbers["S"] = float(nematic_order(tensor))
    return numbers
