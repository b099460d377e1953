"""Rods that are near one another, or near a wall."""

from labbook_dem.segments import closest
from labbook_dem.words import dot, func, wide

from labbook_numba.kernels.features import WALL_PARTS, A, X
from labbook_numba.kernels.rod_walls import edges, wall_part
from labbook_numba.kernels.single import load


@func
def near_grain(grains, body, i, j, reach, half, skin):
    """Whether the segments of two rods are closer than `reach` [m], a diameter and a skin."""
    far = reach + wide(2.0) * half  # centres further apart cannot be near
    branch = load(grains, i, X) - load(grains, j, X)
    near = dot(branch, branch) < far * far
    if near:
        _, _, away = closest(branch, load(grains, i, A), load(grains, j, A), half)
        near = dot(away, away) < reach * reach
    return near


@func
def near_wall(grains, body, i, shape, kind, w, radius, half, skin):
    """Whether some part of rod i is closer than a radius and a skin to wall w."""
    x = load(grains, i, X)
    a = load(grains, i, A)
    reach = radius + skin
    found = edges(shape, kind, w, x, a, half, reach)
    near = False
    for part in range(WALL_PARTS):
        distance, _, _ = wall_part(shape, kind, w, x, a, half, reach, part, found)
        near = near or distance < reach
    return near
