"""Means of fields above an orifice (Pongo et al. 2022, Fig. 7): <X> = int X phi dV / int phi dV."""

from collections.abc import Mapping

import numpy as np

from labbook.fields.fields import Fields, nematic_order
from labbook.fields.grids import Layer, Ring


def orifice_means(
    fields: Fields, width: float, height: float, *, centre: float = 0.0, bottom: float = 0.0
) -> Mapping[str, float]:
    """Means, weighted by the packing fraction, over the points above an orifice of diameter or width `width` [m].

    The volume is a cylinder about the axis on a Ring, a box about x = `centre` on a Layer, `height` [m] high from
    `bottom` [m]. Gives `packing_fraction` (its mean over the volume), `v_z` [m/s], `kinetic_pressure` [Pa] and, of
    rods, `O_zz`, `O_rr`, `O_tt` (on a Layer `O_xx`, `O_yy`) and `S`, the largest eigenvalue of the averaged tensor.
    Raises ValueError if no point of the grid lies there, or on another grid.
    """
    within, weight = _above(fields, width, height, centre, bottom)
    numbers = {
        "packing_fraction": float(weight.sum() / fields.grid.volumes[within].sum()),
        "v_z": _mean(fields.velocity[2], within, weight),
        "kinetic_pressure": _mean(fields.kinetic_pressure, within, weight),
    }
    if fields.axes is not None:
        tensor = _mean(fields.orientation, within, weight)
        names = [f"O_{c}{c}" for c in fields.grid.components]
        numbers |= {name: tensor[k, k] for k, name in enumerate(names)}
        numbers["S"] = nematic_order(tensor)
    return {name: float(value) for name, value in numbers.items()}


def orifice_mean(fields: Fields, of: np.ndarray, width: float, height: float, *, bottom: float = 0.0) -> np.ndarray:
    """Mean of another field `of`, scalars or tensors [..., grid], over the same points and with the same weight, about
    x = 0 on a Layer."""
    return _mean(of, *_above(fields, width, height, 0.0, bottom))


def _mean(of: np.ndarray, within: np.ndarray, weight: np.ndarray) -> np.ndarray:
    return np.where(weight > 0, of[..., within], 0.0) @ weight / weight.sum()


def _above(fields: Fields, width: float, height: float, centre: float, bottom: float) -> tuple[np.ndarray, np.ndarray]:
    """Points above the orifice, and their weights: volumes times packing fractions."""
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
    weight = grid.volumes[within] * fields.packing_fraction[within]
    if not weight.sum() > 0:
        raise ValueError("no grain is above the orifice")
    return within, weight
