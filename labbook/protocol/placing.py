"""Where grains are before they fall: a seeded random start in the column above a closed container's bottom.

Random sequential addition: uniformly drawn positions are taken one after another wherever they overlap
neither a wall nor a grain already there, so no lattice is left for the packing to remember. Both starts lie
well below the density at which random addition jams (solid fraction 0.38 in 3D, area fraction 0.547 in 2D:
Torquato & Stillinger, Rev. Mod. Phys. 82 (2010) 2633), and are low enough that the fall is short.
"""

import math

import numpy as np

from labbook.protocol.assortment import assort
from labbook.protocol.packing import Packing
from labbook.scene import Plane, Scene, Strip

VERSION = 1
"""Part of every packing's key; raise it whenever a seed gives other positions than before."""

DENSITY = {"gas": 0.25, "rain": 0.12}
"""Solid fraction of the start."""
SPEED = {"gas": 1.0, "rain": 0.1}
"""Standard deviation of each velocity component, in units of sqrt(g d)."""
_APART = 1 + 1e-6  # nothing touches at the start
_ROUNDS = 2000
_NEARLY = 0.9


class PlacingError(Exception):
    """Grains cannot be placed; the message says why and what to do."""


def place(closed: Scene, kind: str, seed: int) -> Packing:
    """Grains of `closed` at rest-free random places above its bottom, for `kind` `gas` or `rain`.

    `gas` is denser and moves with Gaussian velocities of sqrt(g d) each way; `rain` is a taller, more dilute
    column that moves ten times slower, so that grains land one after another. The seed decides positions in
    all three directions, velocities, and where grains differ, which is of which size and kind; nothing spins. Raises
    PlacingError where the container has no sides or no gravity.
    """
    grains = closed.grains
    if closed.gravity == 0:
        raise PlacingError("a filling needs gravity: grains would never come to rest (gravity is 0)")
    rng = np.random.default_rng([VERSION, seed])
    diameter, sort = assort(grains, VERSION, seed) if grains.varied else (None, None)
    if diameter is None:
        x = _equal(closed, rng, DENSITY[kind])
    else:
        x = _of_sizes(closed, rng, DENSITY[kind], diameter)
    speed = SPEED[kind] * math.sqrt(closed.gravity * grains.diameter)
    return Packing(x=x, v=rng.normal(0, speed, x.shape), omega=np.zeros_like(x), diameter=diameter, kind=sort)


def _equal(closed: Scene, rng: np.random.Generator, density: float) -> np.ndarray:
    """Places [m] of equal grains, shape [n, 3]."""
    grains = closed.grains
    room = _Room(closed)
    top = room.height_for(grains.count * math.pi / 6 * grains.diameter**3 / density)
    x = np.empty((0, 3))
    for _ in range(_ROUNDS):
        wanted = grains.count - len(x)
        if wanted == 0:
            return x
        drawn = room.draw(rng, 2 * wanted + 16, top)
        x = np.concatenate([x, _apart(drawn, x, grains.diameter * _APART)])[: grains.count]
    raise _full(grains.count)


def _of_sizes(closed: Scene, rng: np.random.Generator, density: float, diameter: np.ndarray) -> np.ndarray:
    """Places [m] of grains of these diameters [m], shape [n, 3].

    Large grains come first, as they would find no room among small ones: at a time, those of nearly the largest size
    that is left, each of which tries one place a round.
    """
    room, clearance = _Room(closed), diameter / 2 * _APART
    top = room.height_for(float(np.sum(diameter**3)) * math.pi / 6 / density)
    x, left = np.empty((len(diameter), 3)), np.arange(len(diameter))
    placed = left[:0]
    for _ in range(_ROUNDS):
        if len(left) == 0:
            return x
        trying = left[diameter[left] >= _NEARLY * diameter[left].max()]
        x[trying] = room.draw_each(rng, clearance[trying], top)
        inside = trying[room.holds(x[trying], clearance[trying])]
        free = _free(x, diameter, placed, inside)
        placed = np.concatenate([placed, free])
        left = np.setdiff1d(left, free, assume_unique=True)
    raise _full(len(diameter))


def _free(x: np.ndarray, diameter: np.ndarray, placed: np.ndarray, trying: np.ndarray) -> np.ndarray:
    """Those of the grains `trying`, in their order, that touch neither grains `placed` nor each other."""
    from scipy.spatial import KDTree

    both = np.concatenate([placed, trying])
    order, kept = len(placed), np.ones(len(both), bool)
    pairs = KDTree(x[both]).query_pairs(diameter.max() * _APART, output_type="ndarray")
    first, second = both[pairs].T
    near = np.linalg.norm(x[first] - x[second], axis=1) < (diameter[first] + diameter[second]) / 2 * _APART
    pairs = pairs[near & (pairs[:, 1] >= order)]
    for one, other in pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]:
        if kept[one]:  # as in `_apart`
            kept[other] = False
    return trying[kept[order:]]


def _full(count: int) -> PlacingError:
    return PlacingError(f"{count} grains found no room in the container; make it wider or use fewer grains")


def _apart(drawn: np.ndarray, there: np.ndarray, distance: float) -> np.ndarray:
    """Those of `drawn`, in their order, that keep `distance` from `there` and from each other."""
    from scipy.spatial import KDTree

    if len(there) and len(drawn):
        drawn = drawn[KDTree(there).query(drawn)[0] >= distance]
    kept = np.ones(len(drawn), bool)
    if len(drawn) > 1:
        pairs = KDTree(drawn).query_pairs(distance, output_type="ndarray")
        for first, second in pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]:
            # query_pairs gives first < second: the first's fate is settled before it decides the second's
            if kept[first]:
                kept[second] = False
    return drawn[kept]


class _Room:
    """The inside of a closed container: in front of every plane, and above and between its strips."""

    def __init__(self, closed: Scene):
        shapes = [wall.shape for wall in closed.container.walls()]
        self.clearance = closed.grains.radius * _APART
        self.planes = [shape for shape in shapes if isinstance(shape, Plane)]
        self.strips = [shape for shape in shapes if isinstance(shape, Strip)]
        ends = np.array([end for strip in self.strips for end in (strip.start, strip.end)]).reshape(-1, 2)
        self.x = self._range(0, list(ends[:, 0]))
        self.y = self._range(1, [])
        floor = [p.point[2] for p in self.planes if _axis(p) == (2, 1)]
        lowest = [*floor, *ends[:, 1]]
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
        """Whether grains centred at `x` [m], shape [n, 3], lie inside and keep `clearance` [m] from walls (none: that
        of the largest)."""
        clearance = self.clearance if clearance is None else clearance
        inside = np.ones(len(x), bool)
        for plane in self.planes:
            normal = np.array(plane.normal) / np.linalg.norm(plane.normal)
            inside &= (x - plane.point) @ normal >= clearance
        if not self.strips:
            return inside
        beneath = np.zeros(len(x), bool)
        for strip in self.strips:
            start, along = np.array(strip.start), np.array(strip.end) - strip.start
            at = x[:, [0, 2]] - start
            part = np.clip(at @ along / (along @ along), 0, 1)
            inside &= np.linalg.norm(at - part[:, None] * along, axis=1) >= clearance
            if along[0] != 0:
                across = at[:, 0] / along[0]
                beneath |= (across >= 0) & (across <= 1) & (at[:, 1] > across * along[1])
        return inside & (beneath | self._floored(x))

    def _floored(self, x: np.ndarray) -> np.ndarray:
        return np.full(len(x), any(_axis(plane) == (2, 1) for plane in self.planes))

    def draw(self, rng: np.random.Generator, n: int, top: float) -> np.ndarray:
        """Those of `n` uniform points up to z = `top` that are inside."""
        low = (self.x[0], self.y[0], self.bottom + self.clearance)
        points = rng.uniform(low, (self.x[1], self.y[1], top), (n, 3))
        return points[self.holds(points)]

    def draw_each(self, rng: np.random.Generator, clearance: np.ndarray, top: float) -> np.ndarray:
        """One uniform point up to z = `top` between the sides for each grain of this clearance [m], inside or not."""
        nearer = (self.clearance - clearance)[:, None]
        low = np.array([self.x[0], self.y[0], self.bottom + self.clearance]) - nearer
        high = np.array([self.x[1], self.y[1], top]) + nearer * (1, 1, 0)
        return rng.uniform(low, high)

    def height_for(self, volume: float) -> float:
        """z [m] up to which the container, walls included, holds `volume` [m^3].

        Widths are counted on a grid of 200 x 400 points; what lies above is as wide as the widest part.
        """
        wide, deep = (r[1] - r[0] + 2 * self.clearance for r in (self.x, self.y))
        flat = self.bottom + volume / (wide * deep)
        span = flat - self.bottom
        points = np.stack(np.meshgrid(np.linspace(*self.x, 200), np.linspace(self.bottom, flat, 400)), -1).reshape(
            -1, 2
        )
        middle = np.full(len(points), sum(self.y) / 2)
        held = self.holds(np.column_stack([points[:, 0], middle, points[:, 1]])).mean()
        return flat + (1 - float(held)) * span + 2 * self.clearance


def _axis(plane: Plane) -> tuple[int, int] | None:
    """Axis and sense of a plane's normal where it points along one, else None."""
    along = [(axis, int(math.copysign(1, c))) for axis, c in enumerate(plane.normal) if c != 0]
    return along[0] if len(along) == 1 else None
