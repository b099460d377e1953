"""Wall primitives: parts of containers, with all that a backend has to know of them.

Axes: z up, gravity along -z; the outlet plane of a silo is z = 0, its vertical mid-plane x = 0, and the
middle between its front and back walls y = 0.
"""

import math
from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo, model_validator

from labbook.scene.geometry import AROUND, Bounds, Mesh, Segment, above_line, from_segment
from labbook.scene.mesh import TriangleMesh
from labbook.scene.model import Fault, Model, OrWord, TaggedModels, refuse
from labbook.scene.part_motion import PartMotion, Poses
from labbook.scene.quantities import Coordinate, Duration, Ratio
from labbook.scene.thick_plate import ThickPlate
from labbook.scene.wall_shape import AT_REST, SurfaceMotion, Symmetry, WallShape

Point3 = tuple[Coordinate, Coordinate, Coordinate]
Point2 = tuple[Coordinate, Coordinate]
Direction = Ratio
_STRAIGHT = 1e-9  # of a strip's length: how far off its line a point may lie


class Plane(WallShape):
    """The half-space behind an infinite plane; `normal` points to the grains."""

    half_space: ClassVar[bool] = True

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
        """Signed distance n (x - p) [m] of points x, shape [n, 3], from the point p of the plane, n its unit normal."""
        return (x - self.point) @ (np.array(self.normal) / np.linalg.norm(self.normal))

    def normal_speed(self, motion: SurfaceMotion) -> float:
        """Speed along the normal [m/s]: infinite with a spin, unless the plane is horizontal."""
        return _normal_speed(motion, self.normal)

    @property
    def _across(self) -> int | None:
        """Axis that the plane is perpendicular to; None if it is inclined."""
        along = [axis for axis, component in enumerate(self.normal) if component != 0]
        return along[0] if len(along) == 1 else None

    @property
    def bounds(self) -> Bounds:
        """Box without end [m], but along a normal that is parallel to an axis."""
        here = {self._across: self.point[self._across]} if self._across is not None else {}
        low, high = ([here.get(axis, end) for axis in range(3)] for end in (-math.inf, math.inf))
        return Bounds((low[0], low[1], low[2]), (high[0], high[1], high[2]))

    @property
    def symmetries(self) -> frozenset[Symmetry]:
        """Symmetries: planar unless the plane is inclined along y, axial if it is horizontal."""
        x, y, z = (component != 0 for component in self.normal)
        return frozenset([*(["planar"] if not (y and (x or z)) else []), *(["axial"] if not (x or y) else [])])

    @property
    def ground(self) -> float:
        """Height z [m] of a horizontal plane below grains; -infinite of an inclined one, infinite of others."""
        if self.normal[2] <= 0:
            return math.inf
        return self.point[2] if self._across == 2 else -math.inf

    @property
    def prismatic_above(self) -> float:
        """Height -infinite, or infinite of an inclined plane."""
        return -math.inf if self.normal[2] == 0 or self._across == 2 else math.inf

    def carries(self, x: np.ndarray) -> np.ndarray:
        """Mask of points above a horizontal plane, shape [n]; no points of others, whose end is unknown."""
        return np.full(len(x), self._across == 2 and self.normal[2] > 0) & (x[:, 2] >= self.point[2])

    def section(self, within: Bounds | None = None) -> tuple[Segment, ...]:
        """Line (x, z) [m] through the box; none of a plane that y = 0 is parallel to."""
        (x, y, z), (nx, ny, nz) = self.point, self.normal
        if within is None or math.hypot(nx, nz) <= 1e-9 * math.hypot(*self.normal):
            return ()
        (left, _, low), (right, _, high) = within.low, within.high
        points = [(at, z + ny / nz * y - nx / nz * (at - x)) for at in (left, right)] if nz else []
        points += [(x + ny / nx * y - nz / nx * (at - z), at) for at in (low, high)] if nx else []
        ends = [(a, b) for a, b in points if left <= a <= right and low <= b <= high]
        return ((min(ends), max(ends)),) if ends and min(ends) != max(ends) else ()

    def mesh(self, within: Bounds) -> Mesh:
        """Square about the middle of the box, as large as the box."""
        low, high = np.array(within.low), np.array(within.high)
        normal = np.array(self.normal) / np.linalg.norm(self.normal)
        middle = (low + high) / 2
        middle = middle - normal * np.dot(middle - self.point, normal)
        across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        across /= np.linalg.norm(across)
        up = np.cross(normal, across)
        box = (high - low) / 2
        a, b = across * np.abs(across @ box), up * np.abs(up @ box)
        return Mesh.polygon(np.array([middle - a - b, middle + a - b, middle + a + b, middle - a + b]), outlined=False)

    @property
    def is_transparent(self) -> bool:
        """True: grains are seen through it."""
        return True

    def mirrored(self) -> "Plane":
        """Mirror image in x = 0."""
        (x, y, z), (nx, ny, nz) = self.point, self.normal
        return Plane(point=(-x, y, z), normal=(-nx, ny, nz))


class Strip(WallShape):
    """A thin plate: the segment from `start` to `end` in the x-z plane [m], infinite along y.

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

    def distance(self, x: np.ndarray) -> np.ndarray:
        """Distance [m] of points x, shape [n, 3], from the nearest point of the plate."""
        return from_segment(x[:, [0, 2]], self.start, self.end)

    def normal_speed(self, motion: SurfaceMotion) -> float:
        """Speed along the normal [m/s]: infinite with a spin, unless the strip is horizontal."""
        (x0, z0), (x1, z1) = self.start, self.end
        return _normal_speed(motion, (z0 - z1, 0.0, x1 - x0))

    @property
    def bounds(self) -> Bounds:
        """Box around both edges [m], without end along y."""
        (x0, z0), (x1, z1) = self.start, self.end
        return Bounds((min(x0, x1), -math.inf, min(z0, z1)), (max(x0, x1), math.inf, max(z0, z1)))

    @property
    def symmetries(self) -> frozenset[Symmetry]:
        """Symmetry: planar."""
        return frozenset(["planar"])

    @property
    def ground(self) -> float:
        """Height z [m] of the lower edge."""
        return self.bounds.low[2]

    @property
    def prismatic_above(self) -> float:
        """Height z [m] of the lower edge of an upright strip, else of the upper one."""
        return (min if self.start[0] == self.end[0] else max)(self.start[1], self.end[1])

    def carries(self, x: np.ndarray) -> np.ndarray:
        """Mask of points straight above the strip, shape [n]."""
        return above_line(self.start, self.end, x[:, 0], x[:, 2])[0]

    def covers(self, x: np.ndarray) -> np.ndarray:
        """Mask of points straight below the strip, shape [n]."""
        return above_line(self.start, self.end, x[:, 0], x[:, 2])[1]

    def section(self, within: Bounds | None = None) -> tuple[Segment, ...]:
        """Line from edge to edge (x, z) [m], as a whole."""
        return ((self.start, self.end),)

    def mesh(self, within: Bounds) -> Mesh:
        """Rectangle, cut only along y and at the top of the box."""
        lower, upper = sorted((self.start, self.end), key=lambda edge: edge[1])
        (_, front, _), (_, back, top) = within.low, within.high
        if upper[1] > top > lower[1]:
            fraction = (top - lower[1]) / (upper[1] - lower[1])
            upper = lower[0] + fraction * (upper[0] - lower[0]), top
        (x0, z0), (x1, z1) = lower, upper
        corners = np.array([(x0, front, z0), (x1, front, z1), (x1, back, z1), (x0, back, z0)])
        return Mesh.polygon(corners, outlined=True)

    def continued(self, successor: WallShape, x: np.ndarray) -> np.ndarray:
        """Mask of grains whose foot on this strip lies on `successor`, shape [n]: a strip on the same line, or a thick
        plate with its upper side there."""
        if isinstance(successor, Strip):
            ends = successor.start, successor.end
        elif isinstance(successor, ThickPlate) and not successor.turned:
            ends = successor.upper_side
        else:
            return np.zeros(len(x), bool)
        start, along = np.array(self.start), np.array(self.end) - self.start
        foot = start + ((x[:, [0, 2]] - start) @ along / (along @ along))[:, None] * along
        begin, run = np.array(ends[0]), np.array(ends[1]) - ends[0]
        length = run @ run
        if abs(along[0] * run[1] - along[1] * run[0]) >= _STRAIGHT * np.sqrt(length * (along @ along)):
            return np.zeros(len(x), bool)
        at = (foot - begin) @ run / length
        aside = np.linalg.norm(foot - begin - at[:, None] * run, axis=1)
        return (at >= 0) & (at <= 1) & (aside < _STRAIGHT * np.sqrt(length))

    def mirrored(self) -> "Strip":
        """Mirror image in x = 0."""
        start, end = ((-x, z) for x, z in (self.start, self.end))
        return Strip(start=start, end=end)


class Frustum(WallShape):
    """A thin plate round the vertical axis x = y = 0: a segment in the plane of radius and height, rotated about it.

    Upright it is the side of a cylinder, flat a plate with a hole, inclined a cone. Its lower edge is real: a grain
    rolls over it. Two frustums that share a circle make a corner.
    """

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
        """Distance [m] of points x, shape [n, 3], from the nearest point of the plate."""
        return from_segment(np.stack([np.hypot(x[:, 0], x[:, 1]), x[:, 2]], axis=1), self.lower, self.upper)

    def normal_speed(self, motion: SurfaceMotion) -> float:
        """Speed along the normal [m/s]: 0 of a spin; upright also of a velocity along z, flat along x and y."""
        rise, run = self.upper[1] - self.lower[1], self.upper[0] - self.lower[0]
        x, y, z = motion.velocity
        return _negligible((abs(rise) * math.hypot(x, y) + abs(run * z)) / math.hypot(rise, run), motion)

    @property
    def bounds(self) -> Bounds:
        """Box around both circles [m]."""
        (_, z), (upper, top) = self.lower, self.upper
        return Bounds((-upper, -upper, min(z, top)), (upper, upper, max(z, top)))

    @property
    def symmetries(self) -> frozenset[Symmetry]:
        """Symmetry: axial."""
        return frozenset(["axial"])

    @property
    def ground(self) -> float:
        """Height z [m] of the lower edge."""
        return self.bounds.low[2]

    @property
    def prismatic_above(self) -> float:
        """Height z [m] of the lower edge of a cylinder, else of the upper one."""
        return (min if self.lower[0] == self.upper[0] else max)(self.lower[1], self.upper[1])

    @property
    def reach(self) -> float:
        """Larger radius [m]."""
        return self.upper[0]

    def carries(self, x: np.ndarray) -> np.ndarray:
        """Mask of points straight above the frustum, shape [n]."""
        return above_line(self.lower, self.upper, np.hypot(x[:, 0], x[:, 1]), x[:, 2])[0]

    def covers(self, x: np.ndarray) -> np.ndarray:
        """Mask of points straight below the frustum, shape [n]."""
        return above_line(self.lower, self.upper, np.hypot(x[:, 0], x[:, 1]), x[:, 2])[1]

    def section(self, within: Bounds | None = None) -> tuple[Segment, ...]:
        """Line (x, z) [m] on either side of the axis, each as a whole."""
        (r, z), (upper, top) = self.lower, self.upper
        return ((r, z), (upper, top)), ((-r, z), (-upper, top))

    def mesh(self, within: Bounds) -> Mesh | None:
        """Frustum of a polygon, cut only at the top of the box, and outlined by its two edges."""
        (r0, z0), (r1, z1), top = self.lower, self.upper, within.high[2]
        if z0 >= top:
            return None
        if z1 > top:
            r1, z1 = r0 + (r1 - r0) * (top - z0) / (z1 - z0), top
        return Mesh.turned(((r0, z0), (r1, z1)), AROUND)

    @property
    def is_transparent(self) -> bool:
        """True of sides and cones, false of level plates."""
        return self.lower[1] != self.upper[1]

    def mirrored(self) -> "Frustum":
        """Mirror image in x = 0: the frustum itself."""
        return self


WALL_SHAPES = TaggedModels("kind", "labbook.walls", WallShape, (Plane, Strip, Frustum, TriangleMesh, ThickPlate))
"""Walls that containers are made of, and that a study can name in `container.parts`."""

AnyShape = Annotated[WallShape, WALL_SHAPES]
"""Field of a wall for one of these shapes."""


def _normal_speed(motion: SurfaceMotion, normal: tuple[float, float, float]) -> float:
    """Largest speed [m/s] along the normal of a flat wall; `normal`: of any length."""
    if motion.spin and math.hypot(normal[0], normal[1]) > _ALONG * abs(normal[2]):
        return math.inf
    along = sum(v * n for v, n in zip(motion.velocity, normal, strict=True)) / math.hypot(*normal)
    return _negligible(abs(along), motion)


def _negligible(speed: float, motion: SurfaceMotion) -> float:
    """Round a `speed` [m/s] to 0 where it is round-off of the velocity."""
    return speed if speed > _ALONG * math.hypot(*motion.velocity) else 0.0


_ALONG = 1e-9  # normals and velocities that a study states to so many parts are taken to be perpendicular


START = "start"
"""Value of `Wall.opens` for a wall that vanishes when the discharge starts."""
OUT_OF_REACH = 1e6
"""Distance [m] along x, y and z at which a part that has vanished touches no grain."""


class Wall(Model):
    """Wall of a container: a name that springs and observations are keyed by, a shape, and its motion."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9-]*$", max_length=40)]
    """Name that `walls` and friction springs refer to: lower-case letters, digits and hyphens."""
    shape: AnyShape
    motion: SurfaceMotion = AT_REST
    # where it is not stated it is left out of what is stored
    opens: Annotated[
        Annotated[float | str, OrWord(Duration, START)] | None, Field(exclude_if=lambda opens: opens is None)
    ] = None
    """`start`: the wall stands while the container is filled and vanishes when the discharge starts; a time: it
    vanishes so long after that start (parts of kind `mesh`). None: it stays."""
    moves: Annotated[PartMotion | None, Field(exclude_if=lambda moves: moves is None)] = None
    """Motion of the whole part, of kind `mesh`, from the opening on; while the container is filled it stands still."""

    @model_validator(mode="after")
    def _moves_along_itself(self, info: ValidationInfo):
        if (info.context or {}).get("units") == "required":  # runs of older versions stay readable
            refuse(self._faults())
        if self.moves is not None and not isinstance(self.shape, TriangleMesh):
            reason = f"a {self.shape.kind} cannot move: only walls of triangles do"
            refuse([Fault("moves", reason, "leave moves out, or make it a part of kind mesh")])
        if self.removal is not None and not isinstance(self.shape, TriangleMesh):
            reason = f"a {self.shape.kind} vanishes at the start or never: only walls of triangles do at a later time"
            refuse([Fault("opens", reason, "state opens: start, or make it a part of kind mesh")])
        return self

    @property
    def removal(self) -> float | None:
        """Time [s] after the start of the discharge at which the wall vanishes; None: at the start, or never."""
        return self.opens if isinstance(self.opens, float) else None

    @property
    def is_posed(self) -> bool:
        """True if the wall moves as a whole, or vanishes at a time of the discharge."""
        return self.moves is not None or self.removal is not None

    def poses(self, times: np.ndarray) -> Poses:
        """Compute the poses of the wall.

        Args:
            times: Times since the opening [s], shape [n].

        Returns:
            Poses; out of reach once the wall has vanished.
        """
        times = np.asarray(times, float)
        poses = Poses.at_rest(len(times)) if self.moves is None else self.moves.poses(times)
        if self.removal is None:
            return poses
        return poses._replace(shift=poses.shift + OUT_OF_REACH * (times >= self.removal)[:, None])

    @property
    def is_static(self) -> bool:
        """True if neither the wall nor its surface moves."""
        return self.moves is None and self.motion == AT_REST

    def speed(self, reach: float) -> float:
        """Bound the speed of the wall at grains.

        Args:
            reach: Distance of the farthest grain from the axis x = y = 0 [m].

        Returns:
            Largest speed [m/s].
        """
        if self.moves is None or not isinstance(self.shape, TriangleMesh):
            return self.motion.speed(reach)
        return self.motion.speed(reach) + self.moves.speed(self.shape.surface.vertices, 0.0)

    def _faults(self) -> Iterator[Fault]:
        if self.motion == AT_REST:
            return
        normal_speed = self.shape.normal_speed(self.motion)
        if normal_speed is None:
            reason = f"a surface motion of a {self.shape.kind} cannot be checked: the shape has no normal_speed"
            yield Fault("motion", reason, "leave motion out, or add normal_speed to the shape")
        elif normal_speed > 0:
            key, remedy = "velocity", "keep the components along the wall"
            part = f"has a component of {normal_speed:g} m/s along the wall's normal"
            if math.isinf(normal_speed):
                key, part = "spin", "turns the surface out of itself"
                remedy = "spin only horizontal planes and strips, or frustums"
            reason = f"the motion is that of the surface only, the wall itself stays, and this {key} {part}"
            yield Fault(f"motion.{key}", reason, f"{remedy}; parts of kind mesh move as a whole by `moves`")
