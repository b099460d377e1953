"""Which spheres are near one another, and near walls."""

from labbook_dem.words import VARIED, wide

from labbook_numba.kernels.bodies import radius_of
from labbook_numba.kernels.cells import fill_cells
from labbook_numba.kernels.features import GRAINS, PAD, X, kernel
from labbook_numba.kernels.single import load
from labbook_numba.kernels.surfaces import wall_distance
from labbook_numba.state import Params, State


@kernel
def near_pairs(st: State, p: Params, pair_i, pair_j, cell, head, following):
    """Fill the list of pairs i < j of grains closer than their radii and a skin, ascending; its length."""
    grains, body, n = st.grains, st.body, st.count[GRAINS]
    reach = wide(2.0) * p.radius + p.skin
    nx, ny, nz = fill_cells(grains, n, reach, cell, head, following)
    room = len(pair_j) - PAD
    found = 0
    for i in range(n):
        start = found
        x, y, z = grains[i, X + 0], grains[i, X + 1], grains[i, X + 2]
        for a in range(max(cell[i, 0] - 1, 0), min(cell[i, 0] + 2, nx)):
            for b in range(max(cell[i, 1] - 1, 0), min(cell[i, 1] + 2, ny)):
                for c in range(max(cell[i, 2] - 1, 0), min(cell[i, 2] + 2, nz)):
                    j = head[(a * ny + b) * nz + c]
                    while j > i:
                        dx, dy, dz = x - grains[j, X + 0], y - grains[j, X + 1], z - grains[j, X + 2]
                        far = body[i, 0] + body[j, 0] + p.skin if VARIED else reach
                        if dx * dx + dy * dy + dz * dz < far * far:
                            if found < room:
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
    """Fill the list of those grains that could touch a wall before the next rebuild, wall by wall; its length."""
    half_skin = wide(0.5) * p.skin
    found = 0
    first[0] = 0
    for w in range(len(p.wall_kind)):
        for i in range(st.count[GRAINS]):
            distance, _ = wall_distance(p.wall_shape, p.wall_kind, w, load(st.grains, i, X))
            if distance < radius_of(st.body, i, p.radius) + half_skin:
                if found < len(grain) - PAD:
                    grain[found] = i
                found += 1
        first[w + 1] = found
    return found
