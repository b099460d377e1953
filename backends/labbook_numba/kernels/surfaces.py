"""How the surfaces of walls move, and which grains are near them; where they are: `labbook_dem.chosen`."""

from typing import Any

from labbook_dem.words import func, wide3

from labbook_numba.kernels.features import FIRST, LAST, kernel


def wall_numbers(walls, w) -> Any:
    """The numbers of wall w; a generated module has WALL_NUMBERS of them in a tuple, as functions of walls take them.

    (With an array in place of the tuple kernels of rods take a third longer: references to it are counted.)
    """
    raise NotImplementedError("written by labbook_numba.build")


@func
def wall_velocity(motion, w, at):
    """Velocity [m/s] of the surface of wall w at the point `at`."""
    return wide3(motion[w, 0] - motion[w, 3] * at.y, motion[w, 1] + motion[w, 3] * at.x, motion[w, 2])


@kernel
def first_at_least(ascending, first, last, value):
    """Where in ascending[first:last] the first number is that is not below `value`; `last` if there is none."""
    while first < last:
        middle = (first + last) // 2
        if ascending[middle] < value:
            first = middle + 1
        else:
            last = middle
    return first


@kernel
def near_here(domain, wall_grain, first, last):
    """Of the entries first..last of the grains near one wall, first and end of those in the domain."""
    start = first_at_least(wall_grain, first, last, domain[FIRST])
    return start, first_at_least(wall_grain, start, last, domain[LAST])
