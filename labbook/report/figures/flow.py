"""W(t) of every point of a series, each replicate a line, with the window that its mean was taken over."""

import math
import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from labbook.report.style import COLOURS, FAINT, MILLIMETRE, PAGE, from_zero, house, verbatim
from labbook.results.points import PointResult
from labbook.results.series import Series

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_COLUMNS = 4
_TITLE = 27  # characters in a line of a panel's title
_SHADES = (0.0, 0.35, 0.55, 0.7)  # towards white: replicates of one point are one colour


def flow_against_time(series: Series) -> "Figure":
    """Small multiples, one point each, named by what tells it from the others: W(t) by replicate, the window shaded,
    the pooled mean and its 95 % interval.
    """
    from matplotlib.figure import Figure

    columns = min(_COLUMNS, len(series.points))
    rows = math.ceil(len(series.points) / columns)
    with house():
        figure = Figure(figsize=(PAGE * max(columns, 3) / _COLUMNS, (14 + 34 * rows) * MILLIMETRE))
        axes = figure.subplots(rows, columns, squeeze=False)
        for ax, result in zip(axes.flat, series.points, strict=False):
            _draw(ax, result, result.label_without({*series.at, *series.along}) or f"D = {result.orifice * 1e3:g} mm")
        for ax in axes.flat[len(series.points) :]:
            ax.set_axis_off()
        figure.supxlabel("time since the opening, $t$ [s]", fontsize=7.5)
        figure.supylabel("flow rate, $W$ [g/s]", fontsize=7.5)
        if series.label:
            figure.suptitle(series.label, x=0.01, ha="left", fontsize=7.5)
        figure.legend(handles=_key(drawn(series)), loc="outside upper right", ncols=3)
    return figure


@dataclass(frozen=True)
class Drawn:
    """Which parts of the figure any panel has, beside the replicates."""

    window: bool
    mean: bool
    interval: bool


def drawn(series: Series) -> Drawn:
    """What the panels of these points show: a mean stands in its window only."""
    with_window = [one for one in series.points if _windows(one)]
    means = [one.flow_rate for one in with_window if one.flow_rate is not None]
    return Drawn(bool(with_window), bool(means), any(math.isfinite(one.half_width) for one in means))


def _windows(result: PointResult) -> list[tuple[float, float]]:
    return [run.trace.window for run in result.runs if run.trace is not None and run.trace.window is not None]


def _draw(ax: "Axes", result: PointResult, title: str) -> None:
    pooled = result.flow_rate
    for k, run in enumerate(result.runs):
        if run.trace is not None:
            shade = _lighter(COLOURS[0], _SHADES[k % len(_SHADES)])
            ax.step(run.trace.time, run.trace.rate * 1e3, where="mid", color=shade, linewidth=0.7, zorder=2)
    if windows := _windows(result):
        start, end = np.mean(windows, axis=0)
        ax.axvspan(start, end, color=FAINT, alpha=0.18, linewidth=0, zorder=0)
        if pooled is not None:
            mean, half = pooled.value * 1e3, pooled.half_width * 1e3
            if math.isfinite(half):
                ax.fill_between([start, end], mean - half, mean + half, color=COLOURS[1], alpha=0.35, linewidth=0)
            ax.plot([start, end], [mean, mean], color=COLOURS[1], zorder=3)
    said = verbatim(f"{title}, {result.remark}" if result.remark else title)
    ax.set_title("\n".join(textwrap.wrap(said, _TITLE)), fontsize=7.5 if len(said) <= _TITLE else 6.5)
    ax.set_xlim(left=0)
    from_zero(ax)


def _key(shown: Drawn) -> list:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Line2D | Patch] = [Line2D([], [], color=COLOURS[0], linewidth=0.7, label="replicates")]
    if shown.mean:
        label = "pooled mean, 95 % interval" if shown.interval else "pooled mean"
        handles.append(Line2D([], [], color=COLOURS[1], label=label))
    if shown.window:
        handles.append(Patch(facecolor=FAINT, alpha=0.3, label="window"))
    return handles


def _lighter(colour: str, towards_white: float) -> tuple[float, ...]:
    from matplotlib.colors import to_rgb

    return tuple(c + (1 - c) * towards_white for c in to_rgb(colour))
