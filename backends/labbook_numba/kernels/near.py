"""Which spheres are near one another, and near walls."""

import numpy as np
from labbook_dem.words import wide

from labbook_numba.kernels.cells import cells_of
from labbook_numba.kernels.features import GRAINS, PAD, X, kernel
from labbook_numba.kernels.single import load
from labbook_numba.kernels.surfaces import wall_distance
from labbook_numba.state import Params, State


@kernel
def near_pairs(st: State, p: Params, pair_i, pair_j):
    """Fill the list of pairs i < j closer than a diameter and a skin, i then j ascending; its length."""
    n = st.count[GRAINS]
    reach = wide(2.0) * p.radius + p.skin
    reach2 = reach * reach
    cell, size = cells_of(st, reach)
    head = np.full((size[0], size[1], size[2]), -1, np.int32)
    following = np.empty(n, np.int32)
    for i in range(n):
        a, b, c = cell[i, 0], cell[i, 1], cell[i, 2]
        following[i] = head[a, b, c]
        head[a, b, c] = i
    found = 0
    for i in range(n):
        start = found
        for a in range(max(cell[i, 0] - 1, 0), min(cell[i, 0] + 2, size[0])):
            for b in range(max(cell[i, 1] - 1, 0), min(cell[i, 1] + 2, size[1])):
                for c in range(max(cell[i, 2] - 1, 0), min(cell[i, 2] + 2, size[2])):
                    j = head[a, b, c]
                    while j > i:  # a cell's grains come in falling order
                        dx = st.grains[i, X + 0] - st.grains[j, X + 0]
                        dy = st.grains[i, X + 1] - st.grains[j, X + 1]
                        dz = st.grains[i, X + 2] - st.grains[j, X + 2]
                        if dx * dx + dy * dy + dz * dz < reach2:
                            if found < len(pair_j) - PAD:
                                k = found
                                while k > start and pair_j[k - 1] > j:
                                    pair_j[k] = pair_j[k - 1]
                                    k -= 1
                                pair_j[k] = j
                                pair_i[found] = i
                            found += 1
                        j = following[j]
    return found


@kernel
def near_walls(st: State, p: Params, first, grain):
    """Fill the list of grains that could touch a wall before the next rebuild, wall by wall; its length."""
    found = 0
    first[0] = 0
    reach = p.radius + wide(0.5) * p.skin
    for w in range(len(p.wall_kind)):
        for i in range(st.count[GRAINS]):
            distance, _ = wall_distance(p.wall_shape, p.wall_kind, w, load(st.grains, i, X))
            if distance < reach:
                if found < len(grain) - PAD:
                    grain[found] = i
                found += 1
        first[w + 1] = found
    return found
