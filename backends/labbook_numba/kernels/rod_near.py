"""Which rods are near one another, and near walls."""

from labbook_dem.segments import closest
from labbook_dem.words import dot, wide

from labbook_numba.kernels.cells import fill_cells
from labbook_numba.kernels.features import GRAINS, PAD, WALL_PARTS, A, X, kernel
from labbook_numba.kernels.rod_walls import edges, wall_part
from labbook_numba.kernels.single import load
from labbook_numba.state import Params, State


@kernel
def near_pairs(st: State, p: Params, pair_i, pair_j, cell, head, following):
    """Fill the list of pairs i < j whose segments are closer than a diameter and a skin, ascending; its length."""
    grains, n = st.grains, st.count[GRAINS]
    reach = wide(2.0) * p.radius + p.skin
    far = reach + wide(2.0) * p.half  # centres further apart cannot be near
    nx, ny, nz = fill_cells(grains, n, far, cell, head, following)
    found = 0
    for i in range(n):
        start = found
        x = load(grains, i, X)
        axis = load(grains, i, A)
        for a in range(max(cell[i, 0] - 1, 0), min(cell[i, 0] + 2, nx)):
            for b in range(max(cell[i, 1] - 1, 0), min(cell[i, 1] + 2, ny)):
                for c in range(max(cell[i, 2] - 1, 0), min(cell[i, 2] + 2, nz)):
                    j = head[(a * ny + b) * nz + c]
                    while j > i:
                        branch = x - load(grains, j, X)
                        if dot(branch, branch) < far * far:
                            _, _, away = closest(branch, axis, load(grains, j, A), p.half)
                            if dot(away, away) < reach * reach:
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
    """Fill the list of rods that could touch a wall before the next rebuild, wall by wall; its length."""
    grains, n = st.grains, st.count[GRAINS]
    found = 0
    first[0] = 0
    reach = p.radius + wide(0.5) * p.skin
    for w in range(len(p.wall_kind)):
        for i in range(n):
            x = load(grains, i, X)
            a = load(grains, i, A)
            found_edges = edges(p.wall_shape, p.wall_kind, w, x, a, p.half, reach)
            near = False
            for part in range(WALL_PARTS):
                distance, _, _ = wall_part(p.wall_shape, p.wall_kind, w, x, a, p.half, reach, part, found_edges)
                near = near or distance < reach
            if near:
                if found < len(grain) - PAD:
                    grain[found] = i
                found += 1
        first[w + 1] = found
    return found
