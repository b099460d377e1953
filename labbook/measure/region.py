"""The bulk of a packing: away from side walls, bottom and free surface, which all disturb it."""

from dataclasses import dataclass

import numpy as np

from labbook.measure.measure import MeasureError
from labbook.protocol.packing import Packing
from labbook.scene import Box, Scene, WedgeHopper
from labbook.scene.walls import Strip

MARGIN = 3.0
"""Grain diameters between the bulk and walls or surface."""
_COLUMN = 3.0


@dataclass(frozen=True)
class Region:
    """A box from `low` to `high` [m]; `planar`: a single layer of grains between a front and a back wall."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    planar: bool

    @property
    def size(self) -> tuple[float, float, float]:
        """Extents [m] along x, y, z; negative where nothing is left of the bulk."""
        x, y, z = (b - a for a, b in zip(self.low, self.high, strict=True))
        return x, y, z

    def cells(self, n: int) -> list["Region"]:
        """n x n equal parts in x and z."""
        xs = np.linspace(self.low[0], self.high[0], n + 1)
        zs = np.linspace(self.low[2], self.high[2], n + 1)
        y0, y1 = self.low[1], self.high[1]
        return [Region((xs[i], y0, zs[k]), (xs[i + 1], y1, zs[k + 1]), self.planar) for i in range(n) for k in range(n)]

    def holds(self, x: np.ndarray) -> np.ndarray:
        """Which centres, shape [n, 3], lie inside; shape [n]."""
        return np.all((x >= self.low) & (x < self.high), axis=1)


def bulk(scene: Scene, packing: Packing) -> Region:
    """The bulk of `packing`: 3 d from the side walls, above the highest point of the bottom and below the
    surface.

    Between front and back walls less than 2 d apart it is as thick as the container; otherwise it keeps 3 d
    from them as well. The surface is the lowest of the heights of columns 3 d wide. Raises MeasureError for
    containers without known walls.
    """
    container, d = scene.container, scene.grains.diameter
    if isinstance(container, WedgeHopper):
        width, depth = container.width, container.thickness
        bottoms = [
            wall.shape for wall in container.walls() if wall.name.startswith("bottom") and isinstance(wall.shape, Strip)
        ]
        floor = max(max(plate.start[1], plate.end[1]) for plate in bottoms)
    elif isinstance(container, Box):
        width, depth, floor = container.width, container.depth, 0.0
    else:
        raise MeasureError("measure: packing needs a wedge-hopper or a box, whose bulk is known")
    planar = depth < 2 * d
    x = width / 2 - MARGIN * d
    y = depth / 2 if planar else depth / 2 - MARGIN * d
    top = _surface(packing, width, depth, d, planar, floor) - MARGIN * d
    return Region((-x, -y, floor + MARGIN * d), (x, y, top), planar)


def _surface(packing: Packing, width: float, depth: float, d: float, planar: bool, floor: float) -> float:
    """Height [m] of the lowest column's highest grain; `floor` if a column is empty."""
    x, size = packing.x, d if packing.diameter is None else packing.diameter
    across = max(1, round(width / (_COLUMN * d)))
    along = 1 if planar else max(1, round(depth / (_COLUMN * d)))
    i = np.clip(((x[:, 0] / width + 0.5) * across).astype(int), 0, across - 1)
    j = np.clip(((x[:, 1] / depth + 0.5) * along).astype(int), 0, along - 1)
    height = np.full(across * along, floor)
    np.maximum.at(height, i * along + j, x[:, 2] + size / 2)
    return float(height.min())
