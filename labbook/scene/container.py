"""Containers: what a study names (`wedge-hopper`, `cylinder-silo`), turned into wall primitives.

Each container knows its walls when open and when closed. A closed container's outlet carries a lid and its
side walls reach up as far as a filling needs, so that flat-bottomed silos that differ only in their outlets
are the same closed container, and share packings.
"""

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, StrictBool, model_validator

from labbook.scene.model import Fault, InternalFlag, Model, refuse
from labbook.scene.quantities import Angle, Coordinate, Distance, Frequency, Length, told_apart
from labbook.scene.walls import AT_REST, Frustum, Plane, Strip, SurfaceMotion, Wall

Pair = tuple[float, float]
Vector = tuple[float, float, float]
KEPT = 256
"""Containers whose walls are kept: each is asked for them again and again, one after another."""
_FLAT = 1e-12  # rad: an angle this close to 90 deg is a flat bottom


# what a container of validated sizes is made of needs no validation: 100 000 points have more than a million walls
@lru_cache(maxsize=KEPT)  # many containers have these in common
def _plane(name: str, point: Vector, normal: Vector) -> Wall:
    return Wall.of(name=name, shape=Plane.of(kind="plane", point=point, normal=normal), motion=AT_REST, opens=None)


def _strip(name: str, start: Pair, end: Pair) -> Wall:
    return Wall.of(name=name, shape=Strip.of(kind="strip", start=start, end=end), motion=AT_REST, opens=None)


def _frustum(name: str, lower: Pair, upper: Pair, motion: SurfaceMotion = AT_REST) -> Wall:
    shape = Frustum.of(kind="frustum", lower=lower, upper=upper)
    return Wall.of(name=name, shape=shape, motion=motion, opens=None)


class WedgeHopper(Model):
    """Quasi-2D silo between a front and a back wall (Fan et al. 2023, Fig. 1).

    Its outlet lies at the foot of a bottom whose plates are inclined by the same angle.
    """

    kind: Literal["wedge-hopper"] = "wedge-hopper"
    width: Length
    """Inner width L between the side walls."""
    height: Length
    """Height H of the side walls above the outlet; grains may start above it."""
    thickness: Length
    """Distance Z between the front and the back wall."""
    angle: Angle = math.pi / 2
    """Angle α of the bottom from the vertical, 1 to 90 deg: 90 deg is flat, 15 deg a steep funnel."""
    orifice: Length
    """Width D of the outlet, less than the width of the hopper."""
    gap: Distance | None = None
    """Gap s from the left side wall to the near edge of the outlet, at most (L - D)/2; none: centred."""
    closed: InternalFlag = False

    @model_validator(mode="after")
    def _is_possible(self):
        refuse(self._faults())
        return self

    def _faults(self) -> Iterator[Fault]:
        angle_fits = math.radians(1) * (1 - _FLAT) <= self.angle <= math.pi / 2 + _FLAT
        if not angle_fits:
            reason = f"the angle of the bottom from the vertical cannot be {math.degrees(self.angle):g} deg"
            yield Fault("angle", reason, "use 1 to 90 deg; 90 deg is a flat bottom")
        limit = (self.width - self.orifice) / 2
        if limit <= 1e-9 * self.width:
            sizes = f"{self.orifice * 1e3:g} mm against {self.width * 1e3:g} mm"
            reason = f"the orifice is not narrower than the hopper ({sizes})"
            yield Fault("orifice", reason, "make the orifice smaller or the hopper wider")
            return
        if self.gap is not None and self.gap > limit * (1 + 1e-12):
            gap, most = told_apart(self.gap * 1e3, limit * 1e3, digits=6)
            reason = f"a gap of {gap} mm is beyond (L - D)/2 = {most} mm"
            mirrored = 2 * limit - self.gap
            mirror = f", or {mirrored * 1e3:g} mm, of which it is the mirror image" if mirrored >= 0 else ""
            yield Fault("gap", reason, f"use at most {limit * 1e3:g} mm{mirror}")
            return
        if angle_fits and max(self._rises) >= self.height:
            rise = f"{max(self._rises) * 1e3:g} mm"
            reason = f"the inclined bottom rises {rise} and leaves no side wall"
            yield Fault("height", reason, f"make the hopper higher than {rise}, or the angle larger")

    @property
    def flat(self) -> bool:
        """Whether the bottom is flat."""
        return abs(self.angle - math.pi / 2) <= _FLAT

    @property
    def eccentricity(self) -> float:
        """e [m]: from the hopper's axis to the centre of the outlet; negative is to the left."""
        return 0.0 if self.gap is None else self.gap + self.orifice / 2 - self.width / 2

    @property
    def outlet(self) -> tuple[float, float]:
        """x [m] of the left and right edge of the outlet."""
        e = self.eccentricity
        return e - self.orifice / 2, e + self.orifice / 2

    @property
    def outlet_plane(self) -> float:
        """z [m] of the plane through which grains leave."""
        return 0.0

    @property
    def _rises(self) -> tuple[float, float]:
        """Heights [m] that the left and the right bottom plate rise from the outlet to the side walls."""
        left, right = self.outlet
        cot = 0.0 if self.flat else 1 / math.tan(self.angle)
        return (left + self.width / 2) * cot, (self.width / 2 - right) * cot

    @property
    def top(self) -> float:
        """z [m] up to which the side walls reach: `height`; closed, as high as any filling (2000 widths)."""
        return 2000 * self.width if self.closed else self.height

    def holds(self, x: np.ndarray) -> np.ndarray:
        """Which of the centres x [m], shape [n, 3], lie between the walls, shape [n]; above them too."""
        (left, right), cot = self.outlet, 0.0 if self.flat else 1 / math.tan(self.angle)
        bottom = np.maximum(np.maximum(left - x[:, 0], x[:, 0] - right), 0) * cot
        return (np.abs(x[:, 0]) <= self.width / 2) & (np.abs(x[:, 1]) <= self.thickness / 2) & (x[:, 2] >= bottom)

    def lets_out(self, x: np.ndarray) -> np.ndarray:
        """Which of the centres x [m], shape [n, 3], of grains that pass the outlet's plane do so in the outlet."""
        left, right = self.outlet
        return (x[:, 0] >= left) & (x[:, 0] <= right) & (np.abs(x[:, 1]) <= self.thickness / 2)

    def close(self, surface_motion: bool = False) -> "WedgeHopper":
        """The closed container in which a packing is made; flat bottoms lose their outlet altogether."""
        if self.flat:
            return self.model_copy(
                update={"closed": True, "orifice": self.width / 2, "gap": None, "angle": math.pi / 2}
            )
        return self.model_copy(update={"closed": True})

    @lru_cache(maxsize=KEPT)  # noqa: B019  (at most so many)
    def walls(self) -> tuple[Wall, ...]:
        """Wall primitives: front, back, left, right, and the bottom plates (closed: with the lid)."""
        half, depth = self.width / 2, self.thickness / 2
        (left, right), (rise_left, rise_right), top = self.outlet, self._rises, self.top
        walls = [
            _plane("front", (0.0, -depth, 0.0), (0.0, 1.0, 0.0)),
            _plane("back", (0.0, depth, 0.0), (0.0, -1.0, 0.0)),
            _strip("left", (-half, rise_left), (-half, top)),
            _strip("right", (half, rise_right), (half, top)),
        ]
        if self.closed and self.flat:
            return (*walls, _strip("bottom", (-half, 0.0), (half, 0.0)))
        if left > -half * (1 - 1e-12):  # a gap of 0 has no left plate
            walls.append(_strip("bottom-left", (-half, rise_left), (left, 0.0)))
        walls.append(_strip("bottom-right", (right, 0.0), (half, rise_right)))
        if self.closed:
            walls.append(_strip("lid", (left, 0.0), (right, 0.0)))
        return tuple(walls)


class CylinderSilo(Model):
    """Upright cylinder with a round outlet in the middle of its flat bottom, which may rotate (Pongó et al. 2022)."""

    kind: Literal["cylinder-silo"] = "cylinder-silo"
    diameter: Length
    """Inner diameter D_c of the cylinder."""
    height: Length
    """Height of the cylinder above the outlet; grains may start above it."""
    orifice: Length
    """Diameter D of the outlet, less than the cylinder's."""
    rotation: Frequency = 0.0
    """Rotation frequency f of the bottom after the opening; positive is counter-clockwise seen from above."""
    closed: InternalFlag = False

    @model_validator(mode="after")
    def _is_possible(self):
        refuse(_orifice_faults(self.orifice, self.diameter))
        return self

    @property
    def outlet_plane(self) -> float:
        """z [m] of the plane through which grains leave."""
        return 0.0

    def holds(self, x: np.ndarray) -> np.ndarray:
        """Which of the centres x [m], shape [n, 3], lie between the walls, shape [n]; above them too."""
        return (np.hypot(x[:, 0], x[:, 1]) <= self.diameter / 2) & (x[:, 2] >= 0)

    def lets_out(self, x: np.ndarray) -> np.ndarray:
        """Which of the centres x [m], shape [n, 3], of grains that pass the outlet's plane do so in the outlet."""
        return np.hypot(x[:, 0], x[:, 1]) <= self.orifice / 2

    def close(self, surface_motion: bool = False) -> "CylinderSilo":
        """The closed container in which a packing is made; it has no outlet, and its bottom turns only if
        `surface_motion` says so."""
        rotation = self.rotation if surface_motion else 0.0
        return self.model_copy(update={"closed": True, "orifice": self.diameter / 2, "rotation": rotation})

    @lru_cache(maxsize=KEPT)  # noqa: B019  (at most so many)
    def walls(self) -> tuple[Wall, ...]:
        """Wall primitives: side, and the bottom round the outlet (closed: all of it)."""
        radius, hole = self.diameter / 2, 0.0 if self.closed else self.orifice / 2
        top = 2000 * self.diameter if self.closed else self.height
        turning = SurfaceMotion(spin=2 * math.pi * self.rotation)
        return (
            _frustum("side", (radius, 0.0), (radius, top)),
            _frustum("bottom", (hole, 0.0), (radius, 0.0), turning),
        )


class ConicalSilo(Model):
    """Upright cylinder above a cone, with a round outlet at the cone's tip."""

    kind: Literal["conical-silo"] = "conical-silo"
    diameter: Length
    """Inner diameter D_c of the cylinder."""
    height: Length
    """Height of the cylinder's upper end above the outlet; grains may start above it."""
    angle: Angle
    """Angle of the cone from the vertical, at least 1 deg and less than 90 deg."""
    orifice: Length
    """Diameter D of the outlet, less than the cylinder's."""
    closed: InternalFlag = False

    @model_validator(mode="after")
    def _is_possible(self):
        refuse(self._faults())
        return self

    def _faults(self) -> Iterator[Fault]:
        yield from _orifice_faults(self.orifice, self.diameter)
        if not math.radians(1) * (1 - _FLAT) <= self.angle <= math.pi / 2 - 1e-3:
            reason = f"the angle of the cone from the vertical cannot be {math.degrees(self.angle):g} deg"
            yield Fault("angle", reason, "use 1 deg to less than 90 deg; a flat bottom is a cylinder-silo")
        elif self.orifice < self.diameter and self.rise >= self.height:
            rise = f"{self.rise * 1e3:g} mm"
            reason = f"the cone rises {rise} and leaves no cylinder"
            yield Fault("height", reason, f"make the silo higher than {rise}, or the angle larger")

    @property
    def rise(self) -> float:
        """Height of the cone [m]."""
        return (self.diameter - self.orifice) / 2 / math.tan(self.angle)

    @property
    def outlet_plane(self) -> float:
        """z [m] of the plane through which grains leave."""
        return 0.0

    def holds(self, x: np.ndarray) -> np.ndarray:
        """Which of the centres x [m], shape [n, 3], lie between the walls, shape [n]; above them too."""
        off = np.hypot(x[:, 0], x[:, 1])
        bottom = np.maximum(off - self.orifice / 2, 0) / math.tan(self.angle)
        return (off <= self.diameter / 2) & (x[:, 2] >= bottom)

    def lets_out(self, x: np.ndarray) -> np.ndarray:
        """Which of the centres x [m], shape [n, 3], of grains that pass the outlet's plane do so in the outlet."""
        return np.hypot(x[:, 0], x[:, 1]) <= self.orifice / 2

    def close(self, surface_motion: bool = False) -> "ConicalSilo":
        """The closed container in which a packing is made, with a lid over its outlet."""
        return self.model_copy(update={"closed": True})

    @lru_cache(maxsize=KEPT)  # noqa: B019  (at most so many)
    def walls(self) -> tuple[Wall, ...]:
        """Wall primitives: side, the cone, called bottom, and closed a lid."""
        radius, hole, rise = self.diameter / 2, self.orifice / 2, self.rise
        top = 2000 * self.diameter if self.closed else self.height
        walls = (
            _frustum("side", (radius, rise), (radius, top)),
            _frustum("bottom", (hole, 0.0), (radius, rise)),
        )
        return (*walls, _frustum("lid", (0.0, 0.0), (hole, 0.0))) if self.closed else walls


def _orifice_faults(orifice: float, diameter: float) -> Iterator[Fault]:
    if orifice >= diameter * (1 - 2e-9):
        reason = f"the orifice is not narrower than the silo ({orifice * 1e3:g} mm against {diameter * 1e3:g} mm)"
        yield Fault("orifice", reason, "make the orifice smaller or the silo wider")


class Box(Model):
    """Box, centred in x and y, with its bottom at z = 0; `lid` closes its top."""

    kind: Literal["box"] = "box"
    width: Length
    """Inner size along x."""
    depth: Length
    """Inner size along y."""
    height: Length
    """Inner size along z."""
    lid: StrictBool = False
    """Whether a plane closes the top."""
    closed: InternalFlag = False

    @property
    def outlet_plane(self) -> float | None:
        """A box has no outlet."""
        return None

    def holds(self, x: np.ndarray) -> np.ndarray:
        """Which of the centres x [m], shape [n, 3], lie between the walls, shape [n]; without a lid above them too."""
        beside = (np.abs(x[:, 0]) <= self.width / 2) & (np.abs(x[:, 1]) <= self.depth / 2)
        return beside & (x[:, 2] >= 0) & ((x[:, 2] <= self.height) | (not self.lid))

    def lets_out(self, x: np.ndarray) -> np.ndarray:
        """None: a box has no outlet."""
        return np.zeros(len(x), bool)

    def close(self, surface_motion: bool = False) -> "Box":
        """The box as a packing is made in it: without a lid, since grains may start above."""
        return self.model_copy(update={"closed": True, "lid": False})

    @lru_cache(maxsize=KEPT)  # noqa: B019  (at most so many)
    def walls(self) -> tuple[Wall, ...]:
        """Wall primitives: left, right, front, back, bottom and, if asked for, top."""
        w, d = self.width / 2, self.depth / 2
        sides = {
            "left": ((-w, 0.0, 0.0), (1.0, 0.0, 0.0)),
            "right": ((w, 0.0, 0.0), (-1.0, 0.0, 0.0)),
            "front": ((0.0, -d, 0.0), (0.0, 1.0, 0.0)),
            "back": ((0.0, d, 0.0), (0.0, -1.0, 0.0)),
            "bottom": ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        }
        if self.lid:
            sides["top"] = ((0.0, 0.0, self.height), (0.0, 0.0, -1.0))
        return tuple(_plane(name, point, normal) for name, (point, normal) in sides.items())


class Primitives(Model):
    """Walls listed one by one; without walls: free space. Parts that open at the start stand only in the closed one."""

    kind: Literal["primitives"] = "primitives"
    parts: tuple[Wall, ...] = ()
    """The walls."""
    outlet_plane: Coordinate | None = None
    """Height z at which grains count as discharged; none: there is no outlet."""
    # only of those closed by parts that open; else it is left out of what is stored
    closed: Annotated[InternalFlag, Field(exclude_if=lambda closed: not closed)] = False

    @model_validator(mode="after")
    def _names_differ(self):
        names = [wall.name for wall in self.parts]
        if len(set(names)) < len(names):
            refuse([Fault("parts", "two walls have the same name", "give each wall its own name")])
        return self

    def holds(self, x: np.ndarray) -> np.ndarray:
        """Which of the centres x [m], shape [n, 3], lie behind no plane, shape [n]; plates have no inner side."""
        planes = [wall.shape for wall in self.walls() if isinstance(wall.shape, Plane)]
        return np.all([np.ones(len(x), bool), *(plane.distance(x) >= 0 for plane in planes)], axis=0)

    def lets_out(self, x: np.ndarray) -> np.ndarray:
        """Which of the centres x [m], shape [n, 3], of grains that pass `outlet_plane` lie behind no plane."""
        return self.holds(x)

    def close(self, surface_motion: bool = False) -> "Primitives":
        """The container in which a packing is made: with the parts that open, whose outlet plane then does not act.

        Without such parts, itself: nothing is known that could be closed. Surfaces move only if `surface_motion` says
        so.
        """
        parts = self.parts
        if not surface_motion and any(part.motion != AT_REST for part in parts):
            parts = tuple(part.model_copy(update={"motion": AT_REST}) for part in parts)
        closed = any(part.opens for part in parts)
        if parts is self.parts and closed == self.closed:
            return self
        return self.model_copy(update={"parts": parts, "closed": closed})

    def walls(self) -> tuple[Wall, ...]:
        """The walls as given; opened, without those that open."""
        return self.parts if self.closed else tuple(part for part in self.parts if part.opens is None)


Silo = WedgeHopper | CylinderSilo | ConicalSilo
"""Containers that grains flow out of."""


def outlet_shape(container: "Container") -> Literal["slot", "hole"] | None:
    """What grains flow out through; None where the container has no orifice of known width."""
    if isinstance(container, WedgeHopper):
        return "slot"
    return "hole" if isinstance(container, Silo) else None


Container = Annotated[Silo | Box | Primitives, Field(discriminator="kind")]
