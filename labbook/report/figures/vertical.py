"""Mean vertical stress in a bed against height, from two sources."""

from typing import TYPE_CHECKING

import numpy as np

from labbook.fit.janssen import preferred
from labbook.report.style import COLOURS, COLUMN, DASHES, FAINT, house
from labbook.results.walls import VerticalStress

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_KILO = 1e-3


def vertical_stress(stress: VerticalStress) -> "Figure":
    """Draw the vertical stress by the balance with the walls and by the contacts in the bed, with the fitted laws."""
    from matplotlib.figure import Figure

    with house():
        figure = Figure(figsize=(COLUMN, 0.8 * COLUMN))
        ax = figure.subplots()
        sources = ((stress.field, "o", "full", "contacts in the bed"), (stress.walls, "s", "none", "weight less walls"))
        for source_index, (rows, marker, fill, label) in enumerate(sources):
            bars = rows.std(axis=0, ddof=1) / np.sqrt(len(rows)) * _KILO if len(rows) > 1 else None
            style = {"color": COLOURS[source_index], "marker": marker, "fillstyle": fill, "markersize": 4}
            ax.errorbar(
                rows.mean(axis=0) * _KILO, stress.z * 1e3, xerr=bars, linestyle="", elinewidth=0.7, label=label, **style
            )
        for index, (model, fit) in enumerate(stress.fits.items()):
            depth = np.linspace(float(fit.profile.depth.min()), float(fit.profile.depth.max()), 200)
            z = stress.z.max() - (depth - depth.min())
            colour = "black" if model in preferred(stress.fits) else FAINT
            ax.plot(
                fit.curve(depth) * _KILO, z * 1e3, color=colour, linestyle=DASHES[index], linewidth=0.9, label=model
            )
        ax.set(xlabel="vertical stress [kPa]", ylabel="z [mm]")
        ax.set_xlim(left=0)
        ax.legend()
    return figure
