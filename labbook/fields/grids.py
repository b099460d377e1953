"""Grids on which fields are evaluated: centres of cells in a layer, in space, or averaged over the azimuth.

Arrays of a grid have its `shape`, with z last but one in a layer (rows of z, columns of x), as `axes` says.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

Span = tuple[float, float]


def _middles(span: Span, n: int) -> np.ndarray:
    edges = np.linspace(*span, n + 1)
    return (edges[1:] + edges[:-1]) / 2


def _check(**spans: tuple[Span, int]) -> None:
    for name, ((low, high), n) in spans.items():
        if not high > low or n < 1:
            raise ValueError(f"a grid needs at least one cell between {name} = {low} and {high}")


@dataclass(frozen=True)
class Layer:
    """The x-z plane of a quasi-2D silo whose front and back walls are `depth` [m] apart; kernels are discs."""

    x: Span
    z: Span
    nx: int
    nz: int
    depth: float
    axes: ClassVar[tuple[str, ...]] = ("z", "x")
    components: ClassVar[str] = "xyz"
    dimensions: ClassVar[int] = 2

    def __post_init__(self):
        _check(x=(self.x, self.nx), z=(self.z, self.nz))

    @property
    def shape(self) -> tuple[int, ...]:
        return self.nz, self.nx

    @property
    def points(self) -> tuple[np.ndarray, ...]:
        """Coordinates [m] along each of `axes`."""
        return _middles(self.z, self.nz), _middles(self.x, self.nx)

    @property
    def volumes(self) -> np.ndarray:
        """Volume of every cell [m^3], of the grid's shape."""
        area = (self.x[1] - self.x[0]) * (self.z[1] - self.z[0]) / (self.nx * self.nz)
        return np.full(self.shape, area * self.depth)


@dataclass(frozen=True)
class Space:
    """A box in space; kernels are balls."""

    x: Span
    y: Span
    z: Span
    nx: int
    ny: int
    nz: int
    axes: ClassVar[tuple[str, ...]] = ("z", "y", "x")
    components: ClassVar[str] = "xyz"
    dimensions: ClassVar[int] = 3

    def __post_init__(self):
        _check(x=(self.x, self.nx), y=(self.y, self.ny), z=(self.z, self.nz))

    @property
    def shape(self) -> tuple[int, ...]:
        return self.nz, self.ny, self.nx

    @property
    def points(self) -> tuple[np.ndarray, ...]:
        """Coordinates [m] along each of `axes`."""
        return _middles(self.z, self.nz), _middles(self.y, self.ny), _middles(self.x, self.nx)

    @property
    def volumes(self) -> np.ndarray:
        """Volume of every cell [m^3], of the grid's shape."""
        whole = np.prod([high - low for low, high in (self.x, self.y, self.z)])
        return np.full(self.shape, whole / np.prod(self.shape))


@dataclass(frozen=True)
class Ring:
    """Half planes through the axis x = y = 0, averaged over the azimuth: r from 0 to `radius`; kernels are balls.

    Vectors and tensors are taken in the cylindrical axes of the point at which they are evaluated, r, t (azimuthal,
    counter-clockwise) and z, before the mean over the azimuth.
    """

    radius: float
    z: Span
    nr: int
    nz: int
    axes: ClassVar[tuple[str, ...]] = ("r", "z")
    components: ClassVar[str] = "rtz"
    dimensions: ClassVar[int] = 3

    def __post_init__(self):
        _check(r=((0.0, self.radius), self.nr), z=(self.z, self.nz))

    @property
    def shape(self) -> tuple[int, ...]:
        return self.nr, self.nz

    @property
    def points(self) -> tuple[np.ndarray, ...]:
        """Coordinates [m] along each of `axes`."""
        return _middles((0.0, self.radius), self.nr), _middles(self.z, self.nz)

    @property
    def volumes(self) -> np.ndarray:
        """Volume of every ring [m^3], of the grid's shape."""
        dr, dz = self.radius / self.nr, (self.z[1] - self.z[0]) / self.nz
        return np.repeat(2 * np.pi * self.points[0] * dr * dz, self.nz).reshape(self.shape)


Grid = Layer | Space | Ring
