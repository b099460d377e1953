"""Containers: what a study names (`wedge-hopper`, `box`), turned into wall primitives.

Each container knows its walls when open and when closed. A closed container's outlet carries a lid and its side
walls reach up as far as a filling needs, so that flat-bottomed silos that differ only in their outlets are the same
closed container, and share packings.
"""

import math
from typing import Annotated, Literal, Union

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from labbook.scene.model import Model
from labbook.scene.quantities import Angle, Distance, Length
from labbook.scene.walls import Plane, Strip, Wall

_FLAT = 1e-12  # rad: an angle this close to 90 deg is a flat bottom


def _wrong(key: str, reason: str, remedy: str) -> PydanticCustomError:
    return PydanticCustomError("geometry", "{reason}", {"key": key, "reason": reason, "remedy": remedy})


class WedgeHopper(Model):
    """Quasi-2D silo between a front and a back wall (Fan et al. 2023, Fig. 1).

    `angle` is that of the inclined bottom from the vertical: 90 deg is a flat bottom, 15 deg a steep funnel. `gap` is
    s, from the left side wall to the near edge of the outlet; left out, the outlet is centred.
    """

    kind: Literal["wedge-hopper"] = "wedge-hopper"
    width: Length
    height: Length
    thickness: Length
    angle: Angle = math.pi / 2
    orifice: Length
    gap: Distance | None = None
    closed: bool = False

    @model_validator(mode="after")
    def _is_possible(self):
        if not math.radians(1) <= self.angle <= math.pi / 2 + _FLAT:
            raise _wrong("angle", "the angle of the bottom from the vertical lies between 1 and 90 deg", "90 deg is flat")
        if self.orifice >= self.width:
            raise _wrong(
                "orifice",
                f"the orifice ({self.orifice * 1e3:g} mm) is not narrower than the hopper ({self.width * 1e3:g} mm)",
                "make the orifice smaller or the hopper wider",
            )
        if self.gap is not None and self.gap > (self.width - self.orifice) / 2 * (1 + 1e-12):
            limit = (self.width - self.orifice) / 2
            raise _wrong(
                "gap",
                f"a gap of {self.gap * 1e3:g} mm lies beyond (L - D)/2 = {limit * 1e3:g} mm and mirrors a smaller one",
                f"use a gap of at most {limit * 1e3:g} mm, or its mirror {(2 * limit - self.gap) * 1e3:g} mm",
            )
        if max(*self._rises, 0.0) >= self.height:
            raise _wrong(
                "height",
                f"the inclined bottom rises {max(self._rises) * 1e3:g} mm and leaves no side wall",
                "make the hopper higher, the angle larger or the orifice wider",
            )
        return self

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

    def close(self) -> "WedgeHopper":
        """The closed container in which a packing is made; flat bottoms lose their outlet altogether."""
        if self.flat:
            return self.model_copy(update={"closed": True, "orifice": self.width / 2, "gap": None, "angle": math.pi / 2})
        return self.model_copy(update={"closed": True})

    def walls(self) -> tuple[Wall, ...]:
        """Wall primitives: front, back, left, right, and the bottom plates (closed: with the lid)."""
        half, depth = self.width / 2, self.thickness / 2
        (left, right), (rise_left, rise_right), top = self.outlet, self._rises, self.top
        walls = [
            Wall(name="front", shape=Plane(point=(0, -depth, 0), normal=(0, 1, 0))),
            Wall(name="back", shape=Plane(point=(0, depth, 0), normal=(0, -1, 0))),
            Wall(name="left", shape=Strip(start=(-half, rise_left), end=(-half, top))),
            Wall(name="right", shape=Strip(start=(half, rise_right), end=(half, top))),
        ]
        if self.closed and self.flat:
            return (*walls, Wall(name="bottom", shape=Strip(start=(-half, 0), end=(half, 0))))
        if left > -half * (1 - 1e-12):  # a gap of 0 has no left plate
            walls.append(Wall(name="bottom-left", shape=Strip(start=(-half, rise_left), end=(left, 0))))
        walls.append(Wall(name="bottom-right", shape=Strip(start=(right, 0), end=(half, rise_right))))
        if self.closed:
            walls.append(Wall(name="lid", shape=Strip(start=(left, 0), end=(right, 0))))
        return tuple(walls)


class Box(Model):
    """A box of inner size width x depth x height, x and y centred, bottom at z = 0; `lid` closes its top."""

    kind: Literal["box"] = "box"
    width: Length
    depth: Length
    height: Length
    lid: bool = False
    closed: bool = False

    @property
    def outlet_plane(self) -> float | None:
        """A box has no outlet."""
        return None

    def close(self) -> "Box":
        """The box as a packing is made in it: without a lid, since grains may start above."""
        return self.model_copy(update={"closed": True, "lid": False})

    def walls(self) -> tuple[Wall, ...]:
        """Wall primitives: left, right, front, back, bottom and, if asked for, top."""
        w, d = self.width / 2, self.depth / 2
        sides = {
            "left": ((-w, 0, 0), (1, 0, 0)),
            "right": ((w, 0, 0), (-1, 0, 0)),
            "front": ((0, -d, 0), (0, 1, 0)),
            "back": ((0, d, 0), (0, -1, 0)),
            "bottom": ((0, 0, 0), (0, 0, 1)),
        }
        if self.lid:
            sides["top"] = ((0, 0, self.height), (0, 0, -1))
        return tuple(Wall(name=k, shape=Plane(point=p, normal=n)) for k, (p, n) in sides.items())


class Primitives(Model):
    """Walls given one by one; none at all is free space."""

    kind: Literal["primitives"] = "primitives"
    parts: tuple[Wall, ...] = ()
    outlet_plane: float | None = None

    @model_validator(mode="after")
    def _names_differ(self):
        names = [wall.name for wall in self.parts]
        if len(set(names)) < len(names):
            raise _wrong("parts", "two walls have the same name", "name each wall differently")
        return self

    def close(self) -> "Primitives":
        """Itself: nothing is known that could be closed."""
        return self

    def walls(self) -> tuple[Wall, ...]:
        """The walls as given."""
        return self.parts


Container = Annotated[Union[WedgeHopper, Box, Primitives], Field(discriminator="kind")]
