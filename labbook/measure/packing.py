"""Packing fraction and order of the packing that a run starts from."""

import math
from collections.abc import Iterator

import numpy as np

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Probe
from labbook.filling.bed import PACKED, discharged_at, expected_bed_height
from labbook.measure.clipped import disc_in_rectangle
from labbook.measure.data import RunData
from labbook.measure.measure import Evaluation, Measure, MeasureError, Quantity, Window
from labbook.measure.order import hexatic
from labbook.measure.region import (
    MARGIN,
    SMALLEST,
    Annulus,
    Outlines,
    Region,
    bulk,
    bulk_below,
    has_bulk,
    least_extent,
    lowest_surface,
    margin_of,
)
from labbook.scene import Grains, Scene
from labbook.scene.packing import Packing
from labbook.stats import Measured

_CELLS = 4
_DENSER = 1.1
"""Height of a level bed with the packing fraction PACKED over that of the lowest columns of a dense bed, at most."""


def packing_fraction(
    packing: Packing, grains: Grains, region: Region | Annulus, period: float = math.inf
) -> float:  # fmt: skip
    """Compute the volume of grains within a region over its volume; grains that its faces cut count in part.

    Args:
        packing: The packing.
        grains: Grains of the scene.
        region: The region.
        period: Distance of periodic sides along y [m]; infinite without them.
    """
    return region.filled(Outlines.of(packing, grains, period)) / region.volume


def area_fraction(packing: Packing, diameter: float, region: Region) -> float:
    """Compute the area of spheres' discs in the x-z plane within a region over its area.

    For a layer of thickness Z, phi_2D / phi_3D = (N pi d^2/4 / A) / (N pi d^3/6 / (A Z)) = (3/2) Z/d.

    Args:
        packing: The packing.
        diameter: Diameter of the grains [m]; of the largest where the packing has diameters of its own.
        region: The region.
    """
    reach = diameter / 2
    low, high = np.array(region.low) - reach, np.array(region.high) + reach
    near = ((packing.x > low) & (packing.x < high)).all(axis=1)
    x, _, z = packing.x[near].T
    radius = reach if packing.diameter is None else packing.diameter[near] / 2
    (x0, _, z0), (x1, _, z1) = region.low, region.high
    area = disc_in_rectangle(x, z, radius, (x0, z0), (x1, z1)).sum()
    return float(area / (region.size[0] * region.size[2]))


class PackingStructure(Measure):
    """Measure the packing fraction in the bulk of the packing and, of a single layer of spheres, its hexatic order.

    Errors are those between 4 x 4 cells of equal volume of the bulk. A bulk smaller than 4 d, or than the length of a
    rod, gives NaN with a note. The last three quantities are given for layers of spheres only, not for round silos,
    deep boxes, or rods, which turn in a layer.

    Quantities:
        packing_fraction: Volume of the grains over that of the bulk.
        packing_fraction_2d: Area of the discs of a layer over that of the bulk.
        hexatic_local: Mean |psi_6| (Nelson & Halperin, Phys. Rev. B 19 (1979) 2457).
        hexatic_global: |mean psi_6|, 1 for a single crystal only.

    Raises:
        MeasureError: The bulk of this kind of container is not known.
    """

    name = "packing"
    version = 3
    declared = (
        Quantity("packing_fraction", "φ", "", "volume of the grains over that of the bulk"),
        Quantity("packing_fraction_2d", "φ in 2D", "", "area of the discs of a layer over that of the bulk"),
        Quantity("hexatic_local", "ψ₆ local", "", "mean of the size of the hexatic order of each grain of a layer"),
        Quantity("hexatic_global", "ψ₆ global", "", "size of the mean hexatic order of a layer"),
    )

    def check(self, scene: Scene) -> None:
        if not has_bulk(scene):
            reason = f"packing cannot be measured in a container of the kind {scene.container.kind}"
            raise MeasureError(reason, "use a hopper, a silo or a box, or take packing out of measure")

    def quantities(self, scene: Scene) -> tuple[Quantity, ...]:
        return self.declared if _layer(scene) else self.declared[:1]

    def probes(self, scene: Scene, numerics: Numerics) -> tuple[Probe, ...]:
        self.check(scene)
        return ()

    def evaluate(self, run: RunData, window: Window) -> Evaluation:
        return Evaluation(self.of(run.scene, run.start))

    def of(self, scene: Scene, packing: Packing) -> tuple[Measured, ...]:
        """Measure a packing in the container of a scene.

        Returns:
            Numbers of the quantities of the measure.

        Raises:
            MeasureError: The bulk of this kind of container is not known.
        """
        self.check(scene)
        d = scene.grains.diameter
        region = bulk(scene, packing)
        where = f"bulk, {_distance(scene.grains)} from walls, bottom and surface: {region}"
        if region.smaller_than(least_extent(scene.grains)):
            return self._too_small(scene, where)
        cells = region.cells(_CELLS)
        fractions = np.array([packing_fraction(packing, scene.grains, cell, scene.container.period) for cell in cells])
        numbers = [_of_cells("packing_fraction", fractions, where, "volume of grains clipped to the bulk")]
        if isinstance(region, Region) and _layer(scene):
            cell_grid = region.cells(_CELLS)
            areas = np.array([area_fraction(packing, d, cell) for cell in cell_grid])
            numbers.append(_of_cells("packing_fraction_2d", areas, where, "area of discs clipped to the bulk"))
            numbers.extend(_order(packing, region, cell_grid, where))
        return tuple(numbers)

    def foreseen_empty(self, scene: Scene) -> tuple[str, str] | None:
        """Forecast that the bulk will be too small, from the height of a level bed."""
        height = expected_bed_height(scene) if has_bulk(scene) else None
        if height is None:
            return None
        outlet = scene.container.outlet_plane or 0.0
        if not bulk_below(scene, outlet + height / _DENSER).smaller_than(least_extent(scene.grains)):
            return None
        away = _distance(scene.grains)
        reason = f"the bulk, {away} from walls, bottom and surface, will be smaller than {_extent(scene.grains)}"
        level = _DENSER * (lowest_surface(scene) - outlet)
        high = f"a bed {1e3 * level:.3g} mm high at a packing fraction of {PACKED:g}"
        grains = scene.grains.count * (1 - (discharged_at(scene, level) or 0.0))
        step = 10 ** max(0, math.floor(math.log10(grains)) - 1)
        number = f"{math.ceil(grains / step) * step:.0f} grains or more ({high})"
        wider = " and ".join(f"container.{key} of {size}" for key, size in _wider(scene))
        return reason, f"use {f'a {wider}, with {high}' if wider else number}, or take packing out of measure"

    def _too_small(self, scene: Scene, where: str) -> tuple[Measured, ...]:
        least = _extent(scene.grains)
        note = f"the bulk is smaller than {least}: use more grains or a wider container"
        none = (math.nan, math.nan, 0, where, "none", "", note)
        return tuple(Measured(quantity.name, *none) for quantity in self.quantities(scene))


def _wider(scene: Scene) -> Iterator[tuple[str, str]]:
    """Yield sizes of the container that leave no bulk however high the bed is, with their least values."""
    least, margin = least_extent(scene.grains), margin_of(scene.grains)
    region, size = bulk_below(scene, math.inf), f"{math.ceil(1e4 * (2 * margin + least) - 1e-6) / 10:g} mm or more"
    if isinstance(region, Annulus):
        if region.smaller_than(least):
            yield "diameter", size
        return
    if region.size[0] < least * (1 - 1e-9):
        yield "width", size
    if region.size[1] <= 0:
        yield scene.container.widths[0], f"less than 2 d, or more than {2e3 * margin:.3g} mm"


def _layer(scene: Scene) -> bool:
    """True for spheres between a front and a back wall less than 2 d apart."""
    return scene.container.front_to_back < 2 * scene.grains.diameter and scene.grains.round


def _distance(grains: Grains) -> str:
    return f"{MARGIN:g} d" if margin_of(grains) == MARGIN * grains.diameter else f"{margin_of(grains) * 1e3:.4g} mm"


def _extent(grains: Grains) -> str:
    d, length = grains.diameter, grains.extent
    return f"{SMALLEST:g} d" if length <= SMALLEST * d else f"a {grains.noun} ({length * 1e3:.4g} mm)"


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
    means = [abs(psi[inner]).mean() for cell in cells if (inner := cell.holds(packing.x) & inside).any()]
    error = float(np.std(means, ddof=1)) / math.sqrt(len(means)) if len(means) > 1 else math.nan
    how = "Delaunay neighbours in the x-z plane"
    return [
        Measured("hexatic_local", float(abs(psi[inside]).mean()), error, len(means), where, how, ""),
        # Without an error between cells: the size of a mean of few numbers is biased upwards, the more the fewer they
        # are.
        Measured("hexatic_global", float(abs(psi[inside].mean())), math.nan, math.nan, where, how, ""),
    ]
