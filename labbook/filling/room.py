"""The inside of a closed container, where grains can be placed."""

import math
from collections.abc import Callable, Iterator

import numpy as np

from labbook.scene import Container, Frustum, Plane, Strip

_COUNTED: dict[tuple[str, float, bool, str, float], float] = {}
"""Heights and volumes that a `Room` counted, by walls, clearance, flatness, which of the two, and its argument:
counting takes longer than placing a thousand grains, and every seed of a scene asks for it."""


DENSEST = math.pi / math.sqrt(12)
"""Solid fraction that neither spheres of any sizes within labbook's limits nor rods side by side exceed by much."""
JAMMED = 0.55
"""Solid fraction that equal spheres placed at random never reach: 0.38 in space, 0.36 in a layer, 0.50 in a row."""
_LEVELS = 400
_DOUBLINGS = 20


class PlacingError(Exception):
    """Grains cannot be placed; the message says why and what to do."""


class Full(Exception):
    """No further grain found a place; `placed`: how many did."""

    def __init__(self, placed: int):
        super().__init__(f"{placed} grains found a place")
        self.placed = placed


class Room:
    """In front of every plane, above and between all plates, seen in one section, and clear of all other walls.

    The section of strips is the x-z plane; that of frustums is the plane of radius and height. What the section shows
    along its first axis is called `u`.
    """

    def __init__(self, closed: Container, clearance: float, flat: bool = False):
        """`clearance`: what the centres of grains, or of the ends of rods, keep from walls [m]; `flat`: only the plane
        y = 0 of it. Raises PlacingError."""
        self.shapes = [wall.shape for wall in closed.walls()]
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
        self.bottom = max(float(min(lowest)), _start_of(closed))
        self.poured = any(wall.opens for wall in closed.walls())
        """Whether nothing lies below a plate: what parts that open let out goes on to where plates cover the room."""
        upright = self.plates[:, 0, 0] == self.plates[:, 1, 0]
        self.highest = float(np.max(np.where(upright, self.plates[..., 1].min(axis=1), self.plates[..., 1].max(axis=1)),
                                    initial=self.bottom))  # fmt: skip
        """z [m] above which the room has the same section everywhere, as far as plates and upright planes bound it."""

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
        covered = np.zeros(len(x), bool)
        for start, end in self.plates:
            along = end - start
            if along[0] != 0:
                across = (u - start[0]) / along[0]
                beside, above = (across >= 0) & (across <= 1), x[:, 2] - start[1] > across * along[1]
                beneath |= beside & above
                covered |= beside & ~above
        return inside & beneath & ~(covered & self.poured)

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

    def tops(self, volume: float, solid: float, most: float = DENSEST) -> Iterator[float]:
        """z [m] up to which grains of the volume `solid` [m^3] are placed, to have `volume` [m^3] between them: the
        heights to try, one after another.

        The first is the quicker estimate of `height_for`, which is too low where little of the container is as wide as
        its widest part, as in a wide cone. It is left out where grains would need more than the solid fraction `most`
        below it. Raises PlacingError where there is no room at all.
        """
        first = self.height_for(volume)
        fits = solid <= most * self._once("volume", first + self.clearance, self._volume_below)
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
        """z [m] up to which the container, walls included, holds `volume` [m^3], estimated.

        Its section is counted on a grid of 200 x 400 points up to where a straight container would hold the volume;
        what lies above is as wide as the widest part.
        """
        return self._once("height", volume, self._counted_height)

    def _once(self, name: str, of: float, count: Callable[[float], float]) -> float:
        key = repr(self.shapes), self.clearance, self.flat, name, of
        if key not in _COUNTED:
            _COUNTED[key] = count(of)
        return _COUNTED[key]

    def _counted_height(self, volume: float) -> float:
        wide, deep = self._size
        area = math.pi / 4 * wide * deep if self.round else wide * deep
        flat = self.bottom + volume / area
        across = np.linspace(0 if self.round else self.x[0], self.x[1], 200)
        u, z = (a.ravel() for a in np.meshgrid(across, np.linspace(self.bottom, flat, 400)))
        held = self.holds(np.column_stack([u, np.full(len(u), sum(self.y) / 2), z]))
        part = np.average(held, weights=u if self.round else None)
        return flat + (1 - float(part)) * (flat - self.bottom) + 2 * self.clearance

    def level_for(self, volume: float) -> float | None:
        """z [m] below which there is room of `volume` [m^3] for the centres of grains; None if there never is, infinite
        if there is none for any."""
        wide, deep = self._size
        high = volume / (math.pi / 4 * wide * deep if self.round else wide * deep)
        some = False
        for _ in range(_DOUBLINGS):
            z = np.linspace(self.bottom, self.bottom + high, _LEVELS)
            below = self._filled(z, self.clearance)
            if below[-1] >= volume:
                return float(np.interp(volume, below, z))
            high *= 2
            some = some or bool(below[-1])
        return None if some else math.inf

    def _volume_below(self, top: float) -> float:
        """Volume [m^3] of the container below z = `top` [m], walls excluded."""
        return float(self._filled(np.linspace(self.bottom, top, _LEVELS), 0.0)[-1])

    def _filled(self, z: np.ndarray, clearance: float) -> np.ndarray:
        """Volume [m^3] below each of the equidistant heights `z` [m], shape [n], that keeps `clearance` [m] from walls,
        counted on a grid of 200 points across."""
        wide, deep = self._size
        area = math.pi / 4 * wide * deep if self.round else wide * deep
        across = np.linspace(0 if self.round else self.x[0], self.x[1], 200)
        height, u = (a.ravel() for a in np.meshgrid(z, across, indexing="ij"))
        held = self.holds(np.column_stack([u, np.full(len(u), sum(self.y) / 2), height]), clearance)
        part = np.average(held.reshape(len(z), -1), axis=1, weights=across if self.round else None)
        return np.concatenate([[0.0], np.cumsum((part[1:] + part[:-1]) / 2 * np.diff(z) * area)])


def _start_of(closed: Container) -> float:
    """z [m] above which a filling starts: the lowest part that opens; of containers without one the outlet's plane."""
    opening = [wall.shape.ground for wall in closed.walls() if wall.opens]
    plane = closed.outlet_plane
    return min(filter(math.isfinite, opening), default=-math.inf if plane is None else plane)


def first_come(kept: np.ndarray, pairs: np.ndarray) -> None:
    """Let go of the second of each of `pairs` (first < second) that are in each other's way."""
    stays = kept.tolist()
    for first, second in pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))].tolist():  # lists are quicker one by one
        # the first's fate is settled before it decides the second's
        if stays[first]:
            stays[second] = False
    kept[:] = stays


def _axis(plane: Plane) -> tuple[int, int] | None:
    """Axis and sense of a plane's normal where it points along one, else None."""
    along = [(axis, int(math.copysign(1, c))) for axis, c in enumerate(plane.normal) if c != 0]
    return along[0] if len(along) == 1 else None
