"""Bins of walls, in which forces between walls and grains are added up: by height, and of level walls by radius or x.

Bins begin where a wall does, so that none holds a corner.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from labbook.scene.container_shape import ContainerShape
from labbook.scene.scene import Scene
from labbook.scene.walls import Frustum, Plane, Strip, Wall, WallShape

Along = Literal["height", "radius", "x"]
"""Coordinate of a wall's bins: z, the distance from the axis x = y = 0, or x."""
_LARGEST_COUNT = 256
"""Largest number of bins of a wall."""
_DEFAULT_COUNT = 64
"""Number of bins of a wall without an end, under a bed of unknown height."""
_LOOSE = 0.4
"""Packing fraction by which a bed of known volume is taken to be no higher than it can be."""
_HEADROOM = 8.0
"""Grain lengths that are added to that height."""


@dataclass(frozen=True)
class WallBins:
    """Bins of one wall along a coordinate.

    Attributes:
        name: Name of the wall.
        along: Coordinate.
        low: Lower end of the first bin [m].
        size: Width of a bin [m].
        count: Number of bins; the last one also takes everything beyond it.
    """

    name: str
    along: Along
    low: float
    size: float
    count: int

    @property
    def edges(self) -> np.ndarray:
        """Ends [m] of the bins, shape [count + 1]."""
        return self.low + self.size * np.arange(self.count + 1)


def all_walls(container: ContainerShape) -> tuple[Wall, ...]:
    """Walls of a container, and after them those that only the closed one has, such as a lid."""
    own = container.walls()
    names = {wall.name for wall in own}
    return (*own, *(wall for wall in container.close().walls() if wall.name not in names))


def bins_of_walls(scene: Scene, walls: tuple[Wall, ...], size: float) -> tuple[WallBins, ...]:
    """Divide walls into bins. Walls of one name have the same bins in the open container and in the closed one.

    Args:
        scene: Scene.
        walls: Walls of its container, open or closed.
        size: Width of a bin [m].

    Returns:
        Bins of each wall.
    """
    top = _highest(scene)
    return tuple(_bins(scene.container, wall, size, top) for wall in walls)


def areas(container: ContainerShape, wall: Wall, bins: WallBins) -> np.ndarray:
    """Compute the area of a wall within each of its bins.

    Args:
        container: Container of the wall.
        wall: Wall.
        bins: Its bins.

    Returns:
        Areas [m^2], shape [count]; NaN if the shape does not tell.
    """
    area = _area_up_to(container, wall.shape, bins.along)
    if area is None:
        return np.full(bins.count, math.nan)
    return np.diff([area(float(edge)) for edge in bins.edges])


def is_level(shape: WallShape) -> bool:
    """True for a horizontal plane or plate."""
    low, high = shape.bounds.low[2], shape.bounds.high[2]
    return math.isfinite(low) and high - low <= 0


def is_upright(wall: Wall) -> bool:
    """True for a vertical wall."""
    shape = wall.shape
    return not is_level(shape) and shape.prismatic_above <= shape.bounds.low[2]


def _along(container: ContainerShape, shape: WallShape) -> Along:
    if not is_level(shape):
        return "height"
    return "radius" if container.symmetry == "axial" or "planar" not in shape.symmetries else "x"


def _bins(container: ContainerShape, wall: Wall, size: float, top: float) -> WallBins:
    along, bounds, within = _along(container, wall.shape), wall.shape.bounds, container.bounds
    if along == "height":
        low = bounds.low[2] if math.isfinite(bounds.low[2]) else within.low[2]
        low = low if math.isfinite(low) else 0.0
        high = min(bounds.high[2], top, container.roof)
    elif along == "radius":
        low, high = 0.0, wall.shape.reach
        if not math.isfinite(high):
            high = math.hypot(*(max(abs(a), abs(b)) for a, b in zip(within.low[:2], within.high[:2], strict=True)))
    else:
        low, high = max(bounds.low[0], within.low[0]), min(bounds.high[0], within.high[0])
        if within.size[0] < math.inf:  # so that the parts of a bottom have the bins of the whole
            low = within.low[0]
    if not math.isfinite(low):
        low = -_DEFAULT_COUNT * size / 2
    count = math.ceil((high - low) / size - 1e-9) if math.isfinite(high) else _DEFAULT_COUNT
    return WallBins(wall.name, along, low, size, min(max(count, 1), _LARGEST_COUNT))


def _highest(scene: Scene) -> float:
    """Height z [m] below which all contacts of a settled bed with walls are; infinite if that is unknown."""
    container, grains = scene.container, scene.grains
    volume = grains.count * grains.volume / _LOOSE
    if container.volume_below(0.0) is None:
        return math.inf
    high = grains.extent
    while (below := container.volume_below(high)) is not None and below < volume:
        high *= 1.25
    return _floor(container) + high + _HEADROOM * grains.extent


def _floor(container: ContainerShape) -> float:
    """Height z [m] from which a container counts its volume."""
    return container.outlets[0].plane if container.outlets else 0.0


def _area_up_to(container: ContainerShape, shape: WallShape, along: Along) -> Callable[[float], float] | None:
    """Area [m^2] of a wall up to a value of its coordinate, or None."""
    depth = container.front_to_back
    if isinstance(shape, Frustum):
        return _of_frustum(shape, along)
    if isinstance(shape, Strip) and math.isfinite(depth):
        (x0, z0), (x1, z1) = sorted((shape.start, shape.end), key=lambda end: end[1 if along == "height" else 0])
        low, high = (z0, z1) if along == "height" else (x0, x1)
        length = math.hypot(x1 - x0, z1 - z0)
        return lambda at: depth * length * min(max((at - low) / (high - low), 0.0), 1.0)
    if isinstance(shape, Plane):
        return _of_plane(container, shape, along)
    return None


def _of_frustum(shape: Frustum, along: Along) -> Callable[[float], float]:
    (r0, z0), (r1, z1) = shape.lower, shape.upper
    slant, rise, run = math.hypot(r1 - r0, z1 - z0), z1 - z0, r1 - r0

    def up_to(at: float) -> float:
        fraction = min(max((at - z0) / rise if along == "height" else (at - r0) / run, 0.0), 1.0)
        area = math.pi * (2 * r0 + run * fraction) * slant * fraction  # from the inner edge on
        return area if along == "radius" or rise > 0 else -area

    return up_to


def _of_plane(container: ContainerShape, shape: Plane, along: Along) -> Callable[[float], float] | None:
    depth, floor = container.front_to_back, _floor(container)
    x, y, z = (abs(component) > 0 for component in shape.normal)
    bounds = container.bounds
    if along == "radius" and container.across is not None:
        widest = container.across / 2
        return lambda at: math.pi * min(at, widest) ** 2
    if along == "x" and math.isfinite(depth):
        return lambda at: depth * (min(max(at, bounds.low[0]), bounds.high[0]) - bounds.low[0])
    if along != "height" or z or not math.isfinite(depth):
        return None
    if y and not x and container.volume_below(0.0) is not None:
        return lambda at: (container.volume_below(max(at - floor, 0.0)) or 0.0) / depth
    if x and not y:
        return lambda at: depth * max(at - floor, 0.0)
    return None
