"""Fitted parameters against what else was swept, beside the paper's values."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from labbook.report import display
from labbook.report.style import COLOURS, INK, MARKERS, MILLIMETRE, PAGE, house, mathtext

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from labbook.report.comparison import Comparison
    from labbook.report.series import Series


def parameters_against(
    key: str, name: str, scale: float, law: str, series: Sequence["Series"], comparisons: Sequence["Comparison"]
) -> "Figure":
    """The parameters of `law`, a panel each, against `key` (axis label `name`, SI value times `scale`).

    Error bars are the fits' 95 % intervals; open black diamonds are the reference's values.
    """
    from matplotlib.figure import Figure

    fitted = [one for one in series if law in one.fits]
    names = list(dict.fromkeys(p for one in fitted for p in one.fits[law].parameters))
    rows = math.ceil(len(names) / 2)
    with house():
        figure = Figure(figsize=(PAGE, (8 + 44 * rows) * MILLIMETRE))
        axes = figure.subplots(rows, 2, sharex=True, squeeze=False).flatten()
        for index, (ax, parameter) in enumerate(zip(axes, names, strict=False)):
            colour, marker = COLOURS[index % len(COLOURS)], MARKERS[index % len(MARKERS)]
            found = [
                (float(one.at[key]) * scale, one.fits[law].parameters[parameter])
                for one in fitted
                if parameter in one.fits[law].parameters  # C of the bulk needs a measured packing
            ]
            shown = display.quantity(f"{law}.{parameter}", found[0][1].unit)
            for place, value in found:
                ends = [abs(end - value.value) * shown.scale for end in (value.low, value.high)]
                if all(map(math.isfinite, ends)):
                    ax.errorbar(place, value.value * shown.scale, yerr=[[ends[0]], [ends[1]]], color=colour)
                ax.plot(place, value.value * shown.scale, color=colour, marker=marker)
            for entry in comparisons:
                if entry.quantity == f"{law}.{parameter}" and key in entry.at:
                    place = float(entry.at[key]) * scale
                    ax.plot(place, entry.reference * shown.scale, marker="D", color=INK, markerfacecolor="none")
            ax.set_ylabel(mathtext(shown.heading))
        for ax in axes[len(names) :]:
            ax.set_axis_off()
        for ax in axes[max(len(names) - 2, 0) : len(names)]:
            ax.set_xlabel(name)
            ax.xaxis.set_tick_params(labelbottom=True)
        figure.align_ylabels()
    return figure
