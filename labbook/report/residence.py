"""Section of the page on residence times."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from labbook.measure.marks import PREFIX, planes_above
from labbook.measure.residence import LAYERS, Residence
from labbook.report import figures
from labbook.report.blocks import Block, Section, picture
from labbook.report.tables import Table
from labbook.results import display
from labbook.results.points import PointResult
from labbook.results.residence import PooledCurve, PooledMap, marks_of, regime_of, residence_curve, residence_map
from labbook.results.study import StudyResults
from labbook.stats import Pooled


def residence_sections(results: StudyResults, folder: Path) -> list[Section]:
    """Residence times of all points that measured them: maps of batches, distributions of fed silos, and tables."""
    blocks: list[Block] = []
    maps, curves = residence_of(results)
    if maps:
        figure = figures.residence_maps(maps)
        alt = "time to leave over the initial position, and layers in the outflow"
        blocks.append(picture(figure, folder / "residence-map", alt, MAP_CAPTION))
    if curves:
        figure = figures.residence_distributions(curves)
        alt = "distribution of residence times"
        blocks.append(picture(figure, folder / "residence", alt, CURVE_CAPTION))
        names = [quantity.name for quantity in Residence.declared]
        blocks.append(_table([(curve.result, curve.result.pooled) for curve in curves], names, (FED_NOTE,)))
    regimes = [(result, numbers) for result in results.points if (numbers := regime_of(result))]
    if regimes:
        names = list(dict.fromkeys(name for _, numbers in regimes for name in numbers))
        blocks.append(_table(regimes, names, (REGIME_NOTE,)))
    if rows := [row for result in results.points for row in _marks(result)]:
        headings = ("point", "plane", "z [mm]", "median time to the outlet [s]", "⟨t⟩ [s]", "σ²/⟨t⟩^(2)")
        blocks.append(Table(headings, tuple(rows), notes=(MARKS_NOTE,)))
    return [Section("Residence times", tuple(blocks))] if blocks else []


def residence_of(results: StudyResults) -> tuple[list[PooledMap], list[PooledCurve]]:
    """Maps of batch discharges and distributions of fed silos, of the points that have them."""
    maps = [pooled for result in results.points if (pooled := residence_map(result)) is not None]
    return maps, [pooled for result in results.points if (pooled := residence_curve(result)) is not None]


def _marks(result: PointResult) -> Iterator[tuple[str, ...]]:
    numbers = marks_of(result)
    for plane in planes_above(result.point.scene):
        names = (f"{PREFIX}{plane.name}{of}" for of in (".median", "", ".variance"))
        times = [numbers.get(name) for name in names]
        if any(times):
            cells = ("–" if time is None else display.with_error(time.value, time.error, 1.0) for time in times)
            yield (result.label or "the only point", plane.name, f"{plane.z * 1e3:g}", *cells)


def _table(
    points: Sequence[tuple[PointResult, Mapping[str, Pooled]]], names: Sequence[str], notes: tuple[str, ...]
) -> Table:
    """Tabulate pooled numbers: a row for each point."""
    quantities = [display.quantity(name) for name in names]
    rows = []
    for result, numbers in points:
        cells = (
            display.with_error(numbers[name].value, numbers[name].error, own.scale) if name in numbers else "–"
            for name, own in zip(names, quantities, strict=True)
        )
        rows.append((result.label or "the only point", *cells))
    return Table(("point", *(own.heading for own in quantities)), tuple(rows), notes=notes)


MAP_CAPTION = (
    "Left: time at which half of the grains had left, in cells of the initial position, mean over beds; white: "
    "isochrones. Grey: less than half had left at the end of the run. Right: composition of the outflow by "
    f"{LAYERS} initial layers of equal mass, of which 1 is the lowest. Layers that leave one after another: first in, "
    "first out."
)
CURVE_CAPTION = (
    "Times between two passages of a grain. F: part of the outflow with a shorter residence time. E: its density. "
    "Thin: single runs."
)
FED_NOTE = (
    "N/Q: grains in the silo over grains per second, which is the mean residence time if all grains take part in the "
    "flow. Dead: the part that does not, by the difference. Pe: axial dispersion between closed ends."
)
REGIME_NOTE = (
    "Recorded runs. MFI: mass-flow index, velocity at the wall over that in the middle at half of the bed’s initial "
    "height; 1 is a section that sinks as a whole. Not moved: part of the initial mass that has moved by less than "
    "0.1 d when half has left. Engineers speak of mass flow if all material moves, and of funnel flow if some stands "
    "at the wall. A flat bottom has stagnant corners: it is funnel flow even where MFI is 1."
)
MARKS_NOTE = (
    "Recorded runs. Time from the first passage of a plane above the outlet, after the opening or the last return, "
    "until the grain leaves; times that the window cuts are censored. There is no mean if more than 1 % take longer "
    "than the window."
)
