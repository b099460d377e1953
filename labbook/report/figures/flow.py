"""W(t) of every point of a series, each replicate a line, with the window that its mean was taken over."""

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from labbook.report.style import COLOURS, FAINT, MILLIMETRE, PAGE, from_zero, house, verbatim
from labbook.results import display
from labbook.results.points import PointResult
from labbook.results.series import Series

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_COLUMNS = 4
_TITLE = 27  # characters in a line of a panel's title
_SHADES = (0.0, 0.35, 0.55, 0.7)  # towards white: replicates of one point are one colour
_GRID = 6  # columns of a grid of two keys


def flow_against_time(series: Series) -> "Figure":
    """Small multiples, one point each: W(t) by replicate, the window shaded, the pooled mean and its 95 % interval.

    Points that differ in two keys stand in a grid, which names their values at its margins; panels of a row have one
    scale of W. Others are named by what tells them apart.
    """
    from matplotlib.figure import Figure

    grid = _grid(series.whole_points)
    columns = len(grid.across) if grid else min(_COLUMNS, len(series.whole_points))
    rows = len(grid.down) if grid else math.ceil(len(series.whole_points) / columns)
    with house():
        width = PAGE if grid else PAGE * max(columns, 3) / _COLUMNS
        figure = Figure(figsize=(width, (14 + 34 * rows) * MILLIMETRE))
        axes = figure.subplots(
            rows, columns, squeeze=False, sharex="col" if grid else False, sharey="row" if grid else False
        )
        if grid:
            _fill_grid(axes, grid)
        else:
            for ax, result in zip(axes.flat, series.whole_points, strict=False):
                _draw(ax, result)
                title = result.label_without({*series.at, *series.along}) or _width(result)
                heading = verbatim(", ".join(filter(None, (title, result.remark))))
                ax.set_title(_broken(heading), fontsize=7.5 if len(heading) <= _TITLE else 6.5)
            for ax in axes.flat[len(series.whole_points) :]:
                ax.set_axis_off()
        for ax in axes.flat:
            ax.set_xlim(left=0)
            from_zero(ax)
        figure.supxlabel("time since the opening, $t$ [s]", fontsize=7.5)
        figure.supylabel("flow rate, $W$ [g/s]", fontsize=7.5)
        if series.label:
            figure.suptitle(series.label, x=0.01, ha="left", fontsize=7.5)
        figure.legend(handles=_key(panel_content(series)), loc="outside upper right", ncols=3)
    return figure


@dataclass(frozen=True)
class _Grid:
    """Points that differ in two keys. `down`, `across`: labels of the rows and of the columns; `at`: points by row and
    column."""

    down: tuple[str, ...]
    across: tuple[str, ...]
    at: Mapping[tuple[int, int], PointResult]


def _grid(points: Sequence[PointResult]) -> _Grid | None:
    """The points by the two keys that they differ in; None if it is not two keys, or too many columns."""
    keys = list(dict.fromkeys(key for result in points for key in result.at))
    values = {key: list(dict.fromkeys(result.at[key] for result in points if key in result.at)) for key in keys}
    varied = [key for key in keys if len(values[key]) > 1]
    if len(varied) != 2 or any(key not in result.at for key in varied for result in points):
        return None
    down, across = varied
    if len(values[across]) > _GRID:
        down, across = across, down
    if len(values[across]) > _GRID:
        return None
    at = {(values[down].index(result.at[down]), values[across].index(result.at[across])): result for result in points}
    if len(at) < len(points):
        return None
    rows, columns = (tuple(display.setting(key, value) for value in values[key]) for key in (down, across))
    return _Grid(rows, columns, at)


def _fill_grid(axes: "np.ndarray", grid: _Grid) -> None:
    for (row, column), ax in np.ndenumerate(axes):
        result = grid.at.get((row, column))
        if result is None:
            ax.set_axis_off()
        else:
            _draw(ax, result)
            if result.remark:
                foot = {"xycoords": "axes fraction", "ha": "right", "va": "bottom", "size": 5.5}
                ax.annotate(verbatim(result.remark), (0.98, 0.03), **foot)
        if row == 0:
            ax.set_title(verbatim(grid.across[column]))
        if column == axes.shape[1] - 1:
            side = {"xycoords": "axes fraction", "rotation": -90, "ha": "left", "va": "center", "size": 7.5}
            ax.annotate(verbatim(grid.down[row]), (1.04, 0.5), annotation_clip=False, **side)


def _broken(title: str) -> str:
    """The title in lines, broken between settings rather than within one."""
    lines: list[str] = []
    for item in title.split(", "):
        if lines and len(lines[-1]) + len(item) + 2 <= _TITLE:
            lines[-1] += f", {item}"
        else:
            lines += textwrap.wrap(item, _TITLE)
    return "\n".join(f"{line}," if k < len(lines) - 1 else line for k, line in enumerate(lines))


@dataclass(frozen=True)
class PanelContent:
    """Parts that any panel of the figure has, beside the replicates."""

    window: bool
    mean: bool
    interval: bool


def _width(result: PointResult) -> str:
    """`D = 18 mm`; empty for several outlets, or one of unknown width."""
    return f"D = {result.orifice * 1e3:g} mm" if math.isfinite(result.orifice) else ""


def panel_content(series: Series) -> PanelContent:
    """Parts that the panels of these points have. A mean is drawn within its window only."""
    with_window = [result for result in series.whole_points if _windows(result)]
    means = [result.flow_rate for result in with_window if result.flow_rate is not None]
    return PanelContent(bool(with_window), bool(means), any(math.isfinite(mean.half_width) for mean in means))


def _windows(result: PointResult) -> list[tuple[float, float]]:
    return [run.trace.window for run in result.runs if run.trace is not None and run.trace.window is not None]


def _draw(ax: "Axes", result: PointResult) -> None:
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


def _key(content: PanelContent) -> list:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Line2D | Patch] = [Line2D([], [], color=COLOURS[0], linewidth=0.7, label="replicates")]
    if content.mean:
        label = "pooled mean, 95 % interval" if content.interval else "pooled mean"
        handles.append(Line2D([], [], color=COLOURS[1], label=label))
    if content.window:
        handles.append(Patch(facecolor=FAINT, alpha=0.3, label="window"))
    return handles


def _lighter(colour: str, towards_white: float) -> tuple[float, ...]:
    from matplotlib.colors import to_rgb

    return tuple(c + (1 - c) * towards_white for c in to_rgb(colour))
