"""Inside of a closed container, in which grains can be placed."""

import math
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import numpy as np

from labbook.scene import Container
from labbook.scene.geometry import Bounds
from labbook.scene.walls import Symmetry

_N = TypeVar("_N")
_GRID_RESULTS: dict[tuple[str, float, bool, str, float], Any] = {}
"""Heights and volumes that a `Room` has counted, by walls, clearance, flatness, name and argument. Counting takes
longer
than placing a thousand grains, and every seed of a scene needs the same."""


DENSEST = math.pi / math.sqrt(12)
"""Solid fraction that neither spheres of any sizes within labbook's limits nor parallel rods exceed by much."""
JAMMED = 0.55
"""Solid fraction that randomly placed equal spheres never reach: 0.38 in space, 0.36 in a layer, 0.50 in a row."""
_LEVELS = 400
_COLUMNS, _CROSSED = 200, 24  # points across a section, and of the space along x and along y
_DOUBLINGS = 20


class PlacingError(Exception):
    """Grains cannot be placed; the message gives reason and remedy."""


class Full(Exception):
    """No further grain found a place. `placed`: number of grains that did."""

    def __init__(self, placed: int):
        super().__init__(f"{placed} grains found a place")
        self.placed = placed


class Room:
    """Region inside every wall, clear of it, above a wall that carries grains, and between the outermost plates.

    Volumes are counted in a section: the plane y = 0, that of radius and height if plates are axial, or the space
    itself if a wall without a symmetry encloses the room. `u` is the first coordinate of the section.
    """

    def __init__(self, closed: Container, clearance: float, flat: bool = False):
        """Describe the room of a closed container.

        Args:
            closed: The container.
            clearance: Distance [m] that centres of grains, or ends of rods' segments, keep from walls.
            flat: Take only its plane y = 0.

        Raises:
            PlacingError: Walls or a bottom are missing, or it is narrower than a grain.
        """
        self.shapes = [wall.shape for wall in closed.walls()]
        self.clearance = clearance
        strips, frustums = self._plates("planar"), self._plates("axial")
        sheets = self._sheets()
        if strips and frustums:
            raise PlacingError("a container with both strips and frustums cannot be filled; use one kind of plate")
        self.round = bool(frustums)
        limits = [(shape, shape.enclosed) for shape in self.shapes]
        self._vessels = [(shape, box) for shape, box in limits if not all(box.endless) and not shape.half_space]
        if self.round:
            reaches = (max(map(abs, (*box.low[:2], *box.high[:2]))) for box in sheets)
            widest = max([*(box.high[0] for box in frustums), *reaches]) - clearance
            if widest < 0:
                raise PlacingError("the container is narrower than a grain")
            self.x = self.y = (-widest, widest)
        else:
            boxes = [box for _, box in limits]
            self.x = self._range(0, [end for box in strips for end in (box.low[0], box.high[0])], boxes, sheets)
            self.y = self._range(1, [], boxes, sheets)
        self._size = [r[1] - r[0] + 2 * clearance for r in (self.x, self.y)]
        self.flat = flat
        if flat:
            self.y = (0.0, 0.0)
        lowest = [shape.ground for shape in self.shapes if math.isfinite(shape.ground)]
        if not lowest:
            raise PlacingError("the container has no bottom that grains could settle on")
        self.bottom = max(float(min(lowest)), _start_of(closed))
        self.poured = any(wall.opens for wall in closed.walls())
        """True if the room has nothing below plates: grains from parts that open go on to where plates cover it."""
        above = [shape.prismatic_above for shape in self.shapes]
        self.highest = max([self.bottom, *(z for z in above if z < math.inf)])
        """Height z [m] above which the section is the same everywhere, as far as walls define it."""
        self.prismatic = max(above) < math.inf
        """True if all walls define it."""

    def _plates(self, symmetry: Symmetry) -> list[Bounds]:
        """Bounding boxes of walls of a symmetry that have ends in the section."""
        boxes = [shape.bounds for shape in self.shapes if symmetry in shape.symmetries]
        return [box for box in boxes if not any(box.endless[::2])]

    def _sheets(self) -> list[Bounds]:
        """Bounding boxes of walls that may be hoppers, such as meshes."""
        return [shape.bounds for shape in self.shapes if shape.holds]

    def _range(self, axis: int, ends: list[float], limits: list[Bounds], sheets: list[Bounds]) -> tuple[float, float]:
        low = [box.low[axis] for box in limits if math.isfinite(box.low[axis])]
        high = [box.high[axis] for box in limits if math.isfinite(box.high[axis])]
        if ends or not (low and high):  # within planes they are inserts
            ends = [*ends, *(end for box in sheets for end in (box.low[axis], box.high[axis]))]
        if not (ends or low) or not (ends or high):
            raise PlacingError(f"the container has no walls across {'xyz'[axis]}: grains would fall beside it")
        first = (min(ends) if ends else max(low)) + self.clearance
        last = (max(ends) if ends else min(high)) - self.clearance
        if first > last:
            raise PlacingError(f"the container is narrower than a grain across {'xyz'[axis]}")
        return float(first), float(last)

    def holds(self, x: np.ndarray, clearance: float | np.ndarray | None = None) -> np.ndarray:
        """Mark the spheres that lie inside and clear of the walls.

        Args:
            x: Centres [m], shape [n, 3].
            clearance: Distance from walls [m], for each shape [n] or for all; None: that of the room.
        """
        clearance = self.clearance if clearance is None else clearance
        inside = np.ones(len(x), bool)
        for shape in self.shapes:
            inside &= shape.clearance(x, float(np.max(clearance))) >= clearance
        for shape, _ in self._vessels:
            inside &= shape.inside(x)
        if self.round:
            inside &= np.hypot(x[:, 0], x[:, 1]) <= self.x[1] + self.clearance - clearance
        carried = np.zeros(len(x), bool)
        for shape in self.shapes:
            undecided = np.flatnonzero(inside & ~carried)
            carried[undecided] = shape.carries(x[undecided])
            if self.poured:
                inside &= ~shape.covers(x)
        return inside & carried

    def draw(self, rng: np.random.Generator, n: int, top: float) -> np.ndarray:
        """Draw `n` uniform points up to z = `top` [m] and return those inside."""
        low = (self.x[0], self.y[0], self.bottom + self.clearance)
        points = rng.uniform(low, (self.x[1], self.y[1], top), (n, 3))
        return points[self.holds(points)]

    def draw_each(
        self, rng: np.random.Generator, clearance: np.ndarray, top: float, low: float | None = None
    ) -> np.ndarray:
        """Draw one uniform point between the sides for each grain, inside or not.

        Args:
            rng: Generator.
            clearance: Clearance of each grain [m], shape [n].
            top: Largest z [m].
            low: Smallest z [m]; None: where the grain touches the bottom.
        """
        nearer = self.clearance - clearance
        lower, upper = np.empty((2, len(clearance), 3))
        lower[:, 0], upper[:, 0] = self.x[0] - nearer, self.x[1] + nearer
        lower[:, 2], upper[:, 2] = self.bottom + self.clearance - nearer if low is None else low, top
        if self.flat:
            nearer = 0.0
        lower[:, 1], upper[:, 1] = self.y[0] - nearer, self.y[1] + nearer
        return rng.uniform(lower, upper)

    def tops(self, volume: float, solid: float, densest: float = DENSEST) -> Iterator[float]:
        """Yield heights z [m] up to which grains may be placed, in the order in which to try them.

        The first is the faster estimate of `height_for`. It is too low if little of the container is as wide as its
        widest part, as in a wide cone, and is left out if grains would exceed the solid fraction `densest` below it.

        Args:
            volume: Volume over which the grains are spread [m^3].
            solid: Volume of the grains [m^3].
            densest: Largest solid fraction.

        Raises:
            PlacingError: There is no room at all.
        """
        first = self.height_for(volume)
        fits = solid <= densest * self._once("volume", first + self.clearance, self._volume_below)
        if fits:
            yield first
        level = self.level_for(volume)
        if level == math.inf:
            raise PlacingError(
                "between the walls, above a bottom, there is no room for a grain; use smaller grains, or move "
                "container.parts"
            )
        if level is not None:
            yield level + 2 * self.clearance
        elif not fits:  # a container that ends above: to see how many it holds
            yield first

    def height_for(self, volume: float) -> float:
        """Estimate the height z [m] up to which the container, walls included, holds a volume [m^3].

        Its section is counted on a grid of 200 points across, or 24 x 24, and 400 up to where a straight container
        would hold the volume. Above, it is taken to be as wide as its widest part.
        """
        return self._once("height", volume, self._height_on_grid)

    def _once(self, name: str, of: float, count: Callable[[float], _N]) -> _N:
        key = repr(self.shapes), self.clearance, self.flat, name, of
        if key not in _GRID_RESULTS:
            _GRID_RESULTS[key] = count(of)
        return _GRID_RESULTS[key]

    def _height_on_grid(self, volume: float) -> float:
        area = self._area
        flat = self.bottom + volume / area
        inside, weights = self._inside_on_grid(np.linspace(self.bottom, flat, 400), None)
        fraction = np.average(inside.ravel(), weights=None if weights is None else np.tile(weights, len(inside)))
        return flat + (1 - float(fraction)) * (flat - self.bottom) + 2 * self.clearance

    @property
    def _area(self) -> float:
        """Area [m^2] of the widest horizontal section, walls included."""
        wide, deep = self._size
        return math.pi / 4 * wide * deep if self.round else wide * deep

    def _inside_on_grid(self, z: np.ndarray, clearance: float | None) -> tuple[np.ndarray, np.ndarray | None]:
        """Mark the points of the section inside the room at some heights.

        Args:
            z: Heights [m], shape [n].
            clearance: Distance from walls [m]; None: that of the room.

        Returns:
            Marks, shape [n, m], and the weight of each point, shape [m], if they differ.
        """
        across = np.linspace(0 if self.round else self.x[0], self.x[1], _COLUMNS)
        u, y = across, np.full(len(across), sum(self.y) / 2)
        unlike = any(not shape.symmetries for shape, _ in self._vessels) or bool(self._sheets())
        if not self.round and not self.flat and unlike:
            middles = (np.arange(_CROSSED) + 0.5) / _CROSSED - 0.5
            sides = zip((self.x, self.y), self._size, strict=True)
            u, y = (a.ravel() for a in np.meshgrid(*(sum(ends) / 2 + size * middles for ends, size in sides)))
        points = np.column_stack([np.tile(u, len(z)), np.tile(y, len(z)), np.repeat(z, len(u))])
        return self.holds(points, clearance).reshape(len(z), -1), across if self.round else None

    def level_for(self, volume: float, clearance: float | None = None) -> float | None:
        """Find the height z [m] below which there is room of a volume.

        Args:
            volume: Volume [m^3].
            clearance: Distance from walls [m]; None: that of the centres of grains.

        Returns:
            The height; None if there is never so much room, infinite if there is none for any volume.
        """
        clearance = self.clearance if clearance is None else clearance
        return self._once(f"level {clearance}", volume, lambda volume: self._level_on_grid(volume, clearance))

    def _level_on_grid(self, volume: float, clearance: float) -> float | None:
        high = volume / self._area
        any_room = False
        for _ in range(_DOUBLINGS):
            z = np.linspace(self.bottom, self.bottom + high, _LEVELS)
            below = self._filled(z, clearance)
            if below[-1] >= volume:
                return float(np.interp(volume, below, z))
            high *= 2
            any_room = any_room or bool(below[-1])
        return None if any_room else math.inf

    def _volume_below(self, top: float) -> float:
        """Volume [m^3] of the container below z = `top` [m], walls excluded."""
        return float(self._filled(np.linspace(self.bottom, top, _LEVELS), 0.0)[-1])

    def _filled(self, z: np.ndarray, clearance: float) -> np.ndarray:
        """Volume [m^3] that keeps `clearance` [m] from walls, below each of the equidistant heights `z` [m], shape [n].

        Counted on a grid of 200 points across, or 24 x 24.
        """
        inside, weights = self._inside_on_grid(z, clearance)
        fraction = np.average(inside, axis=1, weights=weights)
        return np.concatenate([[0.0], np.cumsum((fraction[1:] + fraction[:-1]) / 2 * np.diff(z) * self._area)])


def _start_of(closed: Container) -> float:
    """Height z [m] above which a filling starts: the lowest opening part; without one the outlet's plane."""
    opening = [wall.shape.ground for wall in closed.walls() if wall.opens]
    plane = closed.outlet_plane
    return min(filter(math.isfinite, opening), default=-math.inf if plane is None else plane)


def first_come(accepted: np.ndarray, pairs: np.ndarray) -> None:
    """Unmark the second of each of `pairs` (first < second) of points that are too close, if its first is marked."""
    stays = accepted.tolist()
    for first, second in pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))].tolist():  # lists are quicker one by one
        # pairs are sorted, so that the first is decided before it decides the second
        if stays[first]:
            stays[second] = False
    accepted[:] = stays
