"""Plate with a thick, rounded edge, and the lip of a container's outlet that is such a plate."""

import itertools
import math
from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, StrictBool, model_validator

from labbook.scene.geometry import AROUND, Bounds, Mesh, Segment, above_line, from_segment
from labbook.scene.model import Fault, Model, refuse
from labbook.scene.quantities import Coordinate, Distance, Length
from labbook.scene.wall_shape import SurfaceMotion, Symmetry, WallShape

Point2 = tuple[Coordinate, Coordinate]
_ARC = math.radians(7.5)
"""Largest turn of the profile of a rounded edge between two lines of a picture."""


class ThickPlate(WallShape):
    """All points within `radius` of a middle line, which goes from `far` to `edge` and then down to `foot`.

    The line lies in the x-z plane and is continued along y; `turned`: it lies in the plane of radius and height and is
    rotated about the vertical axis x = y = 0. Grains are spheres or clumps, on the outer side of the bend. A sphere has
    one contact with it, also at the edge.
    """

    spheres_only: ClassVar[bool] = True

    kind: Literal["thick-plate"] = "thick-plate"
    far: Point2
    """x, or radius, and z of the end of the middle line that is away from the edge."""
    edge: Point2
    """x, or radius, and z of the bend at the edge."""
    foot: Point2
    """x, or radius, and z of the lower end of the edge; that of `edge` if there is no more of it."""
    radius: Distance
    """Distance of the surface from the middle line, which is the radius of the rounded edge; 0: a sharp edge."""
    turned: StrictBool = False
    """Rotated about the vertical axis, as the bottom of a cylinder."""

    @model_validator(mode="after")
    def _has_a_length(self):
        if self.far == self.edge:
            refuse([Fault("edge", "the plate has no length", "set far and edge apart")])
        if self.turned and min(self.far[0], self.edge[0], self.foot[0]) < 0:
            refuse([Fault("far", "a radius cannot be negative", "use radii of 0 or more")])
        return self

    def distance(self, x: np.ndarray) -> np.ndarray:
        """Distance [m] of points x, shape [n, 3], from the surface; negative within the plate."""
        section = np.column_stack([np.hypot(x[:, 0], x[:, 1]) if self.turned else x[:, 0], x[:, 2]])
        away = from_segment(section, self.far, self.edge)
        if self.foot != self.edge:
            away = np.minimum(away, from_segment(section, self.edge, self.foot))
        return away - self.radius

    def normal_speed(self, motion: SurfaceMotion) -> float:
        """Speed along the normal [m/s]: 0 of a spin about its own axis, else infinite."""
        return 0.0 if self.turned and not any(motion.velocity) else math.inf

    @property
    def upper_side(self) -> Segment:
        """Straight part (x, z) [m] of the upper side, from the far end to where the edge begins to bend."""
        (u, z), (nu, nz) = self.far, self._upwards
        r, (u1, z1) = self.radius, self.edge
        return (u + r * nu, z + r * nz), (u1 + r * nu, z1 + r * nz)

    @property
    def _upwards(self) -> tuple[float, float]:
        """Unit normal (x, z) of the upper side."""
        (u0, z0), (u1, z1) = self.far, self.edge
        length = math.hypot(u1 - u0, z1 - z0)
        nu, nz = (z0 - z1) / length, (u1 - u0) / length
        return (nu, nz) if nz >= 0 else (-nu, -nz)

    @property
    def bounds(self) -> Bounds:
        """Box around it [m], without end along y unless it is rotated."""
        (u0, u1), (low, high) = (
            (min(ends) - self.radius, max(ends) + self.radius)
            for ends in zip(self.far, self.edge, self.foot, strict=True)
        )
        if self.turned:
            return Bounds((-u1, -u1, low), (u1, u1, high))
        return Bounds((u0, -math.inf, low), (u1, math.inf, high))

    @property
    def symmetries(self) -> frozenset[Symmetry]:
        """Symmetry: axial if it is rotated, else planar."""
        return frozenset(["axial" if self.turned else "planar"])

    @property
    def ground(self) -> float:
        """Height z [m] of the lower end of the upper side."""
        return min(z for _, z in self.upper_side)

    @property
    def prismatic_above(self) -> float:
        """Height z [m] of its upper end."""
        return self.bounds.high[2]

    def _across(self, x: np.ndarray) -> np.ndarray:
        return np.hypot(x[:, 0], x[:, 1]) if self.turned else x[:, 0]

    def carries(self, x: np.ndarray) -> np.ndarray:
        """Mask of points straight above the upper side, shape [n]."""
        return above_line(*self.upper_side, self._across(x), x[:, 2])[0]

    def covers(self, x: np.ndarray) -> np.ndarray:
        """Mask of points straight below the upper side, shape [n]."""
        return above_line(*self.upper_side, self._across(x), x[:, 2])[1]

    @property
    def profile(self) -> tuple[Point2, ...]:
        """Corners (x, z) [m] of its surface from the far end of the upper side, round the edge, to below the foot."""
        (nu, nz), r = self._upwards, self.radius
        start = math.atan2(nz, nu)
        # round the edge the normal turns from that of the upper side to downwards, on the side away from the far end
        left = self.far[0] > self.edge[0]  # the outlet is at the left
        end = 1.5 * math.pi if left else -0.5 * math.pi
        corners = [self.upper_side[0]]
        turns = max(1, math.ceil(abs(end - start) / _ARC)) if r > 0 else 1
        upright = math.pi if left else 0.0
        angles = sorted({upright, *(start + (end - start) * k / turns for k in range(turns + 1))}, reverse=not left)
        for angle in angles:
            centres = [self.edge, self.foot] if angle == upright else [
                self.foot if (angle > upright) == left else self.edge
            ]  # fmt: skip
            for u, z in centres:
                corners.append((u + r * math.cos(angle), z + r * math.sin(angle)))
        return tuple(dict.fromkeys(corners))

    def section(self, within: Bounds | None = None) -> tuple[Segment, ...]:
        """Lines (x, z) [m] of the upper side and the edge, on both sides of the axis if it is rotated."""
        profile = self.profile
        lines = tuple(itertools.pairwise(profile))
        if not self.turned:
            return lines
        return (*lines, *(((-a[0], a[1]), (-b[0], b[1])) for a, b in lines))

    def mesh(self, within: Bounds) -> Mesh | None:
        """Frustums of polygons, or rectangles as deep as the box."""
        profile = self.profile
        if self.turned:
            lines = list(itertools.pairwise(profile))
            return Mesh.joined([Mesh.turned(line, AROUND) for line in lines])
        front, back = within.low[1], within.high[1]
        plates = []
        for (u, z), (u1, z1) in itertools.pairwise(profile):
            corners = np.array([(u, front, z), (u1, front, z1), (u1, back, z1), (u, back, z)])
            plates.append(Mesh.polygon(corners, outlined=False))
        return Mesh.joined(plates)

    @property
    def reach(self) -> float:
        """Largest distance from the axis [m]."""
        bounds = self.bounds
        return bounds.high[0] if self.turned else math.inf

    def mirrored(self) -> "ThickPlate":
        """Mirror image in x = 0."""
        if self.turned:
            return self
        far, edge, foot = ((-x, z) for x, z in (self.far, self.edge, self.foot))
        return ThickPlate(far=far, edge=edge, foot=foot, radius=self.radius)


class Lip(Model):
    """Edge of an outlet that is rounded and as thick as a plate; without it the plate is thin and its edge sharp."""

    radius: Distance = 0.0
    """Radius of the rounded edge; 0: it is sharp."""
    thickness: Length | None = None
    """Height of the edge from the outlet's plane to its lower end, also rounded; none: as little as the radius allows,
    twice the radius of a flat bottom."""

    @property
    def is_thin(self) -> bool:
        """True if it changes nothing: a sharp edge without a thickness."""
        return self.radius == 0 and self.thickness is None

    def height(self, angle: float) -> float:
        """Height [m] of the edge below the outlet's plane.

        Args:
            angle: Angle of the bottom from the vertical [rad].
        """
        return self._least(angle) if self.thickness is None else self.thickness

    def _least(self, angle: float) -> float:
        return self.radius * (1 + math.tan(angle / 2))

    def widening(self, angle: float) -> float:
        """Distance [m] by which the outlet is wider in its plane than at its narrowest, on each side."""
        return self.radius * (1 - math.sqrt(max(0.0, 1 - math.tan(angle / 2) ** 2)))

    def faults(self, angle: float, room: float) -> Iterator[Fault]:
        """Yield faults of the lip.

        Args:
            angle: Angle of the bottom from the vertical [rad].
            room: Length of the shortest plate of the bottom, along its slope [m].
        """
        least, begins = self._least(angle), self.radius * math.tan(angle / 2)
        if self.thickness is not None and self.thickness < least * (1 - 1e-9):
            reason = f"an edge of {1e3 * self.thickness:g} mm has no room for a radius of {1e3 * self.radius:g} mm"
            yield Fault("lip.thickness", reason, f"use at least {1e3 * least:.6g} mm, or a smaller radius")
        if begins >= room * (1 - 1e-9):
            reason = f"a rounded edge of {1e3 * self.radius:g} mm leaves nothing of the bottom"
            yield Fault("lip.radius", reason, f"use less than {1e3 * room / math.tan(angle / 2):.6g} mm")

    def plate(self, far: Point2, edge: Point2, turned: bool) -> ThickPlate:
        """Make the plate of a bottom that ends in this lip.

        The upper side lies on the line of the bottom, and the upright part of the edge at the outlet's own edge.

        Args:
            far: Place (x or radius, z) of the end of the bottom away from the outlet [m].
            edge: Place of its edge at the outlet [m].
            turned: It is a round bottom.

        Returns:
            The plate.
        """
        out = math.copysign(1.0, far[0] - edge[0])
        angle, r = math.atan2(abs(far[0] - edge[0]), far[1] - edge[1]), self.radius
        bend = edge[0] + out * r, edge[1] - r * math.tan(angle / 2)
        foot = bend if self.thickness is None else (bend[0], min(bend[1], edge[1] - self.thickness + r))
        middle = far[0] + out * r * math.cos(angle), far[1] - r * math.sin(angle)
        return ThickPlate.of(kind="thick-plate", far=middle, edge=bend, foot=foot, radius=r, turned=turned)


OptionalLip = Annotated[Lip | None, Field(exclude_if=lambda lip: lip is None)]
"""Lip of a container; left out of what is stored where there is none."""
