"""A grid of cells, in which neighbours are looked for."""

import numpy as np
from labbook_dem.words import func, wide

from labbook_numba.kernels.features import CELLS, SPARE_CELLS, X, int64, kernel


@kernel
def extent(grains, n, column):
    """Lowest coordinate [m] of n grains in a column, and how far the highest is from it."""
    low = grains[0, column]
    high = low
    for i in range(1, n):
        low = min(low, grains[i, column])
        high = max(high, grains[i, column])
    return low, high - low


@func
def cells(length, size):
    """How many cells of a size a length reaches into."""
    return np.floor(length / size) + wide(1.0)


@kernel
def cells_of(grains, n, size, cell):
    """Set the cell of each of n grains, in a grid no finer than `size` [m]; the grid's three sizes."""
    x, dx = extent(grains, n, X + 0)
    y, dy = extent(grains, n, X + 1)
    z, dz = extent(grains, n, X + 2)
    while cells(dx, size) * cells(dy, size) * cells(dz, size) > CELLS * n + SPARE_CELLS:
        size *= wide(1.26)  # doubles the volume of a cell
    nx, ny, nz = int64(cells(dx, size)), int64(cells(dy, size)), int64(cells(dz, size))
    for i in range(n):
        # no more than the last, however divisions are rounded
        cell[i, 0] = min(int64((grains[i, X + 0] - x) / size), nx - 1)
        cell[i, 1] = min(int64((grains[i, X + 1] - y) / size), ny - 1)
        cell[i, 2] = min(int64((grains[i, X + 2] - z) / size), nz - 1)
    return nx, ny, nz


@kernel
def fill_cells(grains, n, size, cell, head, following):
    """Put n grains into a grid no finer than `size` [m]: each cell's come in falling order; the grid's three sizes."""
    nx, ny, nz = cells_of(grains, n, size, cell)
    for k in range(nx * ny * nz):
        head[k] = -1
    for i in range(n):
        at = (cell[i, 0] * ny + cell[i, 1]) * nz + cell[i, 2]
        following[i] = head[at]
        head[at] = i
    return nx, ny, nz
