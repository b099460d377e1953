"""Containers that a study names (`wedge-hopper`, `cylinder-silo`): here boxes, and walls that are listed one by one."""

import math
from functools import lru_cache
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, StrictBool

from labbook.scene.container_shape import CACHE_SIZE, ContainerShape, Outlet, Parts, plane_wall
from labbook.scene.geometry import Bounds, Segment
from labbook.scene.lids import depth_between, opening
from labbook.scene.model import InternalFlag
from labbook.scene.periodic import PeriodicSides
from labbook.scene.quantities import Coordinate, Length
from labbook.scene.round_silos import ConicalSilo, CylinderSilo
from labbook.scene.walls import Wall, WallShape
from labbook.scene.wedge_hopper import WedgeHopper

_TOUCH = 1e-9  # m: distance below which two plates touch


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
    """A plane closes the top."""
    periodic: PeriodicSides = None
    """`y`: it repeats along y, without a front and a back wall."""
    closed: InternalFlag = False
    parts: Parts = ()
    """Walls that are listed one by one, beside those that the kind has of itself."""

    @property
    def outlet_plane(self) -> None:
        """None: a box has no outlet."""

    @property
    def outlets(self) -> tuple[Outlet, ...]:
        """Empty: a box has no outlet."""
        return ()

    @property
    def bounds(self) -> Bounds:
        """Box between the walls, up to its height [m]."""
        w, d = self.width / 2, self.depth / 2
        return Bounds((-w, -d, 0.0), (w, d, self.height))

    def section(self) -> tuple[Segment, ...]:
        """Lines (x, z) [m] of the bottom, both sides and a lid, cut at the height."""
        half, high = self.width / 2, self.height
        lines = (((-half, high), (-half, 0.0)), ((-half, 0.0), (half, 0.0)), ((half, 0.0), (half, high)))
        lines = (*lines, ((-half, high), (half, high))) if self.lid else lines
        return (*lines, *(line for part in self._with_parts(()) for line in part.shape.section()))

    @property
    def across(self) -> float:
        """Width [m]."""
        return self.width

    @property
    def front_to_back(self) -> float:
        """Depth [m]."""
        return self.depth

    @property
    def area(self) -> float:
        """Width times depth [m^2]."""
        return self.width * self.depth

    def volume_below(self, z: float) -> float:
        """Volume width times depth times z [m^3]."""
        return self.width * self.depth * z

    def span(self, z: float) -> tuple[float, float]:
        """Ends -width/2 and width/2 [m]."""
        return -self.width / 2, self.width / 2

    def inside(self, x: np.ndarray) -> np.ndarray:
        """Mask of the centres x [m], shape [n, 3], between the walls, shape [n]; without a lid above them too."""
        beside = (np.abs(x[:, 0]) <= self.width / 2) & (np.abs(x[:, 1]) <= self.depth / 2)
        return beside & (x[:, 2] >= 0) & ((x[:, 2] <= self.height) | (not self.lid)) & self._clear_of_parts(x)

    def close(self, surface_motion: bool = False) -> "Box":
        """Box as a packing is made in it: without a lid, since grains may start above."""
        return self._closed(surface_motion, lid=False)

    @lru_cache(maxsize=CACHE_SIZE)  # noqa: B019  (at most so many)
    def walls(self) -> tuple[Wall, ...]:
        """Planes left, right, bottom, unless it is periodic front and back, and with a lid top."""
        w, d = self.width / 2, self.depth / 2
        sides = {
            "left": ((-w, 0.0, 0.0), (1.0, 0.0, 0.0)),
            "right": ((w, 0.0, 0.0), (-1.0, 0.0, 0.0)),
            "front": ((0.0, -d, 0.0), (0.0, 1.0, 0.0)),
            "back": ((0.0, d, 0.0), (0.0, -1.0, 0.0)),
            "bottom": ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        }
        if self.periodic:
            del sides["front"], sides["back"]
        if self.lid:
            sides["top"] = ((0.0, 0.0, self.height), (0.0, 0.0, -1.0))
        return self._with_parts(tuple(plane_wall(name, point, normal) for name, (point, normal) in sides.items()))


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
        """One outlet at `outlet_plane`, or one for each of several lids, with its name, form and width.

        Lids are parts that open in that plane or little above it. They count as several if they lie apart. Nothing is
        said of the size of a single outlet.
        """
        if self.outlet_plane is None:
            return ()
        lids = self._lids
        apart = [lid for k, lid in enumerate(lids) if not any(_touch(lid.shape, earlier.shape) for earlier in lids[:k])]
        if len(apart) < 2:
            return (Outlet("outlet", self.outlet_plane),)
        depth = depth_between(self.parts)
        return tuple(Outlet(lid.name, self.outlet_plane, *opening(lid.shape, depth), lid=lid.shape) for lid in apart)

    @property
    def _lids(self) -> list[Wall]:
        """Parts that open in the outlet's plane or little above it."""
        return [part for part in self.parts if part.opens and self._in_outlet(part.shape)]

    def lets_out(self, x: np.ndarray, slack: float = 0.0) -> np.ndarray:
        """Mask of centres where lids lay, if all lay in the outlet's plane; else inside of the walls."""
        lids, plane, inside = [part.shape for part in self._lids], self.outlet_plane, super().lets_out(x)
        heights = [z for lid in lids for z in (lid.bounds.low[2], lid.bounds.high[2])]
        if plane is None or not lids or any(abs(z - plane) > _TOUCH for z in heights):
            return inside
        at = np.column_stack([x[:, :2], np.full(len(x), plane)])
        return inside & np.any([np.abs(lid.distance(at)) <= slack + _TOUCH for lid in lids], axis=0)

    def _in_outlet(self, lid: WallShape) -> bool:
        """True of a part that ends less than its width above the outlet's plane."""
        bounds = lid.bounds
        above = bounds.low[2] - (self.outlet_plane or 0.0)
        return -_TOUCH <= above <= bounds.size[0] and not any(bounds.endless[::2])

    def inside(self, x: np.ndarray) -> np.ndarray:
        """Mask of the centres x [m], shape [n, 3], inside of all walls, shape [n]; plates have no inner side."""
        return self._clear_of_parts(x)

    @property
    def bounds(self) -> Bounds:
        """Box around the parts, those that open included [m]; plates bound it too."""
        boxes = [part.shape.bounds for part in self.parts]
        ends = [[end for box in boxes for end in (box.low[k], box.high[k]) if math.isfinite(end)] for k in range(3)]
        low, high = ([(end(some) if some else default) for some in ends]
                     for end, default in ((min, -math.inf), (max, math.inf)))  # fmt: skip
        return Bounds((low[0], low[1], low[2]), (high[0], high[1], high[2]))

    def close(self, surface_motion: bool = False) -> "Primitives":
        """Close the container with the parts that open; its outlet plane then does not act.

        Args:
            surface_motion: Surfaces of parts move during the filling too.

        Returns:
            Closed container; itself without parts that open, since nothing is known that could be closed.
        """
        closed = self._closed(surface_motion, closed=any(part.opens for part in self.parts))
        return self if closed == self else closed

    def walls(self) -> tuple[Wall, ...]:
        """Parts as listed; opened, without those that open."""
        return self._with_parts(())


def _touch(first: WallShape, second: WallShape) -> bool:
    """True if two plates share an edge or more, as they are cut by the plane y = 0."""
    pairs = ((first, second), (second, first))
    return any(
        bool((np.abs(b.distance(np.array([(x, 0.0, z) for line in a.section() for x, z in line]))) < _TOUCH).any())
        for a, b in pairs
        if a.section()
    )


Container = Annotated[
    WedgeHopper | CylinderSilo | ConicalSilo | Box | Primitives,
    Field(discriminator="kind"),
]
"""Containers that a study can name."""
