"""Branches between the centres of grains: between periodic sides, those of nearest images."""

from labbook_dem.images import image, nearest
from labbook_dem.words import PERIODIC, func

from labbook_numba.kernels.features import GRAIN, X
from labbook_numba.kernels.transfer import load
from labbook_numba.rows import columns, rows_at


@func
def eight_branches(grains, pair_i, pair_j, k, period):
    """Columns x, y and z of the branches from j to i [m] of eight listed pairs, from entry k on."""
    x, y, z, _ = columns(rows_at(grains, pair_i, k, GRAIN, X) - rows_at(grains, pair_j, k, GRAIN, X))
    if PERIODIC:
        y = nearest(y, period)
    return x, y, z


@func
def branch_between(grains, i, j, period):
    """Branch from grain j to grain i [m]."""
    return image(load(grains, i, X) - load(grains, j, X), period)
