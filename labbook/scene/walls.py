"""Wall primitives: what containers are made of and all that a backend has to know of them.

Axes: z up, gravity along -z; the outlet plane of a silo is z = 0, its vertical mid-plane x = 0, and the
middle between its front and back walls y = 0.
"""

import math
from collections.abc import Iterator
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


class Frustum(Model):
    """A thin plate round the vertical axis x = y = 0: a segment in the plane of radius and height, turned about it.

    Upright it is the side of a cylinder, flat a plate with a hole, inclined a cone. Its lower edge is real: a grain
    rolls over it. Two frustums that share a circle make a corner.
    """

    kind: Literal["frustum"] = "frustum"
    lower: Point2
    """Radius and z of the edge, the rim."""
    upper: Point2
    """Radius and z of the other end, at a radius that is not less."""

    @model_validator(mode="after")
    def _is_possible(self):
        refuse(self._faults())
        return self

    def _faults(self) -> Iterator[Fault]:
        if self.lower == self.upper:
            yield Fault("upper", "the two ends of a frustum are the same", "set them apart")
        if self.lower[0] < 0:
            yield Fault("lower", "a radius is not negative", "use 0 for a plate without a hole")
        if self.upper[0] < self.lower[0]:
            yield Fault("upper", "it is nearer to the axis than the rim", "exchange the two ends")


WallShape = Annotated[Plane | Strip | Frustum, Field(discriminator="kind")]


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
