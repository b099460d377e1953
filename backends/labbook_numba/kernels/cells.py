"""Grid of cells for the search of neighbours."""

import numpy as np
from labbook_dem.words import func, wide

from labbook_numba.kernels.features import CELLS, SPARE_CELLS, X, int64, kernel


@kernel
def extent(grains, n, column):
    """Lowest coordinate [m] of n grains in a column, and distance of the highest from it."""
    low = grains[0, column]
    high = low
    for i in range(1, n):
        low = min(low, grains[i, column])
        high = max(high, grains[i, column])
    return low, high - low


@func
def cells(length, size):
    """Number of cells of a size [m] that a length reaches into."""
    return np.floor(length / size) + wide(1.0)


@kernel
def cells_of(grains, n, size, cell):
    """Compute the cell of each of n grains, in a grid not finer than `size` [m]; return the three sizes of the grid."""
    x, dx = extent(grains, n, X + 0)
    y, dy = extent(grains, n, X + 1)
    z, dz = extent(grains, n, X + 2)
    while cells(dx, size) * cells(dy, size) * cells(dz, size) > CELLS * n + SPARE_CELLS:
        size *= wide(1.26)  # doubles the volume of a cell
    nx, ny, nz = int64(cells(dx, size)), int64(cells(dy, size)), int64(cells(dz, size))
    for i in range(n):
        # at most the last cell, even if the division rounds up
        cell[i, 0] = min(int64((grains[i, X + 0] - x) / size), nx - 1)
        cell[i, 1] = min(int64((grains[i, X + 1] - y) / size), ny - 1)
        cell[i, 2] = min(int64((grains[i, X + 2] - z) / size), nz - 1)
    return nx, ny, nz


@kernel
def fill_cells(grains, n, size, cell, head, next_grain):
    """Sort n grains into a grid not finer than `size` [m]; return the three sizes of the grid.

    Each cell is a linked list (`head`, `next_grain`) of grains in descending order.
    """
    nx, ny, nz = cells_of(grains, n, size, cell)
    for k in range(nx * ny * nz):
        head[k] = -1
    for i in range(n):
        at = (cell[i, 0] * ny + cell[i, 1]) * nz + cell[i, 2]
        next_grain[i] = head[at]
        head[at] = i
    return nx, ny, nz
