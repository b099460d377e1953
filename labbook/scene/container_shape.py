"""Base of all containers: the geometry that filling, pictures, recordings and measures use.

Each container knows its walls when open and when closed. A closed container's outlet carries a lid, and its side walls
reach up as far as a filling needs. So flat-bottomed silos that differ only in their outlets are the same closed
container, and share packings.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from labbook.scene.geometry import Bounds, Mesh, Segment
from labbook.scene.model import Fault, Model, OrWord, refuse
from labbook.scene.quantities import Coordinate
from labbook.scene.walls import AT_REST, START, Frustum, Plane, Strip, SurfaceMotion, Symmetry, Wall, WallShape

Parts = Annotated[tuple[Wall, ...], Field(exclude_if=lambda parts: not parts)]
"""Walls beside those that a container has of itself; left out of what is stored where there are none."""
Pair = tuple[float, float]
Vector = tuple[float, float, float]
BELOW_PARTS: Literal["below-parts"] = "below-parts"
"""Value of `sink` for the lowest point of the parts."""
Sink = Annotated[
    Annotated[float, OrWord(Coordinate, BELOW_PARTS)] | None,
    Field(exclude_if=lambda sink: sink is None),
]
"""Height z [m] at which grains leave the scene, of a container that goes on below its outlet."""


class CountingPlane(Model):
    """A horizontal plane through which the mass flow is counted, beside the outlet."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9-]*$", max_length=40)]
    """Name of the plane in results, `flow_rate_NAME`: lower-case letters, digits and hyphens."""
    z: Coordinate
    """Height of the plane."""


class VelocityZone(Model):
    """A box in which mean velocities are measured."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9-]*$", max_length=40)]
    """Name of the zone in results, `velocity_z_NAME`: lower-case letters, digits and hyphens."""
    low: tuple[Coordinate, Coordinate, Coordinate]
    """Lower corner x, y, z of the box."""
    high: tuple[Coordinate, Coordinate, Coordinate]
    """Upper corner."""

    @model_validator(mode="after")
    def _has_a_volume(self):
        if not all(low < high for low, high in zip(self.low, self.high, strict=True)):
            refuse(
                [Fault("high", "the upper corner is not above the lower one", "give each axis a low below its high")]
            )
        return self

    def holds(self, x: np.ndarray) -> np.ndarray:
        """Mask of the centres x [m], shape [n, 3], inside the box, shape [n]."""
        return np.all((x >= self.low) & (x <= self.high), axis=1)


VelocityZones = Annotated[tuple[VelocityZone, ...], Field(exclude_if=lambda zones: not zones)]
CountingPlanes = Annotated[tuple[CountingPlane, ...], Field(exclude_if=lambda planes: not planes)]
CACHE_SIZE = 256
"""Containers whose walls are kept: each is asked for them many times, one after another."""
_TOUCH = 1e-9  # m: by which a part that begins at the outlet may rise above it
FLAT = 1e-12
"""Angle [rad] from 90 deg below which a bottom is flat."""


# what a container of validated sizes is made of needs no validation: 100 000 points have more than a million walls
@lru_cache(maxsize=CACHE_SIZE)  # many containers have these in common
def plane_wall(name: str, point: Vector, normal: Vector) -> Wall:
    return Wall.of(
        name=name, shape=Plane.of(kind="plane", point=point, normal=normal), motion=AT_REST, opens=None, moves=None
    )


def strip_wall(name: str, start: Pair, end: Pair) -> Wall:
    return Wall.of(
        name=name, shape=Strip.of(kind="strip", start=start, end=end), motion=AT_REST, opens=None, moves=None
    )


def frustum_wall(name: str, lower: Pair, upper: Pair, motion: SurfaceMotion = AT_REST) -> Wall:
    shape = Frustum.of(kind="frustum", lower=lower, upper=upper)
    return Wall.of(name=name, shape=shape, motion=motion, opens=None, moves=None)


@dataclass(frozen=True)
class Outlet:
    """Opening that grains leave through.

    Attributes:
        name: Name in results.
        plane: Height z [m].
        form: A slot or a hole; None if the container does not say.
        width: Width of a slot, diameter of a hole [m]; NaN if the container does not say.
        centre: x of its centre [m].
        lid: Wall that would close it; None if that is unknown.
    """

    name: str
    plane: float
    form: Literal["slot", "hole"] | None = None
    width: float = math.nan
    centre: float = 0.0
    lid: WallShape | None = None


class ContainerShape(Model, ABC):
    """Base of all containers: the geometry that filling, pictures, recordings and measures use.

    Each defines `walls`, `close`, `inside`, `outlets` and `outlet_plane`, the height z [m] at which grains count as
    discharged, or None. All else has a default for an unknown geometry.
    """

    symmetry: ClassVar[Symmetry | None] = None
    """`planar`: quasi-2D, seen from the front; `axial`: about x = y = 0; None: neither, or unknown."""
    widths: ClassVar[tuple[str, ...]] = ()
    """Keys of a study for the sizes that make it wider, the narrowest first."""
    at_least_a_grain: ClassVar[tuple[str, ...]] = ()
    """Keys of sizes that are not less than a grain's diameter."""
    closes: ClassVar[bool] = True
    """No grain leaves it while it is closed, wherever its walls are."""
    spin_key: ClassVar[str | None] = None
    """Key that turns one of its surfaces, if there is one."""
    own_walls: ClassVar[tuple[str, ...]] = ()
    """Names of walls that it may have of itself, open or closed."""
    if TYPE_CHECKING:  # fields of each
        kind: str
        """Name of the kind of container."""
        closed: bool
        """True of the container in which a packing is made."""
        parts: tuple[Wall, ...]
        """Walls that a study lists."""
    sink: Sink = None
    """Height z of the plane below the outlet at which grains leave the scene, so that it goes on below the outlet;
    `below-parts`: the lowest point of the parts. None: grains leave just below the outlet."""
    planes: CountingPlanes = ()
    """Horizontal planes through which the mass flow is counted, beside the outlet."""
    zones: VelocityZones = ()
    """Boxes in which mean velocities are measured."""

    @model_validator(mode="after")
    def _names_differ(self):
        names = [*self.own_walls, *(part.name for part in self.parts)]
        if len({*names}) < len(names):
            refuse([Fault("parts", "two walls have the same name", "give each wall its own name")])
        if self.sink == BELOW_PARTS:
            object.__setattr__(self, "sink", min([*map(_lowest, self.parts), self._outlet_height or 0.0]))
        if (below := self.edge_height) > 0:  # the scene goes on at least to the lower end of the edge
            object.__setattr__(self, "sink", min(self.sink or 0.0, (self._outlet_height or 0.0) - below))
        refuse(self._faults_below())
        return self

    def _faults_below(self) -> Iterator[Fault]:
        """Faults of the sink below the outlet, and of planes and zones beside it."""
        names, sink, height = [plane.name for plane in self.planes], self.sink, self._outlet_height
        if height is None:
            for key in ("sink", "planes", "zones"):
                if getattr(self, key) not in (None, ()):
                    yield Fault(key, "without an outlet no grain leaves", f"state outlet_plane, or leave {key} out")
            return
        if len({zone.name for zone in self.zones}) < len(self.zones):
            yield Fault("zones", "two zones have the same name", "give each zone its own name")
        if len({*names}) < len(names):
            yield Fault("planes", "two planes have the same name", "give each plane its own name")
        if {*names} & {outlet.name for outlet in self.outlets if names}:
            yield Fault("planes", "a plane has the name of an outlet", "give it another name")
        if sink is not None and math.isinf(sink):
            endless = next(part.name for part in self.parts if _lowest(part) == sink)
            reason = f"the part {endless} has no lowest point"
            yield Fault("sink", reason, "state a height, such as -0.5 m, below which grains are removed")
        elif sink is not None and sink > height:
            reason = f"a sink at z = {1e3 * sink:g} mm lies above the outlet"
            yield Fault("sink", reason, f"use a height below {1e3 * height:g} mm")

    @property
    def edge_height(self) -> float:
        """Height [m] of the outlet's edge below its plane; 0 of a thin plate."""
        return 0.0

    @property
    def _outlet_height(self) -> float | None:
        """Height z [m] of the outlet; None without any."""
        return self.outlets[0].plane if self.outlets else None

    def _with_parts(self, own: tuple[Wall, ...]) -> tuple[Wall, ...]:
        """Join own walls and parts; opened, without those that open."""
        if not self.parts:
            return own
        return (*own, *(part for part in self.parts if self.closed or part.opens != START))

    def _closed(self, surface_motion: bool, **update: Any) -> Any:
        """Copy the container as closed, without all that lies below the outlet.

        So what lies there does not count in the key of the packing. Parts stand still, and their surfaces too unless
        `surface_motion` is set. `update`: further values of fields.
        """
        parts = _at_rest(self._above_outlet(), surface_motion)
        return self.model_copy(
            update={"closed": True, "parts": parts, "sink": None, "planes": (), "zones": (), **update}
        )

    def _above_outlet(self) -> tuple[Wall, ...]:
        """Parts that grains can touch while it is filled: all of them, unless it goes on below the outlet."""
        if self.sink is None:
            return self.parts
        floor = min((_lowest(part) for part in self.parts if part.opens), default=self._outlet_height or 0.0)
        return tuple(part for part in self.parts if part.opens or part.shape.bounds.high[2] > floor + _TOUCH)

    def _clear_of_parts(self, x: np.ndarray) -> np.ndarray:
        """Points of x [m], shape [n, 3], on the side of the grains of all parts that stand still, shape [n]."""
        still = [part for part in self._with_parts(()) if not part.is_posed]
        return np.all([np.ones(len(x), bool), *(part.shape.inside(x) for part in still)], axis=0)

    @abstractmethod
    def walls(self) -> tuple[Wall, ...]:
        """List the walls, open or closed as the container is.

        Returns:
            Walls: the container's own first, then those that a study lists.
        """

    @abstractmethod
    def close(self, surface_motion: bool = False) -> "ContainerShape":
        """Close the container for the filling.

        Args:
            surface_motion: Surfaces of walls move during the filling too.

        Returns:
            Container in which a packing is made.
        """

    @abstractmethod
    def inside(self, x: np.ndarray) -> np.ndarray:
        """Select the points between the walls, or above them.

        Args:
            x: Centres of grains [m], shape [n, 3].

        Returns:
            Mask, shape [n].
        """

    @property
    @abstractmethod
    def outlets(self) -> tuple[Outlet, ...]:
        """Openings that grains leave through, also of the closed container."""

    @property
    def outlet_form(self) -> Literal["slot", "hole"] | None:
        """Form of the only outlet; None with several, or of an unknown width."""
        return self.outlets[0].form if len(self.outlets) == 1 else None

    def outlet_of(self, x: np.ndarray) -> np.ndarray:
        """Find the outlet of grains in the outlets' plane: the one whose lid is nearest.

        Args:
            x: Centres of grains [m], shape [n, 3].

        Returns:
            Index of its outlet for each grain, shape [n].
        """
        lids = [outlet.lid for outlet in self.outlets]
        away = [np.full(len(x), math.inf) if lid is None else np.abs(lid.distance(x)) for lid in lids]
        return np.argmin(away, axis=0)

    def lets_out(self, x: np.ndarray, slack: float = 0.0) -> np.ndarray:
        """Select grains that pass the outlet's plane within an outlet.

        Args:
            x: Centres of grains in that plane [m], shape [n, 3].
            slack: Distance [m] by which a lid may be smaller than its outlet.

        Returns:
            Mask, shape [n].
        """
        return self.inside(x) if self.outlets else np.zeros(len(x), bool)

    @property
    def bounds(self) -> Bounds:
        """Box around the inside, up to the upper end of the walls [m]; infinite where they leave it open."""
        boxes = [wall.shape.enclosed for wall in self.walls()]
        low, high = np.full(3, -np.inf), np.full(3, np.inf)
        for box in boxes:
            low, high = np.maximum(low, box.low), np.minimum(high, box.high)
        return Bounds((low[0], low[1], low[2]), (high[0], high[1], high[2]))

    def section(self) -> tuple[Segment, ...]:
        """Cut the walls with the plane y = 0.

        Returns:
            Lines (x, z) [m]; walls without end are left out.
        """
        return tuple(line for wall in self.walls() for line in wall.shape.section())

    def mesh(self, within: Bounds) -> dict[str, Mesh]:
        """Mesh the walls.

        Args:
            within: Box that the meshes cover at least.

        Returns:
            Meshes by name of the wall.
        """
        meshes = ((wall.name, wall.shape.mesh(within)) for wall in self.walls())
        return {name: mesh for name, mesh in meshes if mesh is not None}

    @property
    def across(self) -> float | None:
        """Inner width along x of the widest part [m]; None if that is unknown."""
        return None

    @property
    def front_to_back(self) -> float:
        """Distance between a front and a back wall, or between periodic sides [m]; infinite without these."""
        return math.inf

    @property
    def period(self) -> float:
        """Distance between periodic sides along y [m] (`labbook.scene.periodic`); infinite without them."""
        return self.front_to_back if getattr(self, "periodic", None) else math.inf

    @property
    def area(self) -> float | None:
        """Area of the widest horizontal section [m^2]; None if that is unknown."""
        return None

    @property
    def rise(self) -> float:
        """Height of the highest point of the bottom above the outlet's plane, or above z = 0 [m]."""
        return 0.0

    @property
    def roof(self) -> float:
        """Height z of the upper end of the side walls [m]; infinite without an end."""
        return math.inf

    def volume_below(self, z: float) -> float | None:
        """Compute the volume between the walls, as if they went on upwards.

        Args:
            z: Height [m], at least 0.

        Returns:
            Volume from the outlet, or the bottom, up to z [m^3]; None if that is unknown.
        """
        return None

    def span(self, z: float) -> tuple[float, float] | None:
        """Find the walls on both sides in the plane y = 0.

        Args:
            z: Height [m].

        Returns:
            x of the left and of the right wall [m]; None if that is unknown.
        """
        return None


def _lowest(part: Wall) -> float:
    """z [m] of the lowest point of a part: infinite of an upright plane, -infinite of an inclined one."""
    return part.shape.ground if part.shape.half_space else part.shape.bounds.low[2]


def _at_rest(parts: tuple[Wall, ...], surface_motion: bool) -> tuple[Wall, ...]:
    """Copy parts without their motion.

    Args:
        parts: Parts of a container.
        surface_motion: Keep the motion of their surfaces.

    Returns:
        Parts without motion and without a time at which they vanish; `parts` itself if they have none.
    """
    if not any(part.is_posed or (part.motion != AT_REST and not surface_motion) for part in parts):
        return parts
    still = {"moves": None} if surface_motion else {"moves": None, "motion": AT_REST}
    return tuple(part.model_copy(update=still | {"opens": part.opens and START}) for part in parts)
