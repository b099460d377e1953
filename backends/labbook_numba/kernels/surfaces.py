"""Where walls are and how their surfaces move."""

from labbook_dem.walls.frustum import frustum_distance
from labbook_dem.walls.plane import plane_distance
from labbook_dem.walls.strip import strip_distance
from labbook_dem.words import func, wide, wide3

from labbook_numba.kernels.features import FRUSTUMS, PLANES, STRIPS


@func
def plane_of(shape, w):
    """A point of plane w [m], and its unit normal."""
    return wide3(shape[w, 0], shape[w, 1], shape[w, 2]), wide3(shape[w, 3], shape[w, 4], shape[w, 5])


@func
def section_of(shape, w):
    """First end [m] and unit direction of strip or frustum w, in its section."""
    zero = wide(0.0)
    return wide3(shape[w, 0], zero, shape[w, 1]), wide3(shape[w, 2], zero, shape[w, 3])


@func
def wall_distance(shape, kind, w, x):
    """Distance [m] of x from wall w, and the unit normal from the wall to x."""
    if FRUSTUMS and (kind[w] == 2 or not (PLANES or STRIPS)):
        rim, along = section_of(shape, w)
        return frustum_distance(rim, along, shape[w, 4], x)
    if STRIPS and (kind[w] == 1 or not PLANES):
        start, along = section_of(shape, w)
        return strip_distance(start, along, shape[w, 4], x)
    point, normal = plane_of(shape, w)
    return plane_distance(point, normal, x)


@func
def wall_velocity(motion, w, at):
    """Velocity [m/s] of the surface of wall w at the point `at`."""
    return wide3(motion[w, 0] - motion[w, 3] * at.y, motion[w, 1] + motion[w, 3] * at.x, motion[w, 2])
