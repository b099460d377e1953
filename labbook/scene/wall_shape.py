"""The base of all walls: the geometry of which filling, pictures, recordings and measures ask."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from labbook.scene.geometry import Bounds, Mesh, Segment, contour, enclosed, extent, stands_over
from labbook.scene.model import Model
from labbook.scene.quantities import AngularSpeed, Speed

Symmetry = Literal["planar", "axial"]
"""`planar`: the same in all planes y = const, between front and back walls; `axial`: the same all round x = y = 0."""


class SurfaceMotion(Model):
    """Motion of a wall's surface, as of a conveyor belt or a turntable; the wall itself stays where it is."""

    velocity: tuple[Speed, Speed, Speed] = (0.0, 0.0, 0.0)
    """Velocity of the surface along x, y and z, within the surface; the wall itself stays where it is."""
    spin: AngularSpeed = 0.0
    """Angular velocity of the surface about the vertical axis x = y = 0."""

    def speed(self, reach: float) -> float:
        """Largest speed [m/s] of the surface out to the distance `reach` [m] from the axis x = y = 0."""
        return math.hypot(*self.velocity) + (abs(self.spin) * reach if self.spin else 0.0)


AT_REST = SurfaceMotion()
"""Of walls that do not move."""


class WallShape(Model, ABC):
    """The base of all walls: the geometry of which filling, pictures, recordings and measures ask.

    Only `distance` is abstract. What else they ask has a default that follows from it by numbers; a shape overrides
    those that it knows exactly.
    """

    physics: ClassVar[str]
    """The module of its formulas, which a wall of another package states; see `labbook_dem.walls`."""
    version: ClassVar[int] = 1
    """Raised whenever its formulas change what a run gives: runs and packings made by an older one are then stale."""
    changes: ClassVar[Mapping[int, str]] = {}
    """What a version changed, in a few words, which `plan` shows."""
    half_space: ClassVar[bool] = False
    """Whether it bounds a half-space: of two points that keep a distance, all between them keep it too."""
    if TYPE_CHECKING:  # a field of each shape
        kind: str
        """Its name."""

    @abstractmethod
    def distance(self, x: np.ndarray) -> np.ndarray:
        """Distance [m] of points x, shape [n, 3], from the wall, shape [n]; behind a plane it is negative."""

    def clearance(self, x: np.ndarray, reach: float) -> np.ndarray:
        """Distance [m] as `distance` gives it, where it is at most `reach` [m]; further away any number beyond it."""
        return self.distance(x)

    def inside(self, x: np.ndarray) -> np.ndarray:
        """Which of the points x [m], shape [n, 3], lie on the side of the grains, shape [n]: by default those whose
        distance is not negative. Both sides of a thin plate are; a wall that surrounds the grains says so here."""
        return self.distance(x) >= 0

    @property
    def bounds(self) -> Bounds:
        """The box around it."""
        return extent(self.distance)

    @property
    def effort(self) -> float:
        """Time that its `distance` takes, over that of a plane."""
        return 1.0

    @property
    def enclosed(self) -> Bounds:
        """The box that holds all points inside: of a plane across an axis a half-space, of a vessel its own bounds."""
        return enclosed(self.inside, self.bounds)

    @property
    def symmetries(self) -> frozenset[Symmetry]:
        """What it is the same along or about; by default nothing is known."""
        return frozenset()

    @property
    def holds(self) -> bool:
        """True if grains may lie within its box, as in a hopper, though nothing else tells where they are."""
        return False

    @property
    def ground(self) -> float:
        """z [m] of the lowest place at which it can hold a grain up: infinite of walls that hold none, such as vertical
        planes, -infinite where that is unknown or unbounded, as of an obstacle that grains flow round."""
        return self.enclosed.low[2]

    @property
    def prismatic_above(self) -> float:
        """z [m] above which all its horizontal sections are the same; infinite where that is unknown."""
        return math.inf

    @property
    def reach(self) -> float:
        """Distance [m] from the axis x = y = 0 out to which it extends, at most."""
        bounds = self.bounds
        return math.hypot(*(max(map(abs, ends)) for ends in zip(bounds.low[:2], bounds.high[:2], strict=True)))

    def carries(self, x: np.ndarray) -> np.ndarray:
        """Which of the points x [m], shape [n, 3], have it straight below them, so that what falls there stays on it,
        shape [n]; by default none, unless it encloses the grains."""
        if all(self.enclosed.endless):
            return np.zeros(len(x), bool)
        return stands_over(self.distance, self.bounds, x)

    def covers(self, x: np.ndarray) -> np.ndarray:
        """Which of the points x [m], shape [n, 3], it shields from above, so that nothing reaches them that comes from
        there, shape [n]; by default none."""
        return np.zeros(len(x), bool)

    def normal_speed(self, motion: SurfaceMotion) -> float | None:
        """Largest speed [m/s] along its normal that `motion` would give a point of the wall: 0 if the motion is along
        the surface everywhere, infinite if it grows with the distance from the axis. None: the shape does not say."""
        return None

    def section(self, within: Bounds | None = None) -> tuple[Segment, ...]:
        """The lines (x, z) [m] in which the plane y = 0 cuts it, of a wall without end as far as `within` reaches:
        without that, nothing of it."""
        box = self.bounds.within(within)
        if any(box.endless[::2]):
            return ()
        (x0, _, z0), (x1, _, z1) = box.low, box.high
        deep = max(x1 - x0, z1 - z0) / 2 if box.endless[1] else math.inf
        mesh = self.mesh(box.within(Bounds((-math.inf, -deep, -math.inf), (math.inf, deep, math.inf))))
        return mesh.section() if mesh is not None else ()

    def mesh(self, within: Bounds) -> Mesh | None:
        """Its surface, at least as far as it lies in the box `within`, which has ends; None if nothing does."""
        return contour(self.distance, self.bounds.within(within))

    @property
    def summary(self) -> str:
        """Size in words, where a study does not state it; else empty."""
        return ""

    @property
    def pane(self) -> bool:
        """Whether pictures show it as a pane, through which the grains behind it are seen."""
        return False

    def continued(self, successor: "WallShape", x: np.ndarray) -> np.ndarray:
        """Which of the grains at x [m], shape [n, 3], that touch it touch `other` too, as the same surface, shape [n]:
        they take their springs along where `other` replaces it."""
        return np.zeros(len(x), bool)

    def mirrored(self) -> "WallShape":
        """Its mirror image in x = 0. Raises NotImplementedError of a shape that does not say."""
        raise NotImplementedError(f"a {self.kind} does not say what its mirror image is")
