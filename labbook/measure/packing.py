"""Packing fraction and order of the packing that a run starts from."""

import math

import numpy as np

from labbook.measure.clipped import disc_in_rectangle, sphere_in_box
from labbook.measure.data import RunData
from labbook.measure.measure import Measure, Window
from labbook.measure.order import hexatic
from labbook.measure.region import MARGIN, Region, bulk
from labbook.numerics import Numerics
from labbook.probes import Probe
from labbook.protocol.packing import Packing
from labbook.scene import Scene
from labbook.stats import Measured

_CELLS = 4
_SMALLEST = 4.0
"""Extent of the bulk in grain diameters below which it is too small to measure in."""


def packing_fraction(packing: Packing, diameter: float, region: Region) -> float:
    """Volume of grains within `region` over its volume; grains that its faces cut count in part.

    diameter: of the grains [m], of the largest where the packing has diameters of its own.
    """
    near, radius = _near(packing, diameter, region)
    return float(sphere_in_box(near, radius, region.low, region.high).sum() / math.prod(region.size))


def area_fraction(packing: Packing, diameter: float, region: Region) -> float:
    """Area of grains' discs in the x-z plane within `region` over its area.

    For a layer of thickness Z, phi_2D / phi_3D = (N pi d^2/4 / A) / (N pi d^3/6 / (A Z)) = (3/2) Z/d.
    """
    near, radius = _near(packing, diameter, region)
    x, _, z = near.T
    (x0, _, z0), (x1, _, z1) = region.low, region.high
    area = disc_in_rectangle(x, z, radius, (x0, z0), (x1, z1)).sum()
    return float(area / (region.size[0] * region.size[2]))


def _near(packing: Packing, diameter: float, region: Region) -> tuple[np.ndarray, np.ndarray | float]:
    """Centres [m] and radii [m] of grains that may reach into the region."""
    reach = diameter / 2
    low, high = np.array(region.low) - reach, np.array(region.high) + reach
    near = ((packing.x > low) & (packing.x < high)).all(axis=1)
    return packing.x[near], reach if packing.diameter is None else packing.diameter[near] / 2


class PackingStructure(Measure):
    """Packing fraction in 3D and, of a single layer, in 2D, with its hexatic order, in the bulk of the
    packing.

    Quantities: `packing_fraction`; of a layer also `packing_fraction_2d`, `hexatic_local` (mean |psi_6|) and
    `hexatic_global` (|mean psi_6|, 1 only for a single crystal). Errors are those between 4 x 4 cells of the
    bulk. A bulk smaller than 4 d gives NaN and says so.
    """

    name = "packing"
    version = 1

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        return ()

    def evaluate(self, run: RunData, window: Window) -> tuple[Measured, ...]:
        return self.of(run.scene, run.start)

    def of(self, scene: Scene, packing: Packing) -> tuple[Measured, ...]:
        """The numbers of `packing`, which stands in the container of `scene`. Raises MeasureError."""
        d = scene.grains.diameter
        region = bulk(scene, packing)
        (x0, _, z0), (x1, _, z1) = region.low, region.high
        where = (
            f"bulk, {MARGIN:g} d from walls, bottom and surface: x = {x0 * 1e3:.4g} to {x1 * 1e3:.4g} mm, "
            f"z = {z0 * 1e3:.4g} to {z1 * 1e3:.4g} mm"
        )
        if min(region.size[0], region.size[2]) < _SMALLEST * d or region.size[1] <= 0:
            return self._too_small(region, where)
        cells = region.cells(_CELLS)
        fractions = np.array([packing_fraction(packing, d, cell) for cell in cells])
        numbers = [_of_cells("packing_fraction", fractions, where, "volume of grains clipped to the bulk")]
        if region.planar:
            areas = np.array([area_fraction(packing, d, cell) for cell in cells])
            numbers.append(_of_cells("packing_fraction_2d", areas, where, "area of discs clipped to the bulk"))
            numbers.extend(_order(packing, region, cells, where))
        return tuple(numbers)

    def _too_small(self, region: Region, where: str) -> tuple[Measured, ...]:
        names = ["packing_fraction"]
        if region.planar:
            names += ["packing_fraction_2d", "hexatic_local", "hexatic_global"]
        note = f"the bulk is smaller than {_SMALLEST:g} d: fill in more grains or take a wider container"
        return tuple(Measured(name, math.nan, math.nan, 0, where, "none", "", note) for name in names)


def _of_cells(quantity: str, values: np.ndarray, where: str, how: str) -> Measured:
    error = float(values.std(ddof=1)) / math.sqrt(len(values))
    method = f"{how}; error between cells"
    return Measured(quantity, float(values.mean()), error, len(values), where, method, "")


def _order(packing: Packing, region: Region, cells: list[Region], where: str) -> list[Measured]:
    psi = hexatic(packing.x[:, 0], packing.x[:, 2])
    inside = region.holds(packing.x) & np.isfinite(psi)
    if not inside.any():
        note = "no grain in the bulk has neighbours"
        return [
            Measured(name, math.nan, math.nan, 0, where, "Delaunay neighbours", "", note)
            for name in ("hexatic_local", "hexatic_global")
        ]
    means = [abs(psi[held]).mean() for cell in cells if (held := cell.holds(packing.x) & inside).any()]
    error = float(np.std(means, ddof=1)) / math.sqrt(len(means)) if len(means) > 1 else math.nan
    how = "Delaunay neighbours in the x-z plane"
    return [
        Measured("hexatic_local", float(abs(psi[inside]).mean()), error, len(means), where, how, ""),
        Measured("hexatic_global", float(abs(psi[inside].mean())), math.nan, math.nan, where, how, ""),
    ]
