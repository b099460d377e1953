"""Motion of the surfaces of walls, and the grains of a domain near them. Distances: `labbook_dem.chosen`."""

from typing import Any

from labbook_dem.words import func, wide3

from labbook_numba.kernels.features import FIRST, LAST, kernel


def wall_numbers(walls, w) -> Any:
    """Numbers of wall w; in a generated module a tuple of WALL_NUMBERS, as functions of walls take them.

    With an array instead of the tuple kernels of rods take a third longer: references to it are counted.
    """
    raise NotImplementedError("written by labbook_numba.build")


@func
def wall_velocity(motion, w, at):
    """Velocity [m/s] of the surface of wall w at the point `at` [m]: translation, and rotation about the z axis."""
    return wide3(motion[w, 0] - motion[w, 3] * at.y, motion[w, 1] + motion[w, 3] * at.x, motion[w, 2])


@kernel
def first_at_least(ascending, first, last, value):
    """Index of the first number in ascending[first:last] that is not below `value`; `last` if there is none."""
    while first < last:
        middle = (first + last) // 2
        if ascending[middle] < value:
            first = middle + 1
        else:
            last = middle
    return first


@kernel
def near_here(domain, wall_grain, first, last):
    """First and end of the domain's entries among the entries first..last of the grains near one wall."""
    start = first_at_least(wall_grain, first, last, domain[FIRST])
    return start, first_at_least(wall_grain, start, last, domain[LAST])
