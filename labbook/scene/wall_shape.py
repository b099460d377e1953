"""Base of all walls: the geometry that filling, pictures, recordings and measures use."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from labbook.scene.geometry import Bounds, Mesh, Segment, contour, enclosed, extent, stands_over
from labbook.scene.model import Model
from labbook.scene.quantities import AngularSpeed, Speed
from labbook.warning import rename_in_subclass

Symmetry = Literal["planar", "axial"]
"""`planar`: the same in all planes y = const, between front and back walls; `axial`: the same all round x = y = 0."""


class SurfaceMotion(Model):
    """Motion of a wall's surface, as of a conveyor belt or a turntable; the wall itself stays where it is."""

    velocity: tuple[Speed, Speed, Speed] = (0.0, 0.0, 0.0)
    """Velocity of the surface along x, y and z, within the surface; the wall itself stays where it is."""
    spin: AngularSpeed = 0.0
    """Angular velocity of the surface about the vertical axis x = y = 0."""

    def speed(self, reach: float) -> float:
        """Bound the speed of the surface.

        Args:
            reach: Distance from the axis x = y = 0 [m].

        Returns:
            Largest speed out to that distance [m/s].
        """
        return math.hypot(*self.velocity) + (abs(self.spin) * reach if self.spin else 0.0)


AT_REST = SurfaceMotion()
"""Motion of walls that do not move."""


class WallShape(Model, ABC):
    """Base of all walls: the geometry that filling, pictures, recordings and measures use.

    Only `distance` is abstract. The rest follows from it by numbers, or is unknown by default (`mirrored` raises). A
    shape overrides what it knows.
    """

    physics: ClassVar[str]
    """Module of its formulas, which a wall of another package states; see `labbook_dem.walls`."""
    version: ClassVar[int] = 1
    """Version of its formulas, raised with each change of results: older runs and packings are then stale."""
    changes: ClassVar[Mapping[int, str]] = {}
    """Change by each version, in a few words; `plan` shows it."""
    spheres_only: ClassVar[bool] = False
    """True if it has no contacts with rods."""
    half_space: ClassVar[bool] = False
    """True if it bounds a half-space: of two points that keep a distance, all between them keep it too."""
    if TYPE_CHECKING:  # a field of each shape
        kind: str
        """Name of the shape."""

    def __init_subclass__(cls, **further: Any):
        rename_in_subclass(cls, "pane", "is_transparent")
        super().__init_subclass__(**further)

    @abstractmethod
    def distance(self, x: np.ndarray) -> np.ndarray:
        """Compute the distance from the wall.

        Args:
            x: Points [m], shape [n, 3].

        Returns:
            Distances [m], shape [n]; negative behind a wall that has a side without grains, such as a plane.
        """

    def clearance(self, x: np.ndarray, reach: float) -> np.ndarray:
        """Compute the distance from the wall near it.

        Args:
            x: Points [m], shape [n, 3].
            reach: Distance up to which results are exact [m].

        Returns:
            Distances as of `distance` up to `reach` [m], and any number beyond it further away, shape [n].
        """
        return self.distance(x)

    def inside(self, x: np.ndarray) -> np.ndarray:
        """Select the points on the side of the grains.

        Both sides of a thin plate are. A wall that surrounds the grains overrides this.

        Args:
            x: Points [m], shape [n, 3].

        Returns:
            Mask, shape [n]; by default of distances that are not negative.
        """
        return self.distance(x) >= 0

    @property
    def bounds(self) -> Bounds:
        """Box around the wall [m]; infinite where the wall has no end."""
        return extent(self.distance)

    @property
    def effort(self) -> float:
        """Time that `distance` takes, over that of a plane."""
        return 1.0

    @property
    def enclosed(self) -> Bounds:
        """Box around all points inside [m]: a half-space of a plane across an axis, `bounds` of a vessel."""
        return enclosed(self.inside, self.bounds)

    @property
    def symmetries(self) -> frozenset[Symmetry]:
        """Symmetries of the wall; by default none is known."""
        return frozenset()

    @property
    def holds(self) -> bool:
        """True if grains may lie within the box of the wall, as in a hopper, though nothing else tells where."""
        return False

    @property
    def ground(self) -> float:
        """Height z [m] of the lowest place at which the wall can hold a grain up.

        Infinite of walls that hold none, such as vertical planes. -infinite where it is unknown or unbounded, as of an
        obstacle that grains flow round.
        """
        return self.enclosed.low[2]

    @property
    def prismatic_above(self) -> float:
        """Height z [m] above which all horizontal sections are the same; infinite if that is unknown."""
        return math.inf

    @property
    def reach(self) -> float:
        """Largest distance of the wall from the axis x = y = 0 [m]."""
        bounds = self.bounds
        return math.hypot(*(max(map(abs, ends)) for ends in zip(bounds.low[:2], bounds.high[:2], strict=True)))

    def carries(self, x: np.ndarray) -> np.ndarray:
        """Select the points with the wall straight below them: what falls there stays on it.

        Args:
            x: Points [m], shape [n, 3].

        Returns:
            Mask, shape [n]; by default empty, unless the wall encloses the grains.
        """
        if all(self.enclosed.endless):
            return np.zeros(len(x), bool)
        return stands_over(self.distance, self.bounds, x)

    def covers(self, x: np.ndarray) -> np.ndarray:
        """Select the points that the wall shields from above: nothing reaches them that falls from there.

        Args:
            x: Points [m], shape [n, 3].

        Returns:
            Mask, shape [n]; by default empty.
        """
        return np.zeros(len(x), bool)

    def normal_speed(self, motion: SurfaceMotion) -> float | None:
        """Compute the largest speed along the normal that a motion of the surface would give a point of the wall.

        Args:
            motion: Motion of the surface.

        Returns:
            Speed [m/s]: 0 if the motion is along the surface everywhere, infinite if it grows with the distance from
            the axis. None if the shape does not say.
        """
        return None

    def section(self, within: Bounds | None = None) -> tuple[Segment, ...]:
        """Cut the wall with the plane y = 0.

        Args:
            within: Box at which a wall without end is cut; None: such a wall has no lines.

        Returns:
            Lines (x, z) [m].
        """
        box = self.bounds.within(within)
        if any(box.endless[::2]):
            return ()
        (x0, _, z0), (x1, _, z1) = box.low, box.high
        deep = max(x1 - x0, z1 - z0) / 2 if box.endless[1] else math.inf
        mesh = self.mesh(box.within(Bounds((-math.inf, -deep, -math.inf), (math.inf, deep, math.inf))))
        return mesh.section() if mesh is not None else ()

    def mesh(self, within: Bounds) -> Mesh | None:
        """Mesh the surface.

        Args:
            within: Box with ends that the mesh covers at least.

        Returns:
            Mesh; None if nothing of the surface lies in the box.
        """
        return contour(self.distance, self.bounds.within(within))

    @property
    def summary(self) -> str:
        """Size in words where a study does not state it; else empty."""
        return ""

    @property
    def is_transparent(self) -> bool:
        """True if pictures show the grains behind the wall."""
        return False

    def continued(self, successor: "WallShape", x: np.ndarray) -> np.ndarray:
        """Select grains that touch both this wall and one that replaces it, as the same surface.

        They keep their friction springs when the wall is replaced.

        Args:
            successor: Wall that replaces this one.
            x: Centres of grains that touch this wall [m], shape [n, 3].

        Returns:
            Mask, shape [n]; by default empty.
        """
        return np.zeros(len(x), bool)

    def mirrored(self) -> "WallShape":
        """Mirror the wall in x = 0.

        Returns:
            Mirror image.

        Raises:
            NotImplementedError: The shape does not say.
        """
        raise NotImplementedError(f"a {self.kind} does not say what its mirror image is")
