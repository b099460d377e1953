"""Mean velocity of the grains over the outlet."""

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.report.style import COLOURS, FAINT, MARKERS, MILLIMETRE, PAGE, house, legend_columns, verbatim
from labbook.results.velocities import PooledProfile

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLUMNS = 3
_TITLE = 36  # characters in a line of a panel's title


def outlet_velocities(points: Sequence[PooledProfile]) -> "Figure":
    """Draw the velocity over the outlet: a panel for each point, of mixtures a line for each class of grains.

    Bars: 95 % intervals.
    """
    from matplotlib.figure import Figure

    columns = min(_COLUMNS, len(points))
    lines = math.ceil(len(points) / columns)
    with house():
        figure = Figure(figsize=(PAGE * max(columns, 2) / _COLUMNS, (18 + 42 * lines) * MILLIMETRE))
        axes = figure.subplots(lines, columns, squeeze=False, sharey=True)
        for ax, pooled in zip(axes.flat, points, strict=False):
            middle = (pooled.edges[1:] + pooled.edges[:-1]) / 2 * 1e3
            for index, name in enumerate(pooled.names):
                bars = pooled.half_width[index] * 1e3
                style = {"color": COLOURS[index], "marker": MARKERS[index], "markersize": 3, "elinewidth": 0.7}
                velocity = pooled.velocity[index] * 1e3
                ax.errorbar(middle, velocity, yerr=np.nan_to_num(bars), label=verbatim(name), **style)
            ax.set_title("\n".join(textwrap.wrap(verbatim(pooled.result.label), _TITLE)))
            ax.set_ylim(bottom=0)
            low, rim = pooled.edges[[0, -1]] * 1e3
            ax.set_xlim(low - 0.03 * rim, 1.03 * rim)
            for edge in {low, rim} - {0.0}:
                ax.axvline(edge, color=FAINT, linewidth=0.7, zorder=0)
        for ax in axes.flat[len(points) :]:
            ax.set_axis_off()
        hole = points[0].result.point.scene.container.outlet_form == "hole"
        figure.supxlabel("distance from the axis [mm]" if hole else "x from the middle [mm]", fontsize=7.5)
        figure.supylabel("downward velocity [mm/s]", fontsize=7.5)
        handles, labels = axes[0, 0].get_legend_handles_labels()
        if len(labels) > 1:
            figure.legend(handles, labels, loc="outside upper right", ncols=legend_columns(labels))
    return figure
