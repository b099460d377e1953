"""Grid of cells for the search of neighbours."""

import numpy as np
from labbook_dem.words import PERIODIC, func, wide

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


@func
def cells_between(length, size):
    """Number of cells not thinner than a size [m] between periodic sides, which cells fill."""
    return max(np.floor(length / size), wide(1.0))


@func
def repeats(period):
    """True between periodic sides, whose distance [m] is then no placeholder."""
    return PERIODIC and period < wide(1e29)


@func
def cells_along_y(length, size, period):
    """Number of cells along y."""
    return cells_between(length, size) if repeats(period) else cells(length, size)


@func
def first_along_y(own, period):
    """First cell along y to look into for neighbours of a grain in cell `own`; `wrapped` turns it into one there is."""
    return own - 1 if repeats(period) else max(own - 1, 0)


@func
def end_along_y(own, cells_y, period):
    """End of the cells along y to look into: two or fewer cells are looked into once."""
    return own - 1 + min(cells_y, 3) if repeats(period) else min(own + 2, cells_y)


@func
def wrapped(along_y, cells_y, period):
    """Cell along y beyond a periodic side, as the one that it repeats."""
    return (along_y + cells_y) % cells_y if repeats(period) else along_y


@kernel
def cells_of(grains, n, size, cell, period):
    """Compute the cell of each of n grains, in a grid not finer than `size` [m]; return the three sizes of the grid."""
    x, dx = extent(grains, n, X + 0)
    y, dy = extent(grains, n, X + 1)
    z, dz = extent(grains, n, X + 2)
    if repeats(period):
        y, dy = wide(-0.5) * period, period
    while cells(dx, size) * cells_along_y(dy, size, period) * cells(dz, size) > CELLS * n + SPARE_CELLS:
        size *= wide(1.26)  # doubles the volume of a cell
    nx, ny, nz = int64(cells(dx, size)), int64(cells_along_y(dy, size, period)), int64(cells(dz, size))
    size_y = period / ny if repeats(period) else size
    for i in range(n):
        # at most the last cell, even if the division rounds up
        cell[i, 0] = min(int64((grains[i, X + 0] - x) / size), nx - 1)
        cell[i, 1] = min(int64((grains[i, X + 1] - y) / size_y), ny - 1)
        cell[i, 2] = min(int64((grains[i, X + 2] - z) / size), nz - 1)
    return nx, ny, nz


@kernel
def fill_cells(grains, n, size, cell, head, next_grain, period):
    """Sort n grains into a grid not finer than `size` [m]; return the three sizes of the grid.

    Each cell is a linked list (`head`, `next_grain`) of grains in descending order.
    """
    nx, ny, nz = cells_of(grains, n, size, cell, period)
    for k in range(nx * ny * nz):
        head[k] = -1
    for i in range(n):
        at = (cell[i, 0] * ny + cell[i, 1]) * nz + cell[i, 2]
        next_grain[i] = head[at]
        head[at] = i
    return nx, ny, nz
