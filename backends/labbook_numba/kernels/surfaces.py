"""What describes walls, and how their surfaces move; where they are: `labbook_dem.chosen`."""

from labbook_dem.words import func, wide3


@func
def wall_number(walls, w, k):
    """Number k of wall w (`labbook_dem.dispatch`)."""
    return walls[w, k]


@func
def wall_velocity(motion, w, at):
    """Velocity [m/s] of the surface of wall w at the point `at`."""
    return wide3(motion[w, 0] - motion[w, 3] * at.y, motion[w, 1] + motion[w, 3] * at.x, motion[w, 2])
