"""A grid of cells, in which neighbours are looked for."""

import numpy as np
from labbook_dem.words import wide

from labbook_numba.kernels.features import GRAINS, X, kernel
from labbook_numba.state import State


@kernel
def cells_of(st: State, reach):
    """Cell of each grain in a grid no finer than `reach` [m], and the grid's three sizes; at most 4 cells a grain."""
    n = st.count[GRAINS]
    low = np.empty(3)
    span = np.empty(3)
    for c in range(3):
        a = st.grains[0, X + c]
        b = a
        for i in range(1, n):
            a = min(a, st.grains[i, X + c])
            b = max(b, st.grains[i, X + c])
        low[c] = a
        span[c] = b - a
    size = np.ones(3, np.int64)
    while True:
        cells = wide(1.0)
        for c in range(3):
            cells *= np.floor(span[c] / reach) + wide(1.0)
        if cells <= wide(4.0) * n + wide(64.0):
            break
        reach *= wide(1.26)  # doubles the volume of a cell
    for c in range(3):
        size[c] = np.int64(span[c] / reach) + 1
    cell = np.empty((n, 3), np.int32)
    for i in range(n):
        for c in range(3):
            cell[i, c] = min(np.int64((st.grains[i, X + c] - low[c]) / reach), size[c] - 1)
    return cell, size
