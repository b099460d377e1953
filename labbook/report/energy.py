"""Section of the page on the energy balance of a discharge."""

from pathlib import Path

from labbook.measure.energy import EnergyBalance
from labbook.report import figures
from labbook.report.blocks import Section, picture
from labbook.report.tables import Table
from labbook.results import display
from labbook.results.points import PointResult
from labbook.results.study import StudyResults

TERMS = tuple(quantity.name for quantity in EnergyBalance.declared if not quantity.name.endswith("_flowing"))


def energy_sections(results: StudyResults, folder: Path) -> list[Section]:
    """Energy balance of all points that measured it: figure and table."""
    points = balanced(results)
    if not points:
        return []
    figure = figures.energy_balance(points)
    drawing = picture(figure, folder / "energy", "parts of the released energy", CAPTION)
    return [Section("Energy balance", (drawing, energy_table(points)))]


def balanced(results: StudyResults) -> list[PointResult]:
    """Points with an energy balance."""
    return [result for result in results.points if TERMS[0] in result.pooled]


def energy_table(points: list[PointResult]) -> Table:
    """Tabulate the terms of the balance: a row for each point."""
    quantities = [display.quantity(name) for name in TERMS]
    rows = []
    for result in points:
        pooled = [result.pooled.get(name) for name in TERMS]
        cells = (
            "–" if number is None else display.with_error(number.value, number.error, quantity.scale)
            for number, quantity in zip(pooled, quantities, strict=True)
        )
        rows.append((result.label or "the only point", *cells))
    return Table(("point", *(quantity.heading for quantity in quantities)), tuple(rows), notes=(NOTE,))


CAPTION = (
    "Energy that the bed gives up within the window of W: part carried out as kinetic energy of the grains that leave, "
    "and parts dissipated along normals, by tangential forces and by torques of rolling friction. Rest: the gain in "
    "kinetic energy of the bed, and the error of the balance; where a bar exceeds 1, it is negative."
)
NOTE = (
    "Of the grains that have not left. P_c is added up at every step, net of what moving walls give; P_rest = P_g − "
    "P_out − P_c − gain in kinetic energy of the bed is the error of the balance. P_n and P_t are means over sampled "
    "steps; P_r = P_c − P_n − P_t, plus the power of moving walls. E_el: half the sum of normal force times overlap."
)
