"""Section of the page on the composition of the outflow of mixtures."""

import math
from collections.abc import Sequence
from pathlib import Path

from labbook.measure.composition import BIN, CELL, SHUFFLES
from labbook.report import figures
from labbook.report.blocks import Section, picture
from labbook.report.tables import Table
from labbook.results import display
from labbook.results.composition import PooledShares, composition_of
from labbook.results.points import PointResult, values_by_run
from labbook.results.study import StudyResults


def composition_sections(results: StudyResults, folder: Path) -> list[Section]:
    """Composition of the outflow of all points that measured it: figure and table."""
    points = compositions(results)
    if not points:
        return []
    figure = figures.composition_against_discharge(points)
    drawing = picture(figure, folder / "composition", "composition of the outflow against the discharged mass", CAPTION)
    return [Section("Composition of the outflow", (drawing, composition_table(points)))]


def compositions(results: StudyResults) -> list[PooledShares]:
    """Pooled compositions of the points that measured them."""
    return [pooled for result in results.points if (pooled := composition_of(result)) is not None]


def composition_table(points: Sequence[PooledShares]) -> Table:
    """Tabulate share, flow rate and segregation index of each kind: a row for each point and kind."""
    rows = []
    for pooled in points:
        result = pooled.result
        for class_index, (name, initial) in enumerate(zip(pooled.names, pooled.initial, strict=True)):
            of_bed = (_pooled(result, "lacey_index"), _p_values(result)) if class_index == 0 else ("", "")
            index = result.pooled.get(f"segregation_{name}")
            rows.append(
                (
                    (result.label or "the only point") if class_index == 0 else "",
                    name,
                    f"{100 * initial:.3g}",
                    _pooled(result, f"flow_rate_of_{name}", 1e3),
                    _pooled(result, f"segregation_{name}"),
                    "–" if index is None else f"{math.sqrt(max(index.value, 0.0)):.2g}",
                    *of_bed,
                )
            )
    headings = ("point", "kind", "mass in the bed [%]", "W [g/s]", "SI^(2)", "SI", "Lacey index of the bed", "p")
    return Table(headings, tuple(rows), frozenset({0, 1}), notes=(NOTE,))


def _pooled(result: PointResult, quantity: str, scale: float = 1.0) -> str:
    pooled = result.pooled.get(quantity)
    return "–" if pooled is None else display.with_error(pooled.value, pooled.error, scale)


def _p_values(result: PointResult) -> str:
    """p value of all runs together, by Fisher's method."""
    from scipy.stats import combine_pvalues

    values = [value for _, value in values_by_run(result, "segregation_p")]
    return f"{combine_pvalues(values)[1]:.2g}" if values else "–"


CAPTION = (
    "Share of each kind in the mass that leaves, over its share in the bed: 1 where the outflow has the composition of "
    f"the bed. Bins of equally many grains, {BIN} or more. Bars: standard error from seeds. Bands: counting error. "
    "Thin lines: single beds."
)
NOTE = (
    "SI is the standard deviation of x_i/x_i0 over the bins; its square has the counting noise subtracted and may be "
    f"negative by chance. p: {SHUFFLES} permutations of the labels in each run, runs combined by Fisher’s method; in a "
    f"random bed p is uniform from 0 to 1. Lacey index in cells of {CELL:g} d: 1 is a random bed, 0 a separated one."
)
