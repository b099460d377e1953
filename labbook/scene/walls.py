"""Wall primitives: what containers are made of and all that an engine has to know of them.

Axes: z up, gravity along -z; the outlet plane of a silo is z = 0, its vertical mid-plane x = 0, and the
middle between its front and back walls y = 0.
"""

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from labbook.scene.model import Fault, Model, refuse
from labbook.scene.quantities import AngularSpeed, Coordinate, Ratio, Speed

Point3 = tuple[Coordinate, Coordinate, Coordinate]
Point2 = tuple[Coordinate, Coordinate]
Direction = Ratio


class Plane(Model):
    """The half-space behind an infinite plane. `normal` points to the grains; it is normalised on use."""

    kind: Literal["plane"] = "plane"
    point: Point3
    """A point of the plane."""
    normal: tuple[Direction, Direction, Direction]
    """Direction towards the grains, of any length."""

    @model_validator(mode="after")
    def _has_a_direction(self):
        if math.hypot(*self.normal) < 1e-6:
            refuse([Fault("normal", "a normal of length zero has no direction", "for example [0, 0, 1]")])
        return self


class Strip(Model):
    """A thin plate: the segment from `start` to `end` in the x-z plane [m], endless along y.

    Its two edges are real: a grain rolls over them. Two strips that share an end make a corner.
    """

    kind: Literal["strip"] = "strip"
    start: Point2
    """x and z of one edge."""
    end: Point2
    """x and z of the other edge."""

    @model_validator(mode="after")
    def _has_a_length(self):
        if self.start == self.end:
            refuse([Fault("end", "the two edges of a strip are the same", "set them apart")])
        return self


WallShape = Annotated[Plane | Strip, Field(discriminator="kind")]


class SurfaceMotion(Model):
    """Motion of a wall's surface; the wall itself stays."""

    velocity: tuple[Speed, Speed, Speed] = (0.0, 0.0, 0.0)
    """Along x, y and z."""
    spin: AngularSpeed = 0.0
    """About the vertical axis x = y = 0."""


class Wall(Model):
    """One wall: a name that springs and observations are keyed by, a shape, its surface's motion."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9-]*$", max_length=40)]
    """Name that `walls` and friction springs refer to: lower-case letters, digits and hyphens."""
    shape: WallShape
    motion: SurfaceMotion = SurfaceMotion()
