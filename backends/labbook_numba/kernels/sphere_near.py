"""Spheres that are near one another, or near a wall."""

from labbook_dem.words import VARIED, dot, func

from labbook_numba.kernels.bodies import radius_of
from labbook_numba.kernels.features import X
from labbook_numba.kernels.single import load
from labbook_numba.kernels.surfaces import wall_distance


@func
def near_grain(grains, body, i, j, reach, half, skin):
    """Whether two spheres are closer than their radii and a skin; `reach`: that of the largest [m]."""
    away = load(grains, i, X) - load(grains, j, X)
    far = body[i, 0] + body[j, 0] + skin if VARIED else reach
    return dot(away, away) < far * far


@func
def near_wall(grains, body, i, shape, kind, w, radius, half, skin):
    """Whether sphere i is closer than its radius and a skin to wall w; `radius`: of all, if they are alike."""
    distance, _ = wall_distance(shape, kind, w, load(grains, i, X))
    return distance < radius_of(body, i, radius) + skin
