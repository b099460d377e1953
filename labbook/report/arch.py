"""Section of the page on arches: pictures of beds that they hold, and their size against D/d."""

import math
from pathlib import Path

from labbook.report import figures
from labbook.report.blocks import Section, picture
from labbook.report.figures.arch import flat
from labbook.report.tables import Table
from labbook.results.arch import PointArches, arches
from labbook.results.study import StudyResults


def arch_sections(results: StudyResults, folder: Path) -> list[Section]:
    """Figure and table of the points with arches; none without any."""
    points = arches(results.points)
    if not points:
        return []
    dome = "" if all(flat(point.result.point.scene) for point in points) else _DOME
    caption = _CAPTION.format(dome=dome)
    figure = picture(figures.arch_figure(points), folder / "arch", "arches that hold the outlet", caption)
    return [Section("Arches", (figure, arch_table(points)))]


def arch_table(points: list[PointArches]) -> Table:
    """Number of arches, their grains and the force along them at each point."""
    rows = tuple(
        (point.result.label or "the only point", f"{point.width_ratio:.3g}",
         str(len(point.sizes)), str(len(point.runs)), _number(point.size.value, point.size.error),
         f"{point.sizes.min():.0f} to {point.sizes.max():.0f}", _number(point.force.value, point.force.error))
        for point in points
    )  # fmt: skip
    headings = ("point", "D/d", "arches", "runs", "grains of an arch", "range", "force along it / (m g)")
    return Table(headings, rows, notes=(_TABLE,))


def _number(value: float, error: float) -> str:
    return f"{value:.3g} ± {error:.1g}" if math.isfinite(error) else f"{value:.3g}"


_CAPTION = (
    "The bed near the outlet at its last stop. Lines: forces between grains, wider where larger. Orange: the arch, the "
    "strongest short chain of contacts between grains on the bottom at either side{dome}. Right: grains of an arch; "
    "bars: standard errors over beds; discs: share of the arches with so many grains."
)
_DOME = (
    ". A dome has such a chain in each vertical plane through the axis of the hole, or across the slot, drawn from "
    "the front with the section in the middle (grey) and from above"
)
_TABLE = (
    "Errors are over beds. Grains of an arch include those at both ends, which rest on the bottom. A stop that no "
    "chain from side to side holds has no arch."
)
