"""Upright cylinders with a round outlet: with a flat bottom, or above a cone."""

import math
from abc import ABC
from collections.abc import Iterator
from functools import lru_cache
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import model_validator

from labbook.scene.container_shape import CACHE_SIZE, FLAT, ContainerShape, Outlet, Parts, frustum_wall
from labbook.scene.geometry import Bounds
from labbook.scene.model import Fault, InternalFlag, refuse
from labbook.scene.quantities import Angle, Frequency, Length
from labbook.scene.thick_plate import OptionalLip
from labbook.scene.walls import AT_REST, Frustum, SurfaceMotion, Symmetry, Wall


class RoundSilo(ContainerShape, ABC):
    """Base of upright cylinders with a round outlet on the axis, whatever their bottom."""

    symmetry: ClassVar[Symmetry | None] = "axial"
    widths: ClassVar[tuple[str, ...]] = ("diameter",)
    at_least_a_grain: ClassVar[tuple[str, ...]] = ("orifice", "diameter")
    if TYPE_CHECKING:  # fields of each
        diameter: float
        height: float
        orifice: float
        lip: OptionalLip

    @property
    def outlet_plane(self) -> float:
        """Height z of the outlet [m]: 0."""
        return 0.0

    @property
    def outlets(self) -> tuple[Outlet, ...]:
        """Hole on the axis."""
        lid = Frustum.of(kind="frustum", lower=(0.0, 0.0), upper=(self.orifice / 2, 0.0))
        return (Outlet("outlet", 0.0, "hole", self.orifice, 0.0, lid),)

    @property
    def bounds(self) -> Bounds:
        """Box around the cylinder, from the outlet to its height [m]."""
        r = self.diameter / 2
        return Bounds((-r, -r, 0.0), (r, r, self.height))

    @property
    def across(self) -> float:
        """Inner diameter [m]."""
        return self.diameter

    @property
    def area(self) -> float:
        """Area pi D_c^2/4 [m^2]."""
        return math.pi / 4 * self.diameter**2

    @property
    def roof(self) -> float:
        """Height z of the upper end of the cylinder [m]."""
        return self.height

    def lets_out(self, x: np.ndarray, slack: float = 0.0) -> np.ndarray:
        """Mask of centres within the outlet, whose size is exact."""
        wider = 0.0 if self.lip is None else self.lip.widening(self._bottom_angle)
        return np.hypot(x[:, 0], x[:, 1]) <= self.orifice / 2 + wider

    @property
    def edge_height(self) -> float:
        """Height [m] of the lip below the outlet's plane; 0 without one."""
        return 0.0 if self.lip is None or self.closed else self.lip.height(self._bottom_angle)

    @property
    def _bottom_angle(self) -> float:
        """Angle of the bottom from the vertical [rad]."""
        return math.pi / 2

    def _faults_of_lip(self, angle: float) -> Iterator[Fault]:
        """Faults of a lip; a thin one is taken away."""
        if self.lip is None or self.orifice >= self.diameter:
            return
        if self.lip.is_thin:
            object.__setattr__(self, "lip", None)
        else:
            yield from self.lip.faults(angle, (self.diameter - self.orifice) / 2 / math.sin(angle))

    def _bottom(self, rim: tuple[float, float], upper: tuple[float, float], motion: SurfaceMotion = AT_REST) -> Wall:
        """Bottom from its rim at the outlet to the cylinder, with the lip if there is one."""
        if self.lip is None:
            return frustum_wall("bottom", rim, upper, motion)
        shape = self.lip.plate(upper, rim, turned=True)
        return Wall.of(name="bottom", shape=shape, motion=motion, opens=None, moves=None)


class CylinderSilo(RoundSilo):
    """Upright cylinder with a round outlet in the middle of its flat bottom, which may rotate (Pongó et al. 2022)."""

    spin_key: ClassVar[str | None] = "rotation"

    own_walls: ClassVar[tuple[str, ...]] = ("side", "bottom")

    kind: Literal["cylinder-silo"] = "cylinder-silo"
    diameter: Length
    """Inner diameter D_c of the cylinder."""
    height: Length
    """Height of the cylinder above the outlet; grains may start above it."""
    orifice: Length
    """Diameter D of the outlet, less than the cylinder's; with a lip at its narrowest."""
    lip: OptionalLip = None
    """Rounded or thick edge of the outlet; none: the bottom is a thin plate."""
    rotation: Frequency = 0.0
    """Rotation frequency f of the bottom after the opening; positive is counter-clockwise seen from above."""
    closed: InternalFlag = False
    parts: Parts = ()
    """Walls that are listed one by one, beside those that the kind has of itself."""

    @model_validator(mode="after")
    def _is_possible(self):
        refuse([*_orifice_faults(self.orifice, self.diameter), *self._faults_of_lip(math.pi / 2)])
        return self

    def volume_below(self, z: float) -> float:
        """Volume pi D_c^2 z/4 [m^3]."""
        return self.area * z

    def span(self, z: float) -> tuple[float, float]:
        """Ends -D_c/2 and D_c/2 [m]."""
        return -self.diameter / 2, self.diameter / 2

    def inside(self, x: np.ndarray) -> np.ndarray:
        """Mask of the centres x [m], shape [n, 3], between the walls, shape [n]; above them too."""
        return (np.hypot(x[:, 0], x[:, 1]) <= self.diameter / 2) & (x[:, 2] >= 0) & self._clear_of_parts(x)

    def close(self, surface_motion: bool = False) -> "CylinderSilo":
        """Close the silo: it has no outlet, and its bottom turns only with `surface_motion`."""
        rotation = self.rotation if surface_motion else 0.0
        return self._closed(surface_motion, orifice=self.diameter / 2, rotation=rotation, lip=None)

    @lru_cache(maxsize=CACHE_SIZE)  # noqa: B019  (at most so many)
    def walls(self) -> tuple[Wall, ...]:
        """Frustums side, and bottom round the outlet (closed: all of it)."""
        radius, hole = self.diameter / 2, 0.0 if self.closed else self.orifice / 2
        top = 2000 * self.diameter if self.closed else self.height
        turning = SurfaceMotion(spin=2 * math.pi * self.rotation)
        own = (
            frustum_wall("side", (radius, 0.0), (radius, top)),
            self._bottom((hole, 0.0), (radius, 0.0), turning),
        )
        return self._with_parts(own)


class ConicalSilo(RoundSilo):
    """Upright cylinder above a cone, with a round outlet at the cone's tip."""

    own_walls: ClassVar[tuple[str, ...]] = ("side", "bottom", "lid")

    kind: Literal["conical-silo"] = "conical-silo"
    diameter: Length
    """Inner diameter D_c of the cylinder."""
    height: Length
    """Height of the cylinder's upper end above the outlet; grains may start above it."""
    angle: Angle
    """Angle of the cone from the vertical, at least 1 deg and less than 90 deg."""
    orifice: Length
    """Diameter D of the outlet, less than the cylinder's; with a lip at its narrowest."""
    lip: OptionalLip = None
    """Rounded or thick edge of the outlet; none: the cone is a thin plate."""
    closed: InternalFlag = False
    parts: Parts = ()
    """Walls that are listed one by one, beside those that the kind has of itself."""

    @model_validator(mode="after")
    def _is_possible(self):
        refuse(self._faults())
        return self

    def _faults(self) -> Iterator[Fault]:
        yield from _orifice_faults(self.orifice, self.diameter)
        if not math.radians(1) * (1 - FLAT) <= self.angle <= math.pi / 2 - 1e-3:
            reason = f"the angle of the cone from the vertical cannot be {math.degrees(self.angle):g} deg"
            yield Fault("angle", reason, "use 1 deg to less than 90 deg; a flat bottom is a cylinder-silo")
        elif self.orifice < self.diameter and self.rise >= self.height:
            rise = f"{self.rise * 1e3:g} mm"
            reason = f"the cone rises {rise} and leaves no cylinder"
            yield Fault("height", reason, f"make the silo higher than {rise}, or the angle larger")
        else:
            yield from self._faults_of_lip(self.angle)

    @property
    def _bottom_angle(self) -> float:
        """Angle of the cone from the vertical [rad]."""
        return self.angle

    @property
    def rise(self) -> float:
        """Height of the cone [m]."""
        return (self.diameter - self.orifice) / 2 / math.tan(self.angle)

    def volume_below(self, z: float) -> float:
        """Volume of a truncated cone and, above it, of the cylinder [m^3]."""
        slope, r, R, cone = math.tan(self.angle), self.orifice / 2, self.diameter / 2, min(z, self.rise)
        return math.pi * ((r + slope * cone) ** 3 - r**3) / (3 * slope) + math.pi * R**2 * (z - cone)

    def span(self, z: float) -> tuple[float, float]:
        """Ends -r and r of the cone or the cylinder at the height z [m]."""
        reach = min(self.diameter / 2, self.orifice / 2 + math.tan(self.angle) * z)
        return -reach, reach

    def inside(self, x: np.ndarray) -> np.ndarray:
        """Mask of the centres x [m], shape [n, 3], between the walls, shape [n]; above them too."""
        r = np.hypot(x[:, 0], x[:, 1])
        bottom = np.maximum(r - self.orifice / 2, 0) / math.tan(self.angle)
        return (r <= self.diameter / 2) & (x[:, 2] >= bottom) & self._clear_of_parts(x)

    def close(self, surface_motion: bool = False) -> "ConicalSilo":
        """Close the silo with a lid over its outlet."""
        return self._closed(surface_motion, lip=None)

    @lru_cache(maxsize=CACHE_SIZE)  # noqa: B019  (at most so many)
    def walls(self) -> tuple[Wall, ...]:
        """Frustums side, bottom, which is the cone, and closed a lid."""
        radius, hole, rise = self.diameter / 2, self.orifice / 2, self.rise
        top = 2000 * self.diameter if self.closed else self.height
        walls = (
            frustum_wall("side", (radius, rise), (radius, top)),
            self._bottom((hole, 0.0), (radius, rise)),
        )
        return self._with_parts((*walls, frustum_wall("lid", (0.0, 0.0), (hole, 0.0))) if self.closed else walls)


def _orifice_faults(orifice: float, diameter: float) -> Iterator[Fault]:
    if orifice >= diameter * (1 - 2e-9):
        reason = f"the orifice is not narrower than the silo ({orifice * 1e3:g} mm against {diameter * 1e3:g} mm)"
        yield Fault("orifice", reason, "make the orifice smaller or the silo wider")
