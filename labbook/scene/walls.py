"""Wall primitives: what containers are made of and all that an engine has to know of them.

Axes: z up, gravity along -z; the outlet plane of a silo is z = 0, its vertical mid-plane x = 0, and the
middle between its front and back walls y = 0.
"""

import math
from typing import Annotated, Literal, Union

from pydantic import Field, model_validator

from labbook.scene.model import Model
from labbook.scene.quantities import AngularSpeed, Coordinate, Speed

Point3 = tuple[Coordinate, Coordinate, Coordinate]
Point2 = tuple[Coordinate, Coordinate]


class Plane(Model):
    """The half-space behind an infinite plane. `normal` points to the grains; it is normalised on use."""

    kind: Literal["plane"] = "plane"
    point: Point3
    normal: tuple[float, float, float]

    @model_validator(mode="after")
    def _has_a_direction(self):
        if not math.isfinite(math.hypot(*self.normal)) or math.hypot(*self.normal) == 0:
            raise ValueError("the normal of a plane must have a direction")
        return self


class Strip(Model):
    """A thin plate: the segment from `start` to `end` in the x-z plane [m], endless along y.

    Its two edges are real: a grain rolls over them. Two strips that share an end make a corner.
    """

    kind: Literal["strip"] = "strip"
    start: Point2
    end: Point2

    @model_validator(mode="after")
    def _has_a_length(self):
        if self.start == self.end:
            raise ValueError("the two ends of a strip must differ")
        return self


WallShape = Annotated[Union[Plane, Strip], Field(discriminator="kind")]


class SurfaceMotion(Model):
    """Velocity of a wall's surface: `velocity` + spin about the vertical axis x = y = 0. The wall itself stays."""

    velocity: tuple[Speed, Speed, Speed] = (0.0, 0.0, 0.0)
    spin: AngularSpeed = 0.0


class Wall(Model):
    """One wall: a name that friction springs and observations are keyed by, a shape, and how its surface moves."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9-]*$", max_length=40)]
    shape: WallShape
    motion: SurfaceMotion = SurfaceMotion()
