"""Section of the page on mean velocities: over the outlet, and in stated zones."""

import math
from collections.abc import Sequence
from pathlib import Path

from labbook.measure.composition import class_names
from labbook.measure.velocities import Velocities, of_zone
from labbook.report.blocks import Block, Section, picture
from labbook.report.figures.velocities import outlet_velocities
from labbook.report.tables import Table
from labbook.results import display
from labbook.results.points import PointResult
from labbook.results.study import StudyResults
from labbook.results.velocities import ALL, outlet_profile
from labbook.scene.container_shape import VelocityZone
from labbook.stats import Pooled

OUTLET = Velocities.declared[0].name
_MM = 1e3


def velocity_sections(results: StudyResults, folder: Path) -> list[Section]:
    """Velocities of all points that measured them: figure over the outlet, tables of outlet and zones."""
    profiles = [profile for result in results.points if (profile := outlet_profile(result)) is not None]
    if not profiles:
        return []
    drawing = picture(outlet_velocities(profiles), folder / "velocities", "velocity over the outlet", _CAPTION)
    points = [profile.result for profile in profiles]
    blocks: list[Block] = [drawing, outlet_table(points)]
    if any(result.point.scene.container.zones for result in points):
        blocks.append(zone_table(points))
    return [Section("Velocities", tuple(blocks))]


def outlet_table(points: Sequence[PointResult]) -> Table:
    """Mean velocity in the plane of the outlet: a row for each point."""
    rows = tuple((_label(result), *_cells(result.pooled.get(OUTLET))) for result in points)
    return Table(("point", "v at the outlet [mm/s]", "95 %"), rows)


def zone_table(points: Sequence[PointResult]) -> Table:
    """Mean velocities in zones: a row for each point, zone and class of grains."""
    rows = [
        (_label(result), zone.name, name, *(cell for velocity in velocities for cell in _cells(velocity)))
        for result in points
        for zone in result.point.scene.container.zones
        for name, velocities in _in_zone(result, zone)
    ]
    axes = [heading for axis in "xyz" for heading in (f"v_{axis} [mm/s]", "95 %")]
    return Table(("point", "zone", "grains", *axes), tuple(rows), frozenset({0, 1, 2}), notes=(_ZONES,))


def _in_zone(result: PointResult, zone: VelocityZone) -> list[tuple[str, tuple[Pooled | None, ...]]]:
    """Velocities along x, y and z of all grains, and of each class along z alone."""
    x, y, z, *classes = [result.pooled.get(quantity.name) for quantity in of_zone(zone, result.point.scene)]
    names = class_names(result.point.scene.grains)
    return [(ALL, (x, y, z)), *((name, (None, None, own)) for name, own in zip(names, classes, strict=True))]


def _cells(pooled: Pooled | None) -> tuple[str, str]:
    """Value with its standard error, and its interval [mm/s]."""
    if pooled is None:
        return "–", "–"
    low, high = (display.number(end, pooled.error, _MM) for end in (pooled.low, pooled.high))
    determined = math.isfinite(pooled.half_width)
    return display.with_error(pooled.value, pooled.error, _MM), f"{low} to {high}" if determined else "–"


def _label(result: PointResult) -> str:
    return result.label or "the only point"


_CAPTION = (
    "Mean downward velocity of the grains in the plane of the outlet, N/Σ(1/v) over the grains that cross it within "
    "the window of W: by rings of equal area of a hole, by x of a slot. Bars: 95 % intervals over beds. Grey: rim."
)
_ZONES = (
    "Means over the grains in each zone, in about a hundred frames of the window of W. ± is one standard error between "
    "beds."
)
