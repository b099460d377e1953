"""Candidate lists of pairs and of grains near walls; the criteria are in `sphere_lists` and `rods`."""

from labbook_dem.words import wide

from labbook_numba.kernels.cells import end_along_y, fill_cells, first_along_y, wrapped
from labbook_numba.kernels.features import CLUMPS, GRAINS, MESH_NUMBER, MESHES, PAD, kernel
from labbook_numba.kernels.mesh_walls import near_mesh
from labbook_numba.kernels.shape import near_grain, near_wall
from labbook_numba.state import Params, State


@kernel
def near_pairs(st: State, p: Params, pair_i, pair_j, cell, head, next_grain):
    """List the pairs i < j of grains whose surfaces are closer than a skin, in ascending order; return their number."""
    grains, body, n = st.grains, st.body, st.count[GRAINS]
    reach = wide(2.0) * p.radius + p.skin
    nx, ny, nz = fill_cells(grains, n, reach + wide(2.0) * p.half, cell, head, next_grain, p.period)
    capacity = len(pair_j) - PAD
    count = 0
    for i in range(n):
        start = count
        for a in range(max(cell[i, 0] - 1, 0), min(cell[i, 0] + 2, nx)):
            for b in range(first_along_y(cell[i, 1], p.period), end_along_y(cell[i, 1], ny, p.period)):
                for c in range(max(cell[i, 2] - 1, 0), min(cell[i, 2] + 2, nz)):
                    j = head[(a * ny + wrapped(b, ny, p.period)) * nz + c]
                    while j > i:  # the list of a cell descends: the rest are pairs with i second
                        near = near_grain(grains, body, i, j, reach, p.half, p.skin, p.period)
                        if CLUMPS:  # spheres of one clump do not act on each other
                            near = near and st.ids[i] != st.ids[j]
                        if near:
                            # beyond the capacity pairs are only counted, for the size of the next attempt
                            if count < capacity:
                                k = count
                                # insertion sort, as a grain has some ten neighbours; sorted lists fix the order of each
                                # sum of forces
                                while k > start and pair_j[k - 1] > j:
                                    pair_j[k] = pair_j[k - 1]
                                    k -= 1
                                pair_j[k] = j
                                pair_i[count] = i
                            count += 1
                        j = next_grain[j]
    return count


@kernel
def near_walls(st: State, p: Params, first, grain):
    """List the grains that could touch a wall before the next rebuild, wall by wall; return their number."""
    # until the next rebuild a grain moves half a skin at most: two approach by a skin, one and a wall by half of it
    half_skin = wide(0.5) * p.skin
    count = 0
    first[0] = 0
    for w in range(len(p.wall_kind)):
        for i in range(st.count[GRAINS]):
            near = False
            is_mesh = False
            if MESHES:
                is_mesh = p.wall_kind[w] == MESH_NUMBER
                if is_mesh:
                    near = near_mesh(st, p, w, i, p.mesh_moves)
            if not is_mesh:
                near = near_wall(st.grains, st.body, i, p.walls, p.wall_kind, w, p.radius, p.half, half_skin)
            if near:
                if count < len(grain) - PAD:
                    grain[count] = i
                count += 1
        first[w + 1] = count
    return count
