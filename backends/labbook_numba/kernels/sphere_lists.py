"""Spheres, free ones and those of clumps: criteria for lists."""

from labbook_dem.chosen import wall_distance
from labbook_dem.words import VARIED, dot, func

from labbook_numba.kernels.bodies import radius_of
from labbook_numba.kernels.branches import branch_between
from labbook_numba.kernels.features import X
from labbook_numba.kernels.surfaces import wall_numbers
from labbook_numba.kernels.transfer import load


@func
def near_grain(grains, body, i, j, reach, half, skin, period):
    """True if two spheres are closer than their radii and a skin; reach: that of the largest [m]."""
    branch = branch_between(grains, i, j, period)
    limit = body[i, 0] + body[j, 0] + skin if VARIED else reach
    return dot(branch, branch) < limit * limit


@func
def near_wall(grains, body, i, walls, kind, w, radius, half, skin):
    """True if sphere i is closer than its radius and a skin to wall w; radius: of all, if they are the same."""
    distance, _ = wall_distance(wall_numbers(walls, w), w, kind[w], load(grains, i, X))
    return distance < radius_of(body, i, radius) + skin
