"""Hexatic order of a layer of grains."""

import numpy as np


def hexatic(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Compute the hexatic order psi_6 of every grain of a layer (Nelson & Halperin, Phys. Rev. B 19 (1979) 2457).

    psi_6 is the mean of e^{6 i theta} over the Delaunay neighbours of a grain, theta being the direction of the
    neighbour in the x-z plane. |psi_6| is 1 in a perfect hexagonal layer and about 0.37 for points at random. Grains at
    the border of the layer have neighbours that are far away: leave them out.

    Args:
        x: Abscissas of the grains [m], shape [n].
        z: Ordinates [m], shape [n].

    Returns:
        psi_6, complex, shape [n]; NaN for a grain without neighbours, and for all of fewer than 4 grains or of grains
        on a line.
    """
    from scipy.spatial import Delaunay, QhullError

    points = np.column_stack([x, z]).astype(float)
    missing = np.full(len(points), np.nan + 0j)
    if len(points) < 4:
        return missing
    try:
        starts, neighbours = Delaunay(points).vertex_neighbor_vertices
    except QhullError:
        return missing
    count = np.diff(starts)
    owner = np.repeat(np.arange(len(points)), count)
    along = points[neighbours] - points[owner]
    wave = np.exp(6j * np.arctan2(along[:, 1], along[:, 0]))
    total = np.zeros(len(points), complex)
    np.add.at(total, owner, wave)
    return np.divide(total, count, out=missing, where=count > 0)
