"""The bulk of a packing: away from side walls, bottom and free surface, which all disturb it."""

import math
from dataclasses import dataclass

import numpy as np

from labbook.fields import axes
from labbook.measure.clipped import rod_in_box, rod_in_ring, sphere_in_box, sphere_in_ring
from labbook.measure.measure import MeasureError
from labbook.scene import Clumps, Grains, Scene, Spherocylinders
from labbook.scene.hulls import sphere_centres, upper_reach
from labbook.scene.packing import Packing

MARGIN = 3.0
"""Grain diameters between the bulk and walls or surface; at least the length of a grain."""
SMALLEST = 4.0
"""Extent of the bulk in grain diameters below which it is too small to measure in; at least the length of a grain."""
_ALMOST = 1 - 1e-9
"""Part of an extent that counts as the whole of it: containers of 10 d are not narrower by round-off."""
_COLUMN = 3.0
_EMPTY = "nothing is left"


@dataclass(frozen=True, eq=False)
class Outlines:
    """Outlines of the grains of a packing.

    Attributes:
        x: Centres [m], shape [n, 3].
        radius: Radii [m], shape [n], or one for all.
        axis: Unit vectors along rods, shape [n, 3]; None for spheres.
        half_length: Half length of the segment between the centres of the caps of rods [m].
        volume_weight: Volume that counts of each outline, over its own: below 1 for overlapping spheres of clumps.
    """

    x: np.ndarray
    radius: np.ndarray | float
    axis: np.ndarray | None = None
    half_length: float = 0.0
    volume_weight: float = 1.0

    @classmethod
    def of(cls, packing: Packing, grains: Grains) -> "Outlines":
        """Take the outlines of the grains of a packing.

        Clumps are their spheres, of which each counts by the same part of its volume, so that they add up to the union.
        So a clump that a face cuts counts too much or too little. Over all its places the mean is right.

        Args:
            packing: The packing.
            grains: Grains of the scene.
        """
        q = packing.q
        if isinstance(grains, Clumps) and q is not None:
            radii = [sphere.radius for sphere in grains.spheres]
            weight = grains.volume / sum(4 / 3 * math.pi * r**3 for r in radii)
            return cls(sphere_centres(grains, packing.x, q), np.tile(radii, len(packing)), volume_weight=weight)
        if isinstance(grains, Spherocylinders) and q is not None and not grains.round:
            return cls(packing.x, grains.radius, axes(q), grains.half_length)
        return cls(packing.x, grains.radius if packing.diameter is None else packing.diameter / 2)

    @property
    def reach(self) -> float:
        """Largest extent of a grain from its centre [m]."""
        return float(np.max(self.radius, initial=0.0)) + self.half_length

    @property
    def volumes(self) -> np.ndarray:
        """Volume of each grain [m^3], shape [n]."""
        r = np.broadcast_to(np.asarray(self.radius, float), len(self.x))
        return self.volume_weight * (math.pi * r**2 * 2 * self.half_length + 4 / 3 * math.pi * r**3)

    def only(self, mask: np.ndarray) -> "Outlines":
        """Select grains by a mask, shape [n]."""
        radius = self.radius[mask] if isinstance(self.radius, np.ndarray) else self.radius
        axis = None if self.axis is None else self.axis[mask]
        return Outlines(self.x[mask], radius, axis, self.half_length, self.volume_weight)


@dataclass(frozen=True)
class Region:
    """Bulk of the shape of a box.

    Attributes:
        low: Corner with the smallest coordinates [m].
        high: Opposite corner [m].
        planar: True for a single layer of grains between a front and a back wall.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    planar: bool

    @property
    def size(self) -> tuple[float, float, float]:
        """Extents [m] along x, y, z; negative where nothing is left of the bulk."""
        x, y, z = (b - a for a, b in zip(self.low, self.high, strict=True))
        return x, y, z

    @property
    def volume(self) -> float:
        """Volume [m^3]."""
        return math.prod(self.size)

    def smaller_than(self, extent: float) -> bool:
        """True if it is narrower or lower than `extent` [m]; the thickness of a layer does not count."""
        return min(self.size[0], self.size[2]) < extent * _ALMOST or self.size[1] <= 0

    def cells(self, n: int) -> list["Region"]:
        """Divide it into n x n equal parts in x and z."""
        xs = np.linspace(self.low[0], self.high[0], n + 1)
        zs = np.linspace(self.low[2], self.high[2], n + 1)
        y0, y1 = self.low[1], self.high[1]
        return [Region((xs[i], y0, zs[k]), (xs[i + 1], y1, zs[k + 1]), self.planar) for i in range(n) for k in range(n)]

    def holds(self, x: np.ndarray) -> np.ndarray:
        """Mask of the centres x [m], shape [n, 3], that lie inside; shape [n]."""
        return np.all((x >= self.low) & (x < self.high), axis=1)

    def filled(self, bodies: Outlines) -> float:
        """Volume [m^3] of grains within; those that its faces cut count in part."""
        low, high, reach = np.array(self.low), np.array(self.high), bodies.reach
        near = bodies.only(np.asarray(np.all((bodies.x > low - reach) & (bodies.x < high + reach), axis=1)))
        if near.axis is None:
            return near.volume_weight * float(sphere_in_box(near.x, near.radius, self.low, self.high).sum())
        whole = np.asarray(np.all((near.x >= low + reach) & (near.x <= high - reach), axis=1))
        cut = near.only(~whole)
        assert cut.axis is not None
        assert isinstance(cut.radius, float)
        # only rods that a face may cut are clipped: each takes 288 lines
        clipped = rod_in_box(cut.x, cut.axis, cut.radius, cut.half_length, self.low, self.high)
        return float(near.volumes[whole].sum() + clipped.sum())

    def __str__(self) -> str:
        (x0, _, z0), (x1, _, z1) = self.low, self.high
        if min(self.size) <= 0:
            return _EMPTY
        return f"x = {x0 * 1e3:.4g} to {x1 * 1e3:.4g} mm, z = {z0 * 1e3:.4g} to {z1 * 1e3:.4g} mm"


@dataclass(frozen=True)
class Annulus:
    """Bulk between two radii about the z axis and two heights.

    Attributes:
        inner: Inner radius [m].
        outer: Outer radius [m].
        low: Lower height [m].
        high: Upper height [m].
    """

    inner: float
    outer: float
    low: float
    high: float
    planar = False

    @property
    def volume(self) -> float:
        """Volume [m^3]."""
        return math.pi * (self.outer**2 - self.inner**2) * (self.high - self.low)

    def smaller_than(self, extent: float) -> bool:
        """True if it is narrower or lower than `extent` [m]."""
        return min(2 * self.outer, self.high - self.low) < extent * _ALMOST

    def cells(self, n: int) -> list["Annulus"]:
        """Divide it into n x n parts of equal volume: rings and heights."""
        radii = np.sqrt(np.linspace(self.inner**2, self.outer**2, n + 1))
        zs = np.linspace(self.low, self.high, n + 1)
        return [Annulus(radii[i], radii[i + 1], zs[k], zs[k + 1]) for i in range(n) for k in range(n)]

    def filled(self, bodies: Outlines) -> float:
        """Volume [m^3] of grains within; those that its faces cut count in part."""
        reach, off, z = bodies.reach, np.hypot(bodies.x[:, 0], bodies.x[:, 1]), bodies.x[:, 2]
        within = (off < self.outer + reach) & (off > self.inner - reach)
        near = bodies.only(within & (z > self.low - reach) & (z < self.high + reach))
        if near.axis is None:
            clipped = sphere_in_ring(near.x, near.radius, self.inner, self.outer, self.low, self.high)
            return near.volume_weight * float(clipped.sum())
        off, z = np.hypot(near.x[:, 0], near.x[:, 1]), near.x[:, 2]
        # Without an inner face, rods on the axis are whole too.
        within = (off <= self.outer - reach) & ((off >= self.inner + reach) | (self.inner == 0))
        whole = within & (z >= self.low + reach) & (z <= self.high - reach)
        cut = near.only(~whole)
        assert cut.axis is not None
        assert isinstance(cut.radius, float)
        clipped = rod_in_ring(cut.x, cut.axis, cut.radius, cut.half_length, self.inner, self.outer, self.low, self.high)
        return float(near.volumes[whole].sum() + clipped.sum())

    def __str__(self) -> str:
        if self.outer <= self.inner or self.high <= self.low:
            return _EMPTY
        return f"r = 0 to {self.outer * 1e3:.4g} mm, z = {self.low * 1e3:.4g} to {self.high * 1e3:.4g} mm"


def margin_of(grains: Grains) -> float:
    """Distance [m] of the bulk from walls and surface."""
    return max(MARGIN * grains.diameter, grains.extent)


def has_bulk(scene: Scene) -> bool:
    """True if the bulk of the container is known from its walls."""
    return scene.container.across is not None


def least_extent(grains: Grains) -> float:
    """Extent [m] of the bulk below which it is too small to measure in."""
    return max(SMALLEST * grains.diameter, grains.extent)


def bulk(scene: Scene, packing: Packing) -> Region | Annulus:
    """Find the bulk of a packing.

    It is 3 d (for rods at least their length) from the side walls, above the highest point of the bottom and below the
    surface. The surface is the lowest of the heights of columns 3 d wide. Between front and back walls less than 2 d
    apart it is as thick as the container; otherwise it keeps its distance from them as well. In a round silo it is a
    cylinder about the axis.

    Raises:
        MeasureError: The bulk of this kind of container is not known.
    """
    within = _sides(scene)
    around = within.width / 2 if within.round else math.inf
    columns = _columns(scene, within.planar)
    return bulk_below(
        scene, _lowest(packing.x, _tops(scene, packing), within.width, within.depth, columns, within.floor, around)
    )


def bulk_below(scene: Scene, surface: float) -> Region | Annulus:
    """Find the bulk of a bed whose surface is at the height `surface` [m], as `bulk` does."""
    margin, within = margin_of(scene.grains), _sides(scene)
    low, top = within.floor + margin, surface - margin
    if within.round:
        return Annulus(0.0, within.width / 2 - margin, low, top)
    x = within.width / 2 - margin
    y = within.depth / 2 if within.planar else within.depth / 2 - margin
    return Region((-x, -y, low), (x, y, top), within.planar)


def lowest_surface(scene: Scene) -> float:
    """Least height [m] of the surface of a bed whose bulk is high enough to measure in."""
    return _sides(scene).floor + 2 * margin_of(scene.grains) + least_extent(scene.grains)


@dataclass(frozen=True)
class _Sides:
    """Sides of a container.

    Attributes:
        width: Width of its widest section [m].
        depth: Depth of that section [m].
        floor: Height of the highest point of its bottom [m].
        planar: True for a single layer of grains.
        round: True for an axisymmetric container.
    """

    width: float
    depth: float
    floor: float
    planar: bool
    round: bool = False


def _sides(scene: Scene) -> _Sides:
    container, layer = scene.container, 2 * scene.grains.diameter
    if container.across is None:
        raise MeasureError("measure: packing needs a hopper, a silo or a box, whose bulk is known")
    if container.symmetry == "axial":
        return _Sides(container.across, container.across, container.rise, False, True)
    depth = container.front_to_back
    return _Sides(container.across, depth, container.rise, depth < layer)


def _tops(scene: Scene, packing: Packing) -> np.ndarray:
    """Height [m] of the highest point of each grain."""
    grains = scene.grains
    radius = grains.radius if packing.diameter is None else packing.diameter / 2
    return packing.x[:, 2] + upper_reach(grains, radius, packing.q)


def _columns(scene: Scene, planar: bool) -> tuple[float, float]:
    """Widths [m] of columns along x and y; a layer is one column thick."""
    width = max(_COLUMN * scene.grains.diameter, scene.grains.extent)
    return width, math.inf if planar else width


def _lowest(
    x: np.ndarray,
    tops: np.ndarray,
    width: float,
    depth: float,
    column: tuple[float, float],
    floor: float,
    around: float = math.inf,
) -> float:
    """Height [m] of the lowest column's highest grain; `floor` if a column is empty. Columns whose corners lie beyond
    the radius `around` [m] do not count: the wall leaves little room there."""
    across, along = (max(1, round(size / wide)) for size, wide in zip((width, depth), column, strict=True))
    i = np.clip(((x[:, 0] / width + 0.5) * across).astype(int), 0, across - 1)
    j = np.clip(((x[:, 1] / depth + 0.5) * along).astype(int), 0, along - 1)
    height = np.full(across * along, floor)
    np.maximum.at(height, i * along + j, tops)
    a, b = (np.maximum(*np.abs([e[:-1], e[1:]])) for e in (_edges(width, across), _edges(depth, along)))
    counts = np.hypot(a[:, None], b[None, :]).ravel() <= around
    return float(height[counts].min()) if counts.any() else float(height.max())


def _edges(size: float, count: int) -> np.ndarray:
    return np.linspace(-size / 2, size / 2, count + 1)
