"""Wall primitives: what containers are made of and all that a backend has to know of them.

Axes: z up, gravity along -z; the outlet plane of a silo is z = 0, its vertical mid-plane x = 0, and the
middle between its front and back walls y = 0.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from labbook.scene.model import Choice, Fault, Model, refuse
from labbook.scene.quantities import AngularSpeed, Coordinate, Ratio, Speed

Point3 = tuple[Coordinate, Coordinate, Coordinate]
Point2 = tuple[Coordinate, Coordinate]
Direction = Ratio
Segment = tuple[Point2, Point2]


class WallShape(Model, ABC):
    """What every wall has: where it is, for kernels and for pictures."""

    physics: ClassVar[str]
    """The module of its formulas, as kernels take them; see `labbook_dem.walls`."""
    if TYPE_CHECKING:  # a field of each shape
        kind: str
        """Its name."""

    @abstractmethod
    def distance(self, x: np.ndarray) -> np.ndarray:
        """Distance [m] of points x, shape [n, 3], from the wall, shape [n]; behind a plane it is negative."""

    def section(self) -> tuple[Segment, ...]:
        """The lines (x, z) [m] in which the plane y = 0 cuts plates; nothing of walls that are no plates."""
        return ()

    def mesh(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Vertices [n, 3] in m and triangles [m, 3] as recordings show them; None of plates and planes, which end where
        the bed does."""
        return None


def _from_segment(section: np.ndarray, start: Point2, end: Point2) -> np.ndarray:
    along, at = np.array(end) - start, section - start
    part = np.minimum(np.maximum(at @ along / (along @ along), 0), 1)
    # by hand: norm along so short an axis takes most of the time of a filling's start
    return np.sqrt((at[:, 0] - part * along[0]) ** 2 + (at[:, 1] - part * along[1]) ** 2)


class Plane(WallShape):
    """The half-space behind an infinite plane; `normal` points to the grains."""

    physics: ClassVar[str] = "labbook_dem.walls.plane"

    kind: Literal["plane"] = "plane"
    point: Point3
    """A point of the plane."""
    normal: tuple[Direction, Direction, Direction]
    """Direction towards the grains, of any length."""

    @model_validator(mode="after")
    def _has_a_direction(self):
        if math.hypot(*self.normal) < 1e-6:
            refuse([Fault("normal", "a normal has length zero, so it has no direction", "for example [0, 0, 1]")])
        return self

    def distance(self, x: np.ndarray) -> np.ndarray:
        """Signed distance [m] of points x, shape [n, 3]."""
        return (x - self.point) @ (np.array(self.normal) / np.linalg.norm(self.normal))


class Strip(WallShape):
    """A thin plate: the segment from `start` to `end` in the x-z plane [m], infinite along y.

    Its two edges are real: a grain rolls over them. Two strips that share an end make a corner.
    """

    physics: ClassVar[str] = "labbook_dem.walls.strip"

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

    def distance(self, x: np.ndarray) -> np.ndarray:
        """Distance [m] of points x, shape [n, 3]."""
        return _from_segment(x[:, [0, 2]], self.start, self.end)

    def section(self) -> tuple[Segment, ...]:
        """Itself."""
        return ((self.start, self.end),)


class Frustum(WallShape):
    """A thin plate round the vertical axis x = y = 0: a segment in the plane of radius and height, rotated about it.

    Upright it is the side of a cylinder, flat a plate with a hole, inclined a cone. Its lower edge is real: a grain
    rolls over it. Two frustums that share a circle make a corner.
    """

    physics: ClassVar[str] = "labbook_dem.walls.frustum"

    kind: Literal["frustum"] = "frustum"
    lower: Point2
    """Radius and z of the inner edge, the rim."""
    upper: Point2
    """Radius and z of the other edge; its radius is not smaller."""

    @model_validator(mode="after")
    def _is_possible(self):
        refuse(self._faults())
        return self

    def _faults(self) -> Iterator[Fault]:
        if self.lower == self.upper:
            yield Fault("upper", "the two ends of a frustum are the same", "set them apart")
        if self.lower[0] < 0:
            yield Fault("lower", "a radius cannot be negative", "use 0 for a plate without a hole")
        if self.upper[0] < self.lower[0]:
            lower, upper = (f"[{r * 1e3:g} mm, {z * 1e3:g} mm]" for r, z in (self.upper, self.lower))
            reason = "it is nearer to the axis than lower, which has to be the inner edge"
            remedy = f"the same cone is lower: {lower}, upper: {upper}"
            yield Fault("upper", reason, remedy)

    def distance(self, x: np.ndarray) -> np.ndarray:
        """Distance [m] of points x, shape [n, 3]."""
        return _from_segment(np.stack([np.hypot(x[:, 0], x[:, 1]), x[:, 2]], axis=1), self.lower, self.upper)

    def section(self) -> tuple[Segment, ...]:
        """A line on either side of the axis."""
        (r, z), (upper, top) = self.lower, self.upper
        return ((r, z), (upper, top)), ((-r, z), (-upper, top))


WALL_SHAPES = Choice("kind", "labbook.walls", WallShape, (Plane, Strip, Frustum))
"""The walls that containers are made of, and that a study can name in `container.parts`."""

AnyShape = Annotated[WallShape, WALL_SHAPES]
"""One of them, as a field of a wall."""


class SurfaceMotion(Model):
    """Motion of a wall's surface; the wall itself stays."""

    velocity: tuple[Speed, Speed, Speed] = (0.0, 0.0, 0.0)
    """Velocity along x, y and z."""
    spin: AngularSpeed = 0.0
    """Angular velocity about the vertical axis x = y = 0."""


AT_REST = SurfaceMotion()
"""Of walls that do not move."""


class Wall(Model):
    """One wall: a name that springs and observations are keyed by, a shape, its surface's motion."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9-]*$", max_length=40)]
    """Name that `walls` and friction springs refer to: lower-case letters, digits and hyphens."""
    shape: AnyShape
    motion: SurfaceMotion = AT_REST
