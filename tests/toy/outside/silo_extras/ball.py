"""A wall: a ball that stands in the way."""

from typing import ClassVar, Literal

import numpy as np
from labbook_dem.words import dot, func, sqrt, wide, wide3

from labbook.scene.geometry import Bounds, Mesh
from labbook.scene.quantities import Coordinate, Length
from labbook.scene.walls import WallShape


class Ball(WallShape):
    """A ball that does not move."""

    physics: ClassVar[str] = __name__

    kind: Literal["ball"] = "ball"
    centre: tuple[Coordinate, Coordinate, Coordinate]
    """Its centre."""
    radius: Length
    """Its radius."""

    def distance(self, x: np.ndarray) -> np.ndarray:
        """Distance [m] of points x, shape [n, 3], from its surface."""
        return np.linalg.norm(x - np.array(self.centre), axis=1) - self.radius

    def mesh(self, within: Bounds) -> Mesh:
        """An octahedron."""
        tips = np.concatenate([np.eye(3), -np.eye(3)])
        faces = [(i, j, k) for i in (0, 3) for j in (1, 4) for k in (2, 5)]
        return Mesh(np.array(self.centre) + self.radius * tips, np.array(faces))


PARTS = 4


def parameters(shape: Ball) -> tuple[float, ...]:
    """Centre and radius [m]."""
    return *shape.centre, shape.radius


@func
def ball_distance(centre: wide3, radius: wide, x: wide3):
    """Distance [m] of x from the ball, and the unit normal from there to x."""
    away = x - centre
    distance = sqrt(dot(away, away))
    return distance - radius, away * (wide(1.0) / distance)


@func
def ball_edge(centre: wide3, radius: wide, x: wide3, part: int):
    """The same distance: a rod is met where it is nearest, which may be between its ends."""
    distance, _normal = ball_distance(centre, radius, x)
    return distance if part == 2 else wide(1e9)


@func
def ball_rod(centre: wide3, radius: wide, x: wide3, a: wide3, half: wide, part: int):
    """Distance [m] of a rod from the ball, unit normal, and where on the segment it is nearest [m]: as part 2."""
    s = min(max(dot(centre - x, a), -half), half)
    distance, normal = ball_distance(centre, radius, x + a * s)
    return (distance if part == 2 else wide(1e9)), normal, s
