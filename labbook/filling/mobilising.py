"""Mobilisation of wall friction before the opening: the bottom of a bed at rest sinks slowly against the upright walls.

The surfaces of the upright walls move up, and bed and bottom stay where they are: the same motion in the frame of the
bottom, for any container. Experiments prepare beds so, as friction is then mobilised in one direction at all contacts
with walls (Vanel & Clement, Eur. Phys. J. B 11 (1999) 525).
"""

from typing import Annotated

from pydantic import Field

from labbook.scene import Primitives, Scene
from labbook.scene.model import Model
from labbook.scene.quantities import Length, Speed
from labbook.scene.wall_bins import is_upright
from labbook.scene.walls import Wall


class Mobilise(Model):
    """Motion of the bottom against the upright walls, after the bed has come to rest; then it comes to rest again."""

    bottom: Length
    """Distance by which the bottom sinks relative to the upright walls, whose surfaces move up instead."""
    velocity: Annotated[Speed, Field(gt=0)]
    """Velocity of that motion, far below √(g d)."""

    @property
    def time(self) -> float:
        """Duration of the motion [s]."""
        return self.bottom / self.velocity


def lifted(closed: Scene, velocity: float) -> Scene:
    """Give the surfaces of the upright walls of a closed scene a velocity [m/s] upwards; all else stays."""

    def moved(wall: Wall) -> Wall:
        if not is_upright(wall):
            return wall
        return wall.model_copy(update={"motion": wall.motion.model_copy(update={"velocity": (0.0, 0.0, velocity)})})

    plane = closed.container.outlet_plane
    parts = tuple(map(moved, closed.container.walls()))
    walls = {"parts": parts, "outlet_plane": plane, "closed": closed.container.closed}
    container = Primitives.of(kind="primitives", sink=None, planes=(), **walls)
    return closed.model_copy(update={"container": container})
