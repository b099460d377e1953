"""All points within a radius of a middle line with a bend, in the x-z plane or rotated about the z axis, for spheres.

far, along, length: end of the line away from the bend [m], unit direction to the bend, distance of the bend [m]. edge,
down, height: bend [m], unit direction to the foot (zero without a foot), distance of the foot [m]. They have x or the
radius, and z. radius [m]; turned: 1 if the line is rotated, else 0.
"""

import math

from labbook.scene.thick_plate import ThickPlate
from labbook_dem.words import func, section, sqrt, wide, wide3

PARTS = 2


@func
def thick_plate_distance(
    far: section, along: section, length: wide, edge: section, down: section, height: wide, radius: wide, turned: wide,
    x: wide3,
):  # fmt: skip
    """Distance [m] of x from the surface, and the unit normal from there to x; that of the nearer of both lines."""
    zero = wide(0.0)
    unity = wide(1.0)
    rho = sqrt(x.x * x.x + x.y * x.y)
    u = rho if turned > zero else x.x
    du = u - far.x
    dz = x.z - far.z
    at = min(max(du * along.x + dz * along.z, zero), length)
    du = du - along.x * at
    dz = dz - along.z * at
    eu = u - edge.x
    ez = x.z - edge.z
    at = min(max(eu * down.x + ez * down.z, zero), height)
    eu = eu - down.x * at
    ez = ez - down.z * at
    lower = eu * eu + ez * ez < du * du + dz * dz
    ru = eu if lower else du
    rz = ez if lower else dz
    distance = sqrt(ru * ru + rz * rz)
    inverse = unity / distance if distance > zero else zero
    across = ru * inverse
    around = across / rho if rho > zero else zero
    nx = x.x * around if turned > zero else across
    ny = x.y * around if turned > zero else zero
    return distance - radius, wide3(nx, ny, rz * inverse)


def parameters(shape: ThickPlate) -> tuple[float, ...]:
    """Both lines by first end, direction and length; radius [m]; 1 if they are rotated."""
    line, edge = _line(shape.far, shape.edge), _line(shape.edge, shape.foot)
    return *line, *edge, shape.radius, float(shape.turned)


def _line(start: tuple[float, float], end: tuple[float, float]) -> tuple[float, ...]:
    """First end (x, z) [m], unit direction, length [m]; a direction of zero without a length."""
    (u, z), (u1, z1) = start, end
    length = math.hypot(u1 - u, z1 - z)
    return u, z, (u1 - u) / length if length else 0.0, (z1 - z) / length if length else 0.0, length
