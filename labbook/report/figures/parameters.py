"""Fitted parameters against what else was swept, beside the paper's values."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from labbook.fit import Parameter
from labbook.report.figures.arrangement import arranged
from labbook.report.style import INK, MILLIMETRE, PAGE, house, legend_columns, look, mathtext, point
from labbook.results import display
from labbook.results.reference import Comparison
from labbook.results.series import Series

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def parameters_against(key: str, law: str, series: Sequence[Series], comparisons: Sequence[Comparison]) -> "Figure":
    """The parameters of `law`, a panel each, against the swept `key`; series that differ in another key look different.

    Error bars are the fits' 95 % intervals; where they have no end the point is hollow, with a dashed bar. Open black
    diamonds are the reference's values.
    """
    from matplotlib.figure import Figure

    fitted = [each_series for each_series in series if each_series.parameters(law) and key in each_series.at]
    names = list(dict.fromkeys(p for each_series in fitted for p in each_series.parameters(law)))
    columns = min(len(names), 3 if len(names) % 2 else 2)
    rows = math.ceil(len(names) / columns)
    members = {each_series.label_without(key): each_series for each_series in reversed(fitted)}
    groups = list(dict.fromkeys(each_series.label_without(key) for each_series in fitted))
    other_keys = [{name: value for name, value in members[group].at.items() if name != key} for group in groups]
    arrangement = arranged(other_keys, groups)
    looks = arrangement.looks if len(arrangement.panels) == 1 else tuple(look(k) for k in range(len(groups)))
    with house():
        figure = Figure(figsize=(PAGE, (8 + 44 * rows) * MILLIMETRE))
        axes = figure.subplots(rows, columns, sharex=True, squeeze=False).flatten()
        for ax, parameter in zip(axes, names, strict=False):
            scale = display.key(key).scale
            for fitted_series in fitted:
                estimate = fitted_series.parameters(law).get(parameter)  # C of the bulk needs a measured packing
                if estimate is not None:
                    notation = display.quantity(f"{law}.{parameter}", estimate.unit)
                    ax.set_ylabel(mathtext(notation.heading))
                    group = groups.index(fitted_series.label_without(key))
                    _draw(ax, float(fitted_series.at[key]) * scale, estimate, notation.scale, looks[group])
            for entry in comparisons:
                if entry.quantity == f"{law}.{parameter}" and key in entry.at:
                    x, value = float(entry.at[key]) * scale, entry.reference * notation.scale
                    ax.plot(x, value, marker="D", markersize=5, color=INK, markerfacecolor="none", zorder=4)
        for ax in axes:
            ax.ticklabel_format(axis="y", useOffset=False)
        for ax in axes[len(names) :]:
            ax.set_axis_off()
        for ax in axes[max(len(names) - columns, 0) : len(names)]:
            ax.set_xlabel(display.key(key).heading)
            ax.xaxis.set_tick_params(labelbottom=True)
        if len(arrangement.panels) == 1:
            arrangement.explain(figure, linestyle="none")
        else:
            figure.legend(handles=_legend(groups), loc="outside upper right", ncols=legend_columns(groups))
        figure.align_ylabels()
    return figure


def _draw(ax: "Axes", x: float, parameter: Parameter, scale: float, style: Mapping[str, Any]) -> None:
    ends = parameter.low * scale, parameter.high * scale
    point(ax, x, parameter.value * scale, ends, color=style["color"], marker=style["marker"])


def _legend(groups: Sequence[str]) -> list:
    from matplotlib.lines import Line2D

    return [Line2D([], [], **{**look(k), "linestyle": "none"}, label=name) for k, name in enumerate(groups)]
