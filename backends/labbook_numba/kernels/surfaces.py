"""How the surfaces of walls move; where they are: `labbook_dem.chosen`."""

from typing import Any

from labbook_dem.words import func, wide3


def wall_numbers(walls, w) -> Any:
    """The numbers of wall w; a generated module has WALL_NUMBERS of them in a tuple, as functions of walls take them.

    (With an array in place of the tuple kernels of rods take a third longer: references to it are counted.)
    """
    raise NotImplementedError("written by labbook_numba.build")


@func
def wall_velocity(motion, w, at):
    """Velocity [m/s] of the surface of wall w at the point `at`."""
    return wide3(motion[w, 0] - motion[w, 3] * at.y, motion[w, 1] + motion[w, 3] * at.x, motion[w, 2])
