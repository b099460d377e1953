"""A quasi-2D silo with a slot at the foot of two inclined plates."""

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import ClassVar, Literal

import numpy as np
from pydantic import model_validator

from labbook.scene.container_shape import CACHE_SIZE, FLAT, ContainerShape, Outlet, Parts, plane_wall, strip_wall
from labbook.scene.geometry import Bounds
from labbook.scene.model import Fault, InternalFlag, refuse
from labbook.scene.periodic import PeriodicSides
from labbook.scene.quantities import Angle, Distance, Length, format_distinct
from labbook.scene.thick_plate import OptionalLip
from labbook.scene.walls import AT_REST, Strip, Symmetry, Wall

_NO_PLATE = 1e-12
"""Part of the width below which a bottom plate is none."""


class WedgeHopper(ContainerShape):
    """Quasi-2D silo between a front and a back wall (Fan et al. 2023, Fig. 1).

    Its outlet lies at the foot of a bottom whose plates are inclined by the same angle.
    """

    symmetry: ClassVar[Symmetry | None] = "planar"
    widths: ClassVar[tuple[str, ...]] = ("thickness", "width")
    at_least_a_grain: ClassVar[tuple[str, ...]] = ("thickness", "orifice", "width")

    own_walls: ClassVar[tuple[str, ...]] = (
        "front",
        "back",
        "left",
        "right",
        "bottom",
        "bottom-left",
        "bottom-right",
        "lid",
    )

    kind: Literal["wedge-hopper"] = "wedge-hopper"
    width: Length
    """Inner width L between the side walls."""
    height: Length
    """Height H of the side walls above the outlet; grains may start above it."""
    thickness: Length
    """Distance Z between the front and the back wall, or between periodic sides."""
    angle: Angle = math.pi / 2
    """Angle α of the bottom from the vertical, 1 to 90 deg: 90 deg is flat, 15 deg a steep funnel."""
    orifice: Length
    """Width D of the outlet, less than the width of the hopper; with a lip at its narrowest."""
    lip: OptionalLip = None
    """Rounded or thick edges of the outlet; none: the bottom plates are thin."""
    gap: Distance | None = None
    """Gap s from the left side wall to the near edge of the outlet, at most (L - D)/2; none: centred."""
    periodic: PeriodicSides = None
    """`y`: it repeats along y, without a front and a back wall; its thickness is the period."""
    closed: InternalFlag = False
    parts: Parts = ()
    """Walls that are listed one by one, beside those that the kind has of itself."""

    @model_validator(mode="after")
    def _is_possible(self):
        refuse(self._faults())
        return self

    def _faults(self) -> Iterator[Fault]:
        angle_fits = math.radians(1) * (1 - FLAT) <= self.angle <= math.pi / 2 + FLAT
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
            gap, bound = format_distinct(self.gap * 1e3, limit * 1e3, digits=6)
            reason = f"a gap of {gap} mm is beyond (L - D)/2 = {bound} mm"
            mirrored = 2 * limit - self.gap
            mirror = f", or {mirrored * 1e3:g} mm, its mirror image" if mirrored >= 0 else ""
            yield Fault("gap", reason, f"use at most {limit * 1e3:g} mm{mirror}")
            return
        if angle_fits and max(self._rises) >= self.height:
            rise = f"{max(self._rises) * 1e3:g} mm"
            reason = f"the inclined bottom rises {rise} and leaves no side wall"
            yield Fault("height", reason, f"make the hopper higher than {rise}, or the angle larger")
        elif angle_fits and self.lip is not None:
            if self.lip.is_thin:
                object.__setattr__(self, "lip", None)
            else:
                sides = (self.width / 2 + self.outlet[0], self.width / 2 - self.outlet[1])
                shortest = min(side for side in sides if side > _NO_PLATE * self.width)
                yield from self.lip.faults(self.angle, shortest / math.sin(self.angle))

    @property
    def flat(self) -> bool:
        """True if the bottom is flat."""
        return abs(self.angle - math.pi / 2) <= FLAT

    @property
    def eccentricity(self) -> float:
        """Eccentricity e from the hopper's axis to the centre of the outlet [m]; negative is to the left."""
        return 0.0 if self.gap is None else self.gap + self.orifice / 2 - self.width / 2

    @property
    def outlet(self) -> tuple[float, float]:
        """Left and right edge x of the outlet [m]."""
        e = self.eccentricity
        return e - self.orifice / 2, e + self.orifice / 2

    @property
    def outlet_plane(self) -> float:
        """Height z of the outlet [m]: 0."""
        return 0.0

    @property
    def outlets(self) -> tuple[Outlet, ...]:
        """Slot between the bottom plates."""
        lid = Strip.of(kind="strip", start=(self.outlet[0], 0.0), end=(self.outlet[1], 0.0))
        return (Outlet("outlet", 0.0, "slot", self.orifice, self.eccentricity, lid),)

    @property
    def bounds(self) -> Bounds:
        """Box between the walls, from the outlet to the upper end of the side walls [m]."""
        half, depth = self.width / 2, self.thickness / 2
        return Bounds((-half, -depth, 0.0), (half, depth, self.top))

    @property
    def across(self) -> float:
        """Inner width L [m]."""
        return self.width

    @property
    def front_to_back(self) -> float:
        """Thickness Z [m]."""
        return self.thickness

    @property
    def area(self) -> float:
        """Width times thickness [m^2]."""
        return self.width * self.thickness

    @property
    def rise(self) -> float:
        """Height of the higher bottom plate [m]."""
        return max(self._rises)

    @property
    def roof(self) -> float:
        """Height H of the side walls above the outlet [m]."""
        return self.height

    def volume_below(self, z: float) -> float:
        """Volume of the wedge and, above its plates, of the straight part [m^3]."""
        if self.flat:
            return self.width * self.thickness * z
        slope, (left, right) = math.tan(self.angle), self.outlet
        area = self.orifice * z
        for side in (left + self.width / 2, self.width / 2 - right):
            foot = min(z, side / slope)  # up to here the plate recedes
            area += slope * foot**2 / 2 + side * (z - foot)
        return area * self.thickness

    def span(self, z: float) -> tuple[float, float]:
        """Ends x of the bottom plates or the side walls at the height z [m]."""
        half, (left, right) = self.width / 2, self.outlet
        slope = math.inf if self.flat else math.tan(self.angle)
        return max(-half, left - slope * z), min(half, right + slope * z)

    @property
    def _rises(self) -> tuple[float, float]:
        """Heights [m] that the left and the right bottom plate rise from the outlet to the side walls."""
        left, right = self.outlet
        cot = 0.0 if self.flat else 1 / math.tan(self.angle)
        return (left + self.width / 2) * cot, (self.width / 2 - right) * cot

    @property
    def top(self) -> float:
        """Upper end z of the side walls [m]: `height`; closed, as high as any filling (2000 widths)."""
        return 2000 * self.width if self.closed else self.height

    def inside(self, x: np.ndarray) -> np.ndarray:
        """Mask of the centres x [m], shape [n, 3], between the walls, shape [n]; above them too."""
        (left, right), cot = self.outlet, 0.0 if self.flat else 1 / math.tan(self.angle)
        bottom = np.maximum(np.maximum(left - x[:, 0], x[:, 0] - right), 0) * cot
        beside = (np.abs(x[:, 0]) <= self.width / 2) & (np.abs(x[:, 1]) <= self.thickness / 2)
        return beside & (x[:, 2] >= bottom) & self._clear_of_parts(x)

    def lets_out(self, x: np.ndarray, slack: float = 0.0) -> np.ndarray:
        """Mask of centres within the outlet, whose size is exact."""
        wider = 0.0 if self.lip is None else self.lip.widening(self.angle)
        left, right = self.outlet
        across = (x[:, 0] >= left - wider) & (x[:, 0] <= right + wider)
        return across & (np.abs(x[:, 1]) <= self.thickness / 2)

    @property
    def edge_height(self) -> float:
        """Height [m] of the lip below the outlet's plane; 0 without one."""
        return 0.0 if self.lip is None or self.closed else self.lip.height(self.angle)

    def _plate(self, name: str, far: tuple[float, float], edge: tuple[float, float]) -> Wall:
        """Plate of the bottom, from the side wall to the outlet, with the lip if there is one."""
        if self.lip is None:
            return strip_wall(name, far, edge)
        shape = self.lip.plate(far, edge, turned=False)
        return Wall.of(name=name, shape=shape, motion=AT_REST, opens=None, moves=None)

    def close(self, surface_motion: bool = False) -> "WedgeHopper":
        """Close the hopper with a lid; a flat bottom becomes one plate, without an outlet."""
        if self.flat:
            return self._closed(surface_motion, orifice=self.width / 2, gap=None, angle=math.pi / 2, lip=None)
        return self._closed(surface_motion, lip=None)

    @lru_cache(maxsize=CACHE_SIZE)  # noqa: B019  (at most so many)
    def walls(self) -> tuple[Wall, ...]:
        """Planes front and back unless it is periodic, strips left, right and of the bottom (closed: with the lid)."""
        half, depth = self.width / 2, self.thickness / 2
        (left, right), (rise_left, rise_right), top = self.outlet, self._rises, self.top
        faces = [
            plane_wall("front", (0.0, -depth, 0.0), (0.0, 1.0, 0.0)),
            plane_wall("back", (0.0, depth, 0.0), (0.0, -1.0, 0.0)),
        ]
        walls = [
            *([] if self.periodic else faces),
            strip_wall("left", (-half, rise_left), (-half, top)),
            strip_wall("right", (half, rise_right), (half, top)),
        ]
        if self.closed and self.flat:
            return self._with_parts((*walls, strip_wall("bottom", (-half, 0.0), (half, 0.0))))
        if left > -half * (1 - _NO_PLATE):  # a gap of 0 has no left plate
            walls.append(self._plate("bottom-left", (-half, rise_left), (left, 0.0)))
        walls.append(
            strip_wall("bottom-right", (right, 0.0), (half, rise_right))
            if self.lip is None
            else self._plate("bottom-right", (half, rise_right), (right, 0.0))
        )
        if self.closed:
            walls.append(strip_wall("lid", (left, 0.0), (right, 0.0)))
        return self._with_parts(tuple(walls))
