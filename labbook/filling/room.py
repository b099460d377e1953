"""The inside of a closed container, where grains can be placed."""

import math

import numpy as np

from labbook.scene import Frustum, Plane, Scene, Strip

_HEIGHTS: dict[tuple[str, float, bool, float], float] = {}
"""Of `Room.height_for` [m], by walls, clearance, flatness and volume: counting takes longer than placing a thousand
grains, and every seed of a scene asks for it."""


class PlacingError(Exception):
    """Grains cannot be placed; the message says why and what to do."""


class Room:
    """In front of every plane, above and between all plates, seen in one section, and clear of all other walls.

    The section of strips is the x-z plane; that of frustums is the plane of radius and height. What the section shows
    along its first axis is called `u`.
    """

    def __init__(self, closed: Scene, clearance: float, flat: bool = False):
        """`clearance`: what the centres of grains, or of the ends of rods, keep from walls [m]; `flat`: only the plane
        y = 0 of it. Raises PlacingError."""
        self.shapes = [wall.shape for wall in closed.container.walls()]
        self.clearance = clearance
        self.planes = [shape for shape in self.shapes if isinstance(shape, Plane)]
        strips = [(shape.start, shape.end) for shape in self.shapes if isinstance(shape, Strip)]
        frustums = [(shape.lower, shape.upper) for shape in self.shapes if isinstance(shape, Frustum)]
        if strips and frustums:
            raise PlacingError("a container with both strips and frustums cannot be filled; use one kind of plate")
        self.round = bool(frustums)
        self.plates = np.array([*strips, *frustums]).reshape(-1, 2, 2)
        floor = [p.point[2] for p in self.planes if _axis(p) == (2, 1)]
        lowest = [*floor, *self.plates[:, :, 1].ravel()]
        if self.round:
            widest = float(self.plates[:, :, 0].max()) - clearance
            if widest < 0:
                raise PlacingError("the container is narrower than a grain")
            self.x = self.y = (-widest, widest)
        else:
            self.x = self._range(0, list(self.plates[:, :, 0].ravel()))
            self.y = self._range(1, [])
        self._size = [r[1] - r[0] + 2 * clearance for r in (self.x, self.y)]
        self.flat = flat
        if flat:
            self.y = (0.0, 0.0)
        if not lowest:
            raise PlacingError("the container has no bottom that grains could settle on")
        self.bottom = float(min(lowest))

    def _range(self, axis: int, ends: list[float]) -> tuple[float, float]:
        low = [*ends, *(p.point[axis] for p in self.planes if _axis(p) == (axis, 1))]
        high = [*ends, *(p.point[axis] for p in self.planes if _axis(p) == (axis, -1))]
        if not low or not high:
            raise PlacingError(f"the container has no walls across {'xyz'[axis]}: grains would fall beside it")
        first = (min(ends) if ends else max(low)) + self.clearance
        last = (max(ends) if ends else min(high)) - self.clearance
        if first > last:
            raise PlacingError(f"the container is narrower than a grain across {'xyz'[axis]}")
        return float(first), float(last)

    def holds(self, x: np.ndarray, clearance: float | np.ndarray | None = None) -> np.ndarray:
        """Whether spheres centred at `x` [m], shape [n, 3], lie inside and keep `clearance` [m] (of each, shape [n];
        none: the room's) from walls."""
        clearance = self.clearance if clearance is None else clearance
        inside = np.ones(len(x), bool)
        for shape in self.shapes:
            inside &= shape.distance(x) >= clearance
        if not len(self.plates):
            return inside
        u = np.hypot(x[:, 0], x[:, 1]) if self.round else x[:, 0]
        if self.round:
            inside &= u <= self.x[1] + self.clearance - clearance
        beneath = np.full(len(x), any(_axis(plane) == (2, 1) for plane in self.planes))
        for start, end in self.plates:
            along = end - start
            if along[0] != 0:
                across = (u - start[0]) / along[0]
                beneath |= (across >= 0) & (across <= 1) & (x[:, 2] - start[1] > across * along[1])
        return inside & beneath

    def draw(self, rng: np.random.Generator, n: int, top: float) -> np.ndarray:
        """Those of `n` uniform points up to z = `top` that are inside."""
        low = (self.x[0], self.y[0], self.bottom + self.clearance)
        points = rng.uniform(low, (self.x[1], self.y[1], top), (n, 3))
        return points[self.holds(points)]

    def draw_each(
        self, rng: np.random.Generator, clearance: np.ndarray, top: float, low: float | None = None
    ) -> np.ndarray:
        """One uniform point up to z = `top` between the sides for each grain of this clearance [m], inside or not;
        `low`: from this z on (None: from where it touches the bottom)."""
        nearer = (self.clearance - clearance)[:, None] * (1, 0 if self.flat else 1, 1)
        least = np.array([self.x[0], self.y[0], self.bottom + self.clearance]) - nearer
        if low is not None:
            least[:, 2] = low
        most = np.array([self.x[1], self.y[1], top]) + nearer * (1, 1, 0)
        return rng.uniform(least, most)

    def height_for(self, volume: float) -> float:
        """z [m] up to which the container, walls included, holds `volume` [m^3].

        Its section is counted on a grid of 200 x 400 points; what lies above is as wide as the widest part.
        """
        key = repr(self.shapes), self.clearance, self.flat, volume
        if key not in _HEIGHTS:
            _HEIGHTS[key] = self._counted_height(volume)
        return _HEIGHTS[key]

    def _counted_height(self, volume: float) -> float:
        wide, deep = self._size
        area = math.pi / 4 * wide * deep if self.round else wide * deep
        flat = self.bottom + volume / area
        across = np.linspace(0 if self.round else self.x[0], self.x[1], 200)
        u, z = (a.ravel() for a in np.meshgrid(across, np.linspace(self.bottom, flat, 400)))
        held = self.holds(np.column_stack([u, np.full(len(u), sum(self.y) / 2), z]))
        part = np.average(held, weights=u if self.round else None)
        return flat + (1 - float(part)) * (flat - self.bottom) + 2 * self.clearance


def first_come(kept: np.ndarray, pairs: np.ndarray) -> None:
    """Let go of the second of each of `pairs` (first < second) that are in each other's way."""
    stays = kept.tolist()
    for first, second in pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))].tolist():  # lists are quicker one by one
        # the first's fate is settled before it decides the second's
        if stays[first]:
            stays[second] = False
    kept[:] = stays


def full(count: int) -> PlacingError:
    """That so many grains do not fit."""
    return PlacingError(f"{count} grains found no room in the container; make it wider or use fewer grains")


def _axis(plane: Plane) -> tuple[int, int] | None:
    """Axis and sense of a plane's normal where it points along one, else None."""
    along = [(axis, int(math.copysign(1, c))) for axis, c in enumerate(plane.normal) if c != 0]
    return along[0] if len(along) == 1 else None
