"""Containers: what a study names (`wedge-hopper`, `cylinder-silo`), turned into wall primitives.

Each container knows its walls when open and when closed. A closed container's outlet carries a lid and its
side walls reach up as far as a filling needs, so that flat-bottomed silos that differ only in their outlets
are the same closed container, and share packings.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, StrictBool, model_validator

from labbook.scene.geometry import Bounds, Mesh, Segment
from labbook.scene.model import Fault, InternalFlag, Model, refuse
from labbook.scene.quantities import Angle, Coordinate, Distance, Frequency, Length, told_apart
from labbook.scene.walls import AT_REST, Frustum, Plane, Strip, SurfaceMotion, Symmetry, Wall, WallShape

Parts = Annotated[tuple[Wall, ...], Field(exclude_if=lambda parts: not parts)]
"""Walls beside those that a container has of itself; left out of what is stored where there are none."""
Pair = tuple[float, float]
Vector = tuple[float, float, float]
KEPT = 256
"""Containers whose walls are kept: each is asked for them again and again, one after another."""
_TOUCH = 1e-9  # m: distance below which two plates touch
_FLAT = 1e-12  # rad: an angle this close to 90 deg is a flat bottom


# what a container of validated sizes is made of needs no validation: 100 000 points have more than a million walls
@lru_cache(maxsize=KEPT)  # many containers have these in common
def _plane(name: str, point: Vector, normal: Vector) -> Wall:
    return Wall.of(
        name=name, shape=Plane.of(kind="plane", point=point, normal=normal), motion=AT_REST, opens=None, moves=None
    )


def _strip(name: str, start: Pair, end: Pair) -> Wall:
    return Wall.of(
        name=name, shape=Strip.of(kind="strip", start=start, end=end), motion=AT_REST, opens=None, moves=None
    )


def _frustum(name: str, lower: Pair, upper: Pair, motion: SurfaceMotion = AT_REST) -> Wall:
    shape = Frustum.of(kind="frustum", lower=lower, upper=upper)
    return Wall.of(name=name, shape=shape, motion=motion, opens=None, moves=None)


@dataclass(frozen=True)
class Outlet:
    """An opening that grains leave through, at the height `plane` [m].

    `form`, `width` [m] (of a slot its width, of a hole its diameter) and `centre` (its x [m]) are None, NaN and 0 where
    a container does not say. `lid`: the wall that would close it, if that is known.
    """

    name: str
    plane: float
    form: Literal["slot", "hole"] | None = None
    width: float = math.nan
    centre: float = 0.0
    lid: WallShape | None = None


class ContainerShape(Model, ABC):
    """The base of all containers: the geometry of which filling, pictures, recordings and measures ask.

    Each answers `walls`, `close`, `inside`, `outlets` and `outlet_plane`, the height z [m] at which grains count as
    discharged, or None; what else is asked has a default that says that nothing is known.
    """

    symmetry: ClassVar[Symmetry | None] = None
    """`planar`: quasi-2D, seen from the front; `axial`: about x = y = 0; None: neither, or unknown."""
    widths: ClassVar[tuple[str, ...]] = ()
    """Keys of a study for the sizes that make it wider, the narrowest first."""
    at_least_a_grain: ClassVar[tuple[str, ...]] = ()
    """Keys of sizes that are not less than a grain's diameter."""
    closes: ClassVar[bool] = True
    """Whether no grain leaves it closed, wherever its walls are."""
    spin_key: ClassVar[str | None] = None
    """The key that turns one of its surfaces, if there is one."""
    own_walls: ClassVar[tuple[str, ...]] = ()
    """Names of walls that it may have of itself, open or closed."""
    if TYPE_CHECKING:  # fields of each
        kind: str
        """Its name."""
        closed: bool
        """Whether it is the one in which a packing is made."""
        parts: tuple[Wall, ...]
        """Walls that a study lists."""

    @model_validator(mode="after")
    def _names_differ(self):
        names = [*self.own_walls, *(part.name for part in self.parts)]
        if len({*names}) < len(names):
            refuse([Fault("parts", "two walls have the same name", "give each wall its own name")])
        return self

    def _with_parts(self, own: tuple[Wall, ...]) -> tuple[Wall, ...]:
        """Join own walls and parts; opened, without those that open."""
        if not self.parts:
            return own
        return (*own, *(part for part in self.parts if self.closed or part.opens is None))

    def _closed(self, surface_motion: bool, **update: Any) -> Any:
        """A copy that is closed, with other values of some fields; surfaces of parts move only if `surface_motion` says
        so, and parts stand still."""
        parts = _at_rest(self.parts, surface_motion)
        if parts is not self.parts:
            update["parts"] = parts
        return self.model_copy(update={"closed": True, **update})

    def _clear_of_parts(self, x: np.ndarray) -> np.ndarray:
        """Points of x [m], shape [n, 3], on the side of the grains of all parts that stand still, shape [n]."""
        still = [part for part in self._with_parts(()) if part.moves is None]
        return np.all([np.ones(len(x), bool), *(part.shape.inside(x) for part in still)], axis=0)

    @abstractmethod
    def walls(self) -> tuple[Wall, ...]:
        """Its walls, as it stands: open or closed."""

    @abstractmethod
    def close(self, surface_motion: bool = False) -> "ContainerShape":
        """The container in which a packing is made; its surfaces move only if `surface_motion` says so."""

    @abstractmethod
    def inside(self, x: np.ndarray) -> np.ndarray:
        """Which of the centres x [m], shape [n, 3], lie between the walls, shape [n]; above them too."""

    @property
    @abstractmethod
    def outlets(self) -> tuple[Outlet, ...]:
        """The openings that grains leave through, also of the closed one."""

    @property
    def outlet_form(self) -> Literal["slot", "hole"] | None:
        """The form of its only outlet, if there is one of known width."""
        return self.outlets[0].form if len(self.outlets) == 1 else None

    def lets_out(self, x: np.ndarray) -> np.ndarray:
        """Which of the centres x [m], shape [n, 3], of grains that pass the outlet's plane do so in an outlet."""
        return self.inside(x) if self.outlets else np.zeros(len(x), bool)

    @property
    def bounds(self) -> Bounds:
        """The box around its inside, up to the upper end of its walls; infinite where they leave it open."""
        boxes = [wall.shape.enclosed for wall in self.walls()]
        low, high = np.full(3, -np.inf), np.full(3, np.inf)
        for box in boxes:
            low, high = np.maximum(low, box.low), np.minimum(high, box.high)
        return Bounds((low[0], low[1], low[2]), (high[0], high[1], high[2]))

    def section(self) -> tuple[Segment, ...]:
        """Lines (x, z) [m] in which the plane y = 0 cuts its walls, those without end left out."""
        return tuple(line for wall in self.walls() for line in wall.shape.section())

    def mesh(self, within: Bounds) -> dict[str, Mesh]:
        """Its walls as triangles, by name, at least as far as they lie in the box `within`."""
        meshes = ((wall.name, wall.shape.mesh(within)) for wall in self.walls())
        return {name: mesh for name, mesh in meshes if mesh is not None}

    @property
    def across(self) -> float | None:
        """Inner width [m] along x of its widest part; None where that is unknown."""
        return None

    @property
    def front_to_back(self) -> float:
        """Distance [m] between a front and a back wall; infinite without these."""
        return math.inf

    @property
    def area(self) -> float | None:
        """Area [m^2] of its widest horizontal section; None where that is unknown."""
        return None

    @property
    def rise(self) -> float:
        """Height [m] of the highest point of its bottom above the outlet's plane, or above z = 0."""
        return 0.0

    @property
    def roof(self) -> float:
        """z [m] up to which its side walls reach: infinite without an end."""
        return math.inf

    def volume_below(self, z: float) -> float | None:
        """Volume [m^3] between its walls, which go on upwards, from the outlet (or the bottom) up to a height z [m], at
        least 0; None where that is unknown."""
        return None

    def span(self, z: float) -> tuple[float, float] | None:
        """x [m] of its walls on both sides at the height z [m] in the plane y = 0; None where that is unknown."""
        return None


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
    """Distance Z between the front and the back wall."""
    angle: Angle = math.pi / 2
    """Angle α of the bottom from the vertical, 1 to 90 deg: 90 deg is flat, 15 deg a steep funnel."""
    orifice: Length
    """Width D of the outlet, less than the width of the hopper."""
    gap: Distance | None = None
    """Gap s from the left side wall to the near edge of the outlet, at most (L - D)/2; none: centred."""
    closed: InternalFlag = False
    parts: Parts = ()
    """Walls that are listed one by one, beside those that the kind has of itself."""

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
        """As of any container."""
        return 0.0

    @property
    def outlets(self) -> tuple[Outlet, ...]:
        """The slot."""
        lid = Strip.of(kind="strip", start=(self.outlet[0], 0.0), end=(self.outlet[1], 0.0))
        return (Outlet("outlet", 0.0, "slot", self.orifice, self.eccentricity, lid),)

    @property
    def bounds(self) -> Bounds:
        """As of any container."""
        half, depth = self.width / 2, self.thickness / 2
        return Bounds((-half, -depth, 0.0), (half, depth, self.top))

    @property
    def across(self) -> float:
        """As of any container."""
        return self.width

    @property
    def front_to_back(self) -> float:
        """As of any container."""
        return self.thickness

    @property
    def area(self) -> float:
        """As of any container."""
        return self.width * self.thickness

    @property
    def rise(self) -> float:
        """As of any container."""
        return max(self._rises)

    @property
    def roof(self) -> float:
        """As of any container."""
        return self.height

    def volume_below(self, z: float) -> float:
        """As of any container."""
        if self.flat:
            return self.width * self.thickness * z
        slope, (left, right) = math.tan(self.angle), self.outlet
        area = self.orifice * z
        for side in (left + self.width / 2, self.width / 2 - right):
            foot = min(z, side / slope)  # up to here the plate recedes
            area += slope * foot**2 / 2 + side * (z - foot)
        return area * self.thickness

    def span(self, z: float) -> tuple[float, float]:
        """As of any container."""
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
        """z [m] up to which the side walls reach: `height`; closed, as high as any filling (2000 widths)."""
        return 2000 * self.width if self.closed else self.height

    def inside(self, x: np.ndarray) -> np.ndarray:
        """Which of the centres x [m], shape [n, 3], lie between the walls, shape [n]; above them too."""
        (left, right), cot = self.outlet, 0.0 if self.flat else 1 / math.tan(self.angle)
        bottom = np.maximum(np.maximum(left - x[:, 0], x[:, 0] - right), 0) * cot
        beside = (np.abs(x[:, 0]) <= self.width / 2) & (np.abs(x[:, 1]) <= self.thickness / 2)
        return beside & (x[:, 2] >= bottom) & self._clear_of_parts(x)

    def lets_out(self, x: np.ndarray) -> np.ndarray:
        """Which of the centres x [m], shape [n, 3], of grains that pass the outlet's plane do so in the outlet."""
        left, right = self.outlet
        return (x[:, 0] >= left) & (x[:, 0] <= right) & (np.abs(x[:, 1]) <= self.thickness / 2)

    def close(self, surface_motion: bool = False) -> "WedgeHopper":
        """The closed container in which a packing is made; flat bottoms lose their outlet altogether."""
        if self.flat:
            return self._closed(surface_motion, orifice=self.width / 2, gap=None, angle=math.pi / 2)
        return self._closed(surface_motion)

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
            return self._with_parts((*walls, _strip("bottom", (-half, 0.0), (half, 0.0))))
        if left > -half * (1 - 1e-12):  # a gap of 0 has no left plate
            walls.append(_strip("bottom-left", (-half, rise_left), (left, 0.0)))
        walls.append(_strip("bottom-right", (right, 0.0), (half, rise_right)))
        if self.closed:
            walls.append(_strip("lid", (left, 0.0), (right, 0.0)))
        return self._with_parts(tuple(walls))


class RoundSilo(ContainerShape, ABC):
    """Upright cylinder with a round outlet on its axis, whatever its bottom."""

    symmetry: ClassVar[Symmetry | None] = "axial"
    widths: ClassVar[tuple[str, ...]] = ("diameter",)
    at_least_a_grain: ClassVar[tuple[str, ...]] = ("orifice", "diameter")
    if TYPE_CHECKING:  # fields of each
        diameter: float
        height: float
        orifice: float

    @property
    def outlet_plane(self) -> float:
        """As of any container."""
        return 0.0

    @property
    def outlets(self) -> tuple[Outlet, ...]:
        """The hole."""
        lid = Frustum.of(kind="frustum", lower=(0.0, 0.0), upper=(self.orifice / 2, 0.0))
        return (Outlet("outlet", 0.0, "hole", self.orifice, 0.0, lid),)

    @property
    def bounds(self) -> Bounds:
        """As of any container."""
        r = self.diameter / 2
        return Bounds((-r, -r, 0.0), (r, r, self.height))

    @property
    def across(self) -> float:
        """As of any container."""
        return self.diameter

    @property
    def area(self) -> float:
        """As of any container."""
        return math.pi / 4 * self.diameter**2

    @property
    def roof(self) -> float:
        """As of any container."""
        return self.height

    def lets_out(self, x: np.ndarray) -> np.ndarray:
        """Which of the centres x [m], shape [n, 3], of grains that pass the outlet's plane do so in the outlet."""
        return np.hypot(x[:, 0], x[:, 1]) <= self.orifice / 2


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
    """Diameter D of the outlet, less than the cylinder's."""
    rotation: Frequency = 0.0
    """Rotation frequency f of the bottom after the opening; positive is counter-clockwise seen from above."""
    closed: InternalFlag = False
    parts: Parts = ()
    """Walls that are listed one by one, beside those that the kind has of itself."""

    @model_validator(mode="after")
    def _is_possible(self):
        refuse(_orifice_faults(self.orifice, self.diameter))
        return self

    def volume_below(self, z: float) -> float:
        """As of any container."""
        return self.area * z

    def span(self, z: float) -> tuple[float, float]:
        """As of any container."""
        return -self.diameter / 2, self.diameter / 2

    def inside(self, x: np.ndarray) -> np.ndarray:
        """Which of the centres x [m], shape [n, 3], lie between the walls, shape [n]; above them too."""
        return (np.hypot(x[:, 0], x[:, 1]) <= self.diameter / 2) & (x[:, 2] >= 0) & self._clear_of_parts(x)

    def close(self, surface_motion: bool = False) -> "CylinderSilo":
        """The closed container in which a packing is made; it has no outlet, and its bottom turns only if
        `surface_motion` says so."""
        rotation = self.rotation if surface_motion else 0.0
        return self._closed(surface_motion, orifice=self.diameter / 2, rotation=rotation)

    @lru_cache(maxsize=KEPT)  # noqa: B019  (at most so many)
    def walls(self) -> tuple[Wall, ...]:
        """Wall primitives: side, and the bottom round the outlet (closed: all of it)."""
        radius, hole = self.diameter / 2, 0.0 if self.closed else self.orifice / 2
        top = 2000 * self.diameter if self.closed else self.height
        turning = SurfaceMotion(spin=2 * math.pi * self.rotation)
        own = (
            _frustum("side", (radius, 0.0), (radius, top)),
            _frustum("bottom", (hole, 0.0), (radius, 0.0), turning),
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
    """Diameter D of the outlet, less than the cylinder's."""
    closed: InternalFlag = False
    parts: Parts = ()
    """Walls that are listed one by one, beside those that the kind has of itself."""

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

    def volume_below(self, z: float) -> float:
        """As of any container."""
        slope, r, R, cone = math.tan(self.angle), self.orifice / 2, self.diameter / 2, min(z, self.rise)
        return math.pi * ((r + slope * cone) ** 3 - r**3) / (3 * slope) + math.pi * R**2 * (z - cone)

    def span(self, z: float) -> tuple[float, float]:
        """As of any container."""
        reach = min(self.diameter / 2, self.orifice / 2 + math.tan(self.angle) * z)
        return -reach, reach

    def inside(self, x: np.ndarray) -> np.ndarray:
        """Which of the centres x [m], shape [n, 3], lie between the walls, shape [n]; above them too."""
        off = np.hypot(x[:, 0], x[:, 1])
        bottom = np.maximum(off - self.orifice / 2, 0) / math.tan(self.angle)
        return (off <= self.diameter / 2) & (x[:, 2] >= bottom) & self._clear_of_parts(x)

    def close(self, surface_motion: bool = False) -> "ConicalSilo":
        """The closed container in which a packing is made, with a lid over its outlet."""
        return self._closed(surface_motion)

    @lru_cache(maxsize=KEPT)  # noqa: B019  (at most so many)
    def walls(self) -> tuple[Wall, ...]:
        """Wall primitives: side, the cone, called bottom, and closed a lid."""
        radius, hole, rise = self.diameter / 2, self.orifice / 2, self.rise
        top = 2000 * self.diameter if self.closed else self.height
        walls = (
            _frustum("side", (radius, rise), (radius, top)),
            _frustum("bottom", (hole, 0.0), (radius, rise)),
        )
        return self._with_parts((*walls, _frustum("lid", (0.0, 0.0), (hole, 0.0))) if self.closed else walls)


def _orifice_faults(orifice: float, diameter: float) -> Iterator[Fault]:
    if orifice >= diameter * (1 - 2e-9):
        reason = f"the orifice is not narrower than the silo ({orifice * 1e3:g} mm against {diameter * 1e3:g} mm)"
        yield Fault("orifice", reason, "make the orifice smaller or the silo wider")


class Box(ContainerShape):
    """Box, centred in x and y, with its bottom at z = 0; `lid` closes its top."""

    widths: ClassVar[tuple[str, ...]] = ("depth", "width")
    at_least_a_grain: ClassVar[tuple[str, ...]] = ("width", "depth", "height")

    own_walls: ClassVar[tuple[str, ...]] = ("left", "right", "front", "back", "bottom", "top")

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
    parts: Parts = ()
    """Walls that are listed one by one, beside those that the kind has of itself."""

    @property
    def outlet_plane(self) -> None:
        """As of any container: it has no outlet."""

    @property
    def outlets(self) -> tuple[Outlet, ...]:
        """None."""
        return ()

    @property
    def bounds(self) -> Bounds:
        """As of any container."""
        w, d = self.width / 2, self.depth / 2
        return Bounds((-w, -d, 0.0), (w, d, self.height))

    def section(self) -> tuple[Segment, ...]:
        """As of any container: its planes, cut at its height."""
        half, high = self.width / 2, self.height
        lines = (((-half, high), (-half, 0.0)), ((-half, 0.0), (half, 0.0)), ((half, 0.0), (half, high)))
        lines = (*lines, ((-half, high), (half, high))) if self.lid else lines
        return (*lines, *(line for part in self._with_parts(()) for line in part.shape.section()))

    @property
    def across(self) -> float:
        """As of any container."""
        return self.width

    @property
    def front_to_back(self) -> float:
        """As of any container."""
        return self.depth

    @property
    def area(self) -> float:
        """As of any container."""
        return self.width * self.depth

    def volume_below(self, z: float) -> float:
        """As of any container."""
        return self.width * self.depth * z

    def span(self, z: float) -> tuple[float, float]:
        """As of any container."""
        return -self.width / 2, self.width / 2

    def inside(self, x: np.ndarray) -> np.ndarray:
        """Which of the centres x [m], shape [n, 3], lie between the walls, shape [n]; without a lid above them too."""
        beside = (np.abs(x[:, 0]) <= self.width / 2) & (np.abs(x[:, 1]) <= self.depth / 2)
        return beside & (x[:, 2] >= 0) & ((x[:, 2] <= self.height) | (not self.lid)) & self._clear_of_parts(x)

    def close(self, surface_motion: bool = False) -> "Box":
        """The box as a packing is made in it: without a lid, since grains may start above."""
        return self._closed(surface_motion, lid=False)

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
        return self._with_parts(tuple(_plane(name, point, normal) for name, (point, normal) in sides.items()))


class Primitives(ContainerShape):
    """Walls listed one by one; without walls: free space. Parts that open at the start stand only in the closed one."""

    widths: ClassVar[tuple[str, ...]] = ("parts",)
    closes: ClassVar[bool] = False

    kind: Literal["primitives"] = "primitives"
    parts: tuple[Wall, ...] = ()
    """Walls that are listed one by one, beside those that the kind has of itself."""
    outlet_plane: Coordinate | None = None
    """Height z at which grains count as discharged; none: there is no outlet."""
    # only of those closed by parts that open; else it is left out of what is stored
    closed: Annotated[InternalFlag, Field(exclude_if=lambda closed: not closed)] = False

    @property
    def outlets(self) -> tuple[Outlet, ...]:
        """One, at `outlet_plane`; or, where several parts that open lie apart from one another in that plane or little
        above it, one for each, with its name."""
        if self.outlet_plane is None:
            return ()
        lids = [part for part in self.parts if part.opens and self._in_outlet(part.shape)]
        apart = [lid for k, lid in enumerate(lids) if not any(_touch(lid.shape, one.shape) for one in lids[:k])]
        if len(apart) < 2:
            return (Outlet("outlet", self.outlet_plane),)
        return tuple(Outlet(lid.name, self.outlet_plane, lid=lid.shape) for lid in apart)

    def _in_outlet(self, lid: WallShape) -> bool:
        """Whether it ends less than its width above the outlet's plane."""
        bounds = lid.bounds
        above = bounds.low[2] - (self.outlet_plane or 0.0)
        return -_TOUCH <= above <= bounds.size[0] and not any(bounds.endless[::2])

    def inside(self, x: np.ndarray) -> np.ndarray:
        """Which of the centres x [m], shape [n, 3], lie inside of all walls, shape [n]; plates have no inner side."""
        return self._clear_of_parts(x)

    @property
    def bounds(self) -> Bounds:
        """As of any container, as far as its parts tell, those that open included; plates bound it too."""
        boxes = [part.shape.bounds for part in self.parts]
        ends = [[end for box in boxes for end in (box.low[k], box.high[k]) if math.isfinite(end)] for k in range(3)]
        low, high = ([(end(some) if some else default) for some in ends]
                     for end, default in ((min, -math.inf), (max, math.inf)))  # fmt: skip
        return Bounds((low[0], low[1], low[2]), (high[0], high[1], high[2]))

    def close(self, surface_motion: bool = False) -> "Primitives":
        """The container in which a packing is made: with the parts that open, whose outlet plane then does not act.

        Without such parts, itself: nothing is known that could be closed. Surfaces move only if `surface_motion` says
        so.
        """
        parts = _at_rest(self.parts, surface_motion)
        closed = any(part.opens for part in parts)
        if parts is self.parts and closed == self.closed:
            return self
        return self.model_copy(update={"parts": parts, "closed": closed})

    def walls(self) -> tuple[Wall, ...]:
        """The walls as given; opened, without those that open."""
        return self._with_parts(())


def _at_rest(parts: tuple[Wall, ...], surface_motion: bool) -> tuple[Wall, ...]:
    """The parts without motion, but for that of their surfaces if `surface_motion` says so; themselves if they have
    none."""
    if not any(part.moves is not None or (part.motion != AT_REST and not surface_motion) for part in parts):
        return parts
    rest = {"moves": None} if surface_motion else {"moves": None, "motion": AT_REST}
    return tuple(part.model_copy(update=rest) for part in parts)


def _touch(one: WallShape, other: WallShape) -> bool:
    """Whether two plates share an edge or more, as they are cut by the plane y = 0."""
    pairs = ((one, other), (other, one))
    return any(
        bool((np.abs(b.distance(np.array([(x, 0.0, z) for line in a.section() for x, z in line]))) < _TOUCH).any())
        for a, b in pairs
        if a.section()
    )


Container = Annotated[
    WedgeHopper | CylinderSilo | ConicalSilo | Box | Primitives,
    Field(discriminator="kind"),
]
"""The containers that a study can name."""
