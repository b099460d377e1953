"""Parts of the energy that a bed gives up in a discharge."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from labbook.report.style import COLOURS, FAINT, MILLIMETRE, PAGE, house, verbatim
from labbook.results.points import PointResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PARTS = {
    "power_carried": "carried out",
    "power_normal": "normal dissipation",
    "power_friction": "tangential dissipation",
    "power_rolling": "rolling dissipation",
    "power_contacts": "dissipation of rods",
}


def energy_balance(points: Sequence[PointResult]) -> "Figure":
    """Draw a bar for each point: parts of the released power, from the first point at the top."""
    from matplotlib.figure import Figure

    with house():
        figure = Figure(figsize=(PAGE, (24 + 7 * len(points)) * MILLIMETRE))
        ax = figure.subplots()
        labelled: set[str] = set()
        for row, result in enumerate(points):
            released, start = result.pooled["power_released"].value, 0.0
            for color, (name, label) in zip(COLOURS, PARTS.items(), strict=False):
                split = name == "power_contacts" and "power_normal" in result.pooled
                if name not in result.pooled or split:
                    continue
                fraction = result.pooled[name].value / released
                ax.barh(row, fraction, 0.7, left=start, color=color, label=None if label in labelled else label)
                labelled.add(label)
                start += fraction
            ax.barh(row, max(1 - start, 0.0), 0.7, left=start, color=FAINT, alpha=0.5, label=None if row else "rest")
        ax.axvline(1.0, color=FAINT, linewidth=0.6)
        ax.set_yticks(range(len(points)), [verbatim(result.label) for result in points])
        ax.invert_yaxis()
        ax.set_xlim(left=0)
        ax.set_xlabel("fraction of the released power")
        figure.legend(loc="outside upper right", ncols=5)
    return figure
