"""A quantity against one swept key, and its ratio to that at the first value."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from labbook.report.figures.arrangement import Arrangement, arranged
from labbook.report.style import (
    COLUMN,
    FAINT,
    MILLIMETRE,
    PAGE,
    crosses,
    from_zero,
    house,
    mathtext,
    point,
    verbatim,
)
from labbook.results import display
from labbook.results.against import Against, Line, RatioPoint

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_ACROSS = 3  # panels side by side
_DECADES = 2  # of values, beyond which their axis is logarithmic
_WHOLE = 4  # half widths of intervals up to which they are shown whole, in ranges of the ratios
_CUT = "_cut"  # label of the marks on cut intervals, which no legend lists


def against_key(comparison: Against) -> "Figure":
    """Above the quantity with 95 % intervals, a line for each value of the other keys; below, on the same axis, its
    ratio to that at the first value. Points with a remark are hollow, and so are ratios to one; a cross at the bottom
    is a point without a value.

    Many lines are parted into panels (`arranged`).
    """
    from matplotlib.figure import Figure

    arrangement = arranged([line.at for line in comparison.lines], [line.label for line in comparison.lines])
    panels = {title: [comparison.lines[k] for k in members] for title, members in arrangement.panels.items()}
    across = 2 if len(panels) == 4 else min(_ACROSS, len(panels))
    down = math.ceil(len(panels) / across)
    wide = PAGE if len(panels) > 1 else PAGE * 0.7 if arrangement.bar else COLUMN
    with house():
        height = 84 * down + 5 * arrangement.rows(wide)
        figure = Figure(figsize=(wide, height * MILLIMETRE))
        axes = figure.subplots(
            2 * down,
            across,
            sharex=True,
            sharey="row" if down == 1 else False,
            squeeze=False,
            height_ratios=[1.5, 1] * down,
        )
        for ax in axes.flat:
            ax.set_axis_off()
        bars: list[_Bar] = []
        for number, title in enumerate(panels):
            row, column = divmod(number, across)
            main, below = axes[2 * row, column], axes[2 * row + 1, column]
            for ax in (main, below):
                ax.set_axis_on()
            members = arrangement.panels[title]
            bars += _panel(main, below, comparison, members, arrangement)
            main.set_title(mathtext(verbatim(title)))
            if not column:
                main.set_ylabel(mathtext(display.quantity(comparison.quantity).heading))
                below.set_ylabel(mathtext(ratio_heading(comparison)))
            below.set_xlabel(mathtext(comparison.heading))
            below.xaxis.set_tick_params(labelbottom=True)
        arrangement.explain(figure, linewidth=0.8)
        together = [comparison.lines] * len(panels) if down == 1 else list(panels.values())
        for number, lines in enumerate(together):  # after all are drawn: panels of one row share their axes
            row, column = divmod(number, across)
            from_zero(axes[2 * row, column])
            axes[2 * row + 1, column].set_ylim(*_range(lines))
        for bar in bars:
            _mark_cuts(bar)
        figure.align_ylabels()
    return figure


def has_cuts(figure: "Figure") -> bool:
    """True if any interval is cut at the edge of its panel."""
    return any(line.get_label() == _CUT for ax in figure.axes for line in ax.lines)


@dataclass(frozen=True)
class _Bar:
    """An interval at x as it is drawn."""

    ax: "Axes"
    x: float
    low: float
    high: float
    color: str


def _mark_cuts(bar: _Bar) -> None:
    """An arrowhead at the edge of a panel where an interval goes on beyond it."""
    bottom, top = bar.ax.get_ylim()
    for beyond, edge, marker in ((bar.low < bottom, bottom, "v"), (bar.high > top, top, "^")):
        if beyond:
            mark = {"marker": marker, "markersize": 4, "color": bar.color, "linestyle": "none"}
            bar.ax.plot(bar.x, edge, **mark, clip_on=False, scalex=False, scaley=False, label=_CUT)


def ratio_heading(comparison: Against) -> str:
    """`W / W at 0.1`, or `W / W at the first` where lines do not begin with the same value."""
    name = display.quantity(comparison.quantity).name
    firsts = {line.first.value for line in comparison.lines if line.first is not None}
    if len(firsts) != 1:
        return f"{name} / {name} at the first"
    (value,) = firsts
    return f"{name} / {name} at {display.amount(comparison.key, value)} {display.key(comparison.key).unit}".rstrip()


def _panel(
    main: "Axes", below: "Axes", comparison: Against, members: Sequence[int], arrangement: Arrangement
) -> "list[_Bar]":
    """Draw the lines of a panel; the intervals."""
    bars: list[_Bar] = []
    values, scale = comparison.values, display.quantity(comparison.quantity).scale
    x = _abscissa(comparison)
    span = max(x.values()) - min(x.values())
    logarithmic = not comparison.words and min(x.values()) > 0 and max(x.values()) / min(x.values()) > 10**_DECADES
    together = arrangement.together
    for member in members:
        line, style, rank = comparison.lines[member], arrangement.looks[member], arrangement.ranks[member]
        shift = (0.03 if comparison.words else min(0.012, 0.04 / together)) * (rank - (together - 1) / 2)
        at = {
            value: x[value] * (1 + 3 * shift) if logarithmic else x[value] + (1 if comparison.words else span) * shift
            for value in values
        }
        measured = [p for p in line.points if comparison.quantity in p.result.pooled]
        if not comparison.words:
            path = {"color": style["color"], "linestyle": style["linestyle"], "linewidth": 0.6, "alpha": 0.6}
            main.plot(
                [at[p.value] for p in measured],
                [p.result.pooled[comparison.quantity].value * scale for p in measured],
                **path,
            )
            rated = [(at[p.value], p.ratio.value if p.ratio else 1.0) for p in measured if p.ratio or p is line.first]
            below.plot(*np.transpose(rated) if rated else ([], []), **path)
        for ratio_point in line.points:
            bars += _draw(
                main, below, comparison, line, ratio_point, at[ratio_point.value], scale, style, len(members) == 1
            )
    below.axhline(1, color=FAINT, linewidth=0.6, zorder=0)
    if logarithmic:
        main.set_xscale("log")
    elif comparison.words:
        main.set_xticks(list(x.values()), [verbatim(str(value)) for value in x])
        main.set_xlim(-0.5, len(x) - 0.5)
    return bars


def _draw(
    main: "Axes",
    below: "Axes",
    comparison: Against,
    line: Line,
    ratio_point: RatioPoint,
    x: float,
    scale: float,
    style: dict,
    words: bool,
) -> "list[_Bar]":
    pooled = ratio_point.result.pooled.get(comparison.quantity)
    if pooled is None:
        crosses(main, [(x, ratio_point.result.lacking if words else "")], style["color"])
        return []
    colour, hollow = style["color"], bool(ratio_point.result.remark)
    intervals = [(main, pooled.value * scale, pooled.low * scale, pooled.high * scale)]
    if ratio_point is line.first:
        below.plot(
            x, 1.0, color=colour, marker=style["marker"], linestyle="none",
            markerfacecolor="white" if hollow or not math.isfinite(pooled.half_width) else colour,
        )  # fmt: skip
    elif ratio_point.ratio is not None:
        intervals.append((below, ratio_point.ratio.value, ratio_point.ratio.low, ratio_point.ratio.high))
    for ax, value, *ends in intervals:
        of_first = ax is below and line.first is not None and bool(line.first.result.remark)
        point(ax, x, value, (ends[0], ends[1]), color=colour, hollow=hollow or of_first, marker=style["marker"])
    return [_Bar(ax, x, low, high, colour) for ax, _, low, high in intervals if math.isfinite(high - low)]


def _abscissa(comparison: Against) -> dict[float | str, float]:
    """Position of each value on the axis: in the displayed unit; words side by side."""
    if comparison.words:
        return {value: float(index) for index, value in enumerate(comparison.values)}
    scale = display.key(comparison.key).scale
    return {value: float(value) * scale for value in comparison.values}


def _range(lines: Sequence[Line]) -> tuple[float, float]:
    """Of all ratios with their intervals; those so wide that nothing else would be seen are cut."""
    ratios = [point.ratio for line in lines for point in line.points if point.ratio is not None]
    values = [1.0, *(ratio.value for ratio in ratios)]
    wide = _WHOLE * max(max(values) - min(values), 0.02)
    halves = [min(ratio.half_width, wide) if math.isfinite(ratio.half_width) else 0.0 for ratio in ratios]
    low = min([1.0, *(ratio.value - half for ratio, half in zip(ratios, halves, strict=True))])
    high = max([1.0, *(ratio.value + half for ratio, half in zip(ratios, halves, strict=True))])
    margin = 0.06 * (high - low) or 0.05
    return low - margin, high + margin
