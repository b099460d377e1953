"""Effective acceleration of grains above orifices against height: where they begin to fall freely."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.measure.acceleration import AccelerationProfile
from labbook.report.style import COLUMN, FAINT, MILLIMETRE, house, look
from labbook.results.points import PointResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def acceleration_against_height(found: Sequence[tuple[PointResult, AccelerationProfile]], gravity: float) -> "Figure":
    """a_eff/g of each point against the height that grains start from, in widths of the outlet."""
    from matplotlib.figure import Figure

    with house():
        figure = Figure(figsize=(COLUMN, 70 * MILLIMETRE))
        ax = figure.subplots()
        for index, (result, profile) in enumerate(found):
            middle = (profile.edges[1:] + profile.edges[:-1]) / 2 / result.orifice
            value, error = -profile.acceleration / gravity, profile.error / gravity
            style = {**look(index), "markersize": 3}
            ax.errorbar(middle, value, yerr=np.nan_to_num(error), label=result.label, **style)
        for height in (0, 1):
            ax.axhline(height, color=FAINT, linewidth=0.6, zorder=0)
        ax.set_xlabel("height above the outlet, $z/D$")
        ax.set_ylabel("downward acceleration / g")
        if any(result.label for result, _ in found):  # the only point of a study has none
            ax.legend()
    return figure
