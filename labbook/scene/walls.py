"""Wall primitives: what containers are made of and all that a backend has to know of them.

Axes: z up, gravity along -z; the outlet plane of a silo is z = 0, its vertical mid-plane x = 0, and the
middle between its front and back walls y = 0.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo, model_validator

from labbook.scene.model import Fault, Model, TaggedModels, refuse
from labbook.scene.quantities import AngularSpeed, Coordinate, Ratio, Speed

Point3 = tuple[Coordinate, Coordinate, Coordinate]
Point2 = tuple[Coordinate, Coordinate]
Direction = Ratio
Segment = tuple[Point2, Point2]


class WallShape(Model, ABC):
    """What every wall has: where it is, for kernels and for pictures."""

    physics: ClassVar[str]
    """The module of its formulas, as kernels take them; see `labbook_dem.walls`."""
    version: ClassVar[int] = 1
    """Raised whenever its formulas change what a run gives: runs and packings made by an older one are then stale."""
    changes: ClassVar[Mapping[int, str]] = {}
    """What a version changed, in a few words, which `plan` shows."""
    if TYPE_CHECKING:  # a field of each shape
        kind: str
        """Its name."""

    @abstractmethod
    def distance(self, x: np.ndarray) -> np.ndarray:
        """Distance [m] of points x, shape [n, 3], from the wall, shape [n]; behind a plane it is negative."""

    def normal_speed(self, motion: "SurfaceMotion") -> float | None:
        """Largest speed [m/s] along its normal that `motion` would give a point of the wall: 0 if the motion is along
        the surface everywhere, infinite if it grows with the distance from the axis. None: the shape does not say."""
        return None

    @property
    def ground(self) -> float:
        """z [m] of the lowest place at which it can hold a grain up: infinite of walls that hold none, such as vertical
        planes, -infinite where that is unknown or unbounded."""
        return min((end[1] for line in self.section() for end in line), default=-math.inf)

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

    def normal_speed(self, motion: "SurfaceMotion") -> float:
        """As of any wall: a plane can spin in itself only if it is horizontal."""
        return _normal_speed(motion, self.normal)

    @property
    def ground(self) -> float:
        """As of any wall: an inclined plane has no end."""
        if self.normal[2] <= 0:
            return math.inf
        return self.point[2] if self.normal[:2] == (0, 0) else -math.inf


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

    def normal_speed(self, motion: "SurfaceMotion") -> float:
        """As of any wall: a strip can spin in itself only if it is horizontal."""
        (x0, z0), (x1, z1) = self.start, self.end
        return _normal_speed(motion, (z0 - z1, 0.0, x1 - x0))

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

    def normal_speed(self, motion: "SurfaceMotion") -> float:
        """As of any wall: it can always spin; upright it can also move along z, flat along x and y."""
        rise, run = self.upper[1] - self.lower[1], self.upper[0] - self.lower[0]
        x, y, z = motion.velocity
        return _negligible((abs(rise) * math.hypot(x, y) + abs(run * z)) / math.hypot(rise, run), motion)

    def section(self) -> tuple[Segment, ...]:
        """A line on either side of the axis."""
        (r, z), (upper, top) = self.lower, self.upper
        return ((r, z), (upper, top)), ((-r, z), (-upper, top))


WALL_SHAPES = TaggedModels("kind", "labbook.walls", WallShape, (Plane, Strip, Frustum))
"""The walls that containers are made of, and that a study can name in `container.parts`."""

AnyShape = Annotated[WallShape, WALL_SHAPES]
"""One of them, as a field of a wall."""


class SurfaceMotion(Model):
    """Motion of a wall's surface, as of a conveyor belt or a turntable; the wall itself stays where it is."""

    velocity: tuple[Speed, Speed, Speed] = (0.0, 0.0, 0.0)
    """Velocity of the surface along x, y and z, within the surface; the wall itself stays where it is."""
    spin: AngularSpeed = 0.0
    """Angular velocity of the surface about the vertical axis x = y = 0."""

    def speed(self, reach: float) -> float:
        """Largest speed [m/s] of the surface out to the distance `reach` [m] from the axis x = y = 0."""
        return math.hypot(*self.velocity) + (abs(self.spin) * reach if self.spin else 0.0)


AT_REST = SurfaceMotion()
"""Of walls that do not move."""


def _normal_speed(motion: SurfaceMotion, normal: tuple[float, float, float]) -> float:
    """Of a flat wall, from its normal, of any length."""
    if motion.spin and math.hypot(normal[0], normal[1]) > _ALONG * abs(normal[2]):
        return math.inf
    along = sum(v * n for v, n in zip(motion.velocity, normal, strict=True)) / math.hypot(*normal)
    return _negligible(abs(along), motion)


def _negligible(speed: float, motion: SurfaceMotion) -> float:
    """`speed`, or 0 where it is round-off of the velocity."""
    return speed if speed > _ALONG * math.hypot(*motion.velocity) else 0.0


_ALONG = 1e-9  # normals and velocities that a study states to so many parts are taken to be perpendicular


class Wall(Model):
    """One wall: a name that springs and observations are keyed by, a shape, its surface's motion, and whether it
    vanishes when the outlet opens."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9-]*$", max_length=40)]
    """Name that `walls` and friction springs refer to: lower-case letters, digits and hyphens."""
    shape: AnyShape
    motion: SurfaceMotion = AT_REST
    # where it is not stated it is left out of what is stored
    opens: Annotated[Literal["start"] | None, Field(exclude_if=lambda opens: opens is None)] = None
    """`start`: the wall stands while the container is filled and vanishes when the discharge starts; none: it stays."""

    @model_validator(mode="after")
    def _moves_along_itself(self, info: ValidationInfo):
        if (info.context or {}).get("units") == "required":  # runs of older versions stay readable
            refuse(self._faults())
        return self

    def _faults(self) -> Iterator[Fault]:
        if self.motion == AT_REST:
            return
        off = self.shape.normal_speed(self.motion)
        if off is None:
            reason = f"a surface motion of a {self.shape.kind} cannot be checked: the shape has no normal_speed"
            yield Fault("motion", reason, "leave motion out, or add normal_speed to the shape")
        elif off > 0:
            key, remedy = "velocity", "keep the components along the wall"
            part = f"has a component of {off:g} m/s along the wall's normal"
            if math.isinf(off):
                key, part = "spin", "turns the surface out of itself"
                remedy = "spin only horizontal planes and strips, or frustums"
            reason = f"the motion is that of the surface only, the wall itself stays, and this {key} {part}"
            yield Fault(f"motion.{key}", reason, f"{remedy}; walls that move are not available")
