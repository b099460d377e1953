"""Effective acceleration of grains above orifices against height: where they begin to fall freely."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.measure.acceleration import AccelerationProfile
from labbook.report.figures.arrangement import arranged
from labbook.report.style import COLUMN, FAINT, MILLIMETRE, PAGE, house, mathtext, verbatim
from labbook.results.points import PointResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ACROSS = 3  # panels side by side


def acceleration_against_height(
    profiles: Sequence[tuple[PointResult, AccelerationProfile]], gravity: float
) -> "Figure":
    """a_eff/g of each point against the height that grains start from, in widths of the outlet; many points are parted
    into panels (`arranged`)."""
    from matplotlib.figure import Figure

    arrangement = arranged([result.at for result, _ in profiles], [result.label for result, _ in profiles])
    panels = arrangement.panels
    across = 2 if len(panels) == 4 else min(_ACROSS, len(panels))
    down = math.ceil(len(panels) / across)
    width = COLUMN if across == 1 and arrangement.bar is None else PAGE
    with house():
        height = (70 if across == 1 else 56) * down + 5 * arrangement.rows(width)
        figure = Figure(figsize=(width, height * MILLIMETRE))
        axes = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False)
        for ax in axes.flat[len(panels) :]:
            ax.remove()
        for ax, (title, members) in zip(axes.flat, panels.items(), strict=False):
            for k in members:
                result, profile = profiles[k]
                middle = (profile.edges[1:] + profile.edges[:-1]) / 2 / result.orifice
                value, error = -profile.acceleration / gravity, profile.error / gravity
                style = {**arrangement.looks[k], "markersize": 3}
                ax.errorbar(middle, value, yerr=np.nan_to_num(error), **style)
            for level in (0, 1):
                ax.axhline(level, color=FAINT, linewidth=0.6, zorder=0)
            ax.set_title(mathtext(verbatim(title)))
            ax.xaxis.set_tick_params(labelbottom=True)
            ax.set_xlabel("height above the outlet, $z/D$")
            if ax.get_subplotspec().is_first_col():
                ax.set_ylabel("downward acceleration / g")
        arrangement.explain(figure, markersize=3)
    return figure
