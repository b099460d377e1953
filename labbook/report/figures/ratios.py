"""Flow rates over that of a plain hopper, against the angle of the bottom and against the position of the outlet."""

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.report.style import COLUMN, DASHES, FAINT, INK, MILLIMETRE, PAGE, house, look, mathtext, verbatim
from labbook.results import display
from labbook.results.ratios import ANGLE, GAP, RATIOS, Ratio, angle_laws
from labbook.results.reference import Comparison

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def flow_against_angle(ratios: Sequence[Ratio]) -> "Figure":
    """W(angle)/W(90 deg) of every outlet with 95 % intervals, and the angle factors of Brown and of Rose and Tanaka;
    below, how far the points lie from each.
    """
    from matplotlib.figure import Figure

    laws = angle_laws(ratios[0].result)
    low = min(one.at for one in ratios)
    angles = np.linspace(0.9 * low, math.pi / 2, 200)
    with house():
        figure = Figure(figsize=(COLUMN, (66 + 26 * len(laws)) * MILLIMETRE))
        axes = figure.subplots(1 + len(laws), 1, sharex=True, height_ratios=(2.6, *[1] * len(laws)))
        for law, below, dash in zip(laws, axes[1:], DASHES, strict=False):
            axes[0].plot(
                np.degrees(angles), [law.factor(a) for a in angles], color=INK, linestyle=dash, label=mathtext(law.name)
            )
            below.axhline(0, color=INK, linestyle=dash, linewidth=0.8, zorder=0)
            _points(below, ratios, ANGLE, math.degrees, lambda one, law=law: law.factor(one.at))
            below.set_ylabel(f"from {law.name.partition(',')[0]} [%]", fontsize=6.5)
        _points(axes[0], ratios, ANGLE, math.degrees)
        axes[-1].set_xlabel("angle of the bottom from the vertical, α [deg]")
        axes[0].set_ylabel("$W(α) / W(90°)$")
        axes[0].legend(loc="upper right")
        figure.align_ylabels()
    return figure


def flow_against_position(
    ratios: Sequence[Ratio], comparisons: Sequence[Comparison] = (), source: str = ""
) -> "Figure":
    """W over that of an outlet in the middle against s*, with 95 % intervals; diamonds: the reference's values."""
    from matplotlib.figure import Figure

    with house():
        figure = Figure(figsize=(PAGE * 0.75, 72 * MILLIMETRE))
        ax = figure.subplots()
        _points(ax, ratios, GAP, float)
        places = {tuple(one.result.at.items()): one.at for one in ratios}
        theirs = [c for c in comparisons if c.quantity in RATIOS and tuple(c.at.items()) in places]
        if theirs:
            x = [places[tuple(c.at.items())] for c in theirs]
            style = {"marker": "D", "markersize": 6, "markerfacecolor": "none", "linestyle": "none", "zorder": 4}
            ax.plot(x, [c.reference for c in theirs], color=INK, label=verbatim(source), **style)
        ax.axhline(1, color=FAINT, linewidth=0.6, zorder=0)
        ax.set_ylim(*_range(ratios))
        ax.set_xlabel("distance from the wall, $s^* = 2s/(L-D)$")
        ax.set_ylabel("$W / W$ in the middle")
        figure.legend(loc="outside right upper")
    return figure


def _range(ratios: Sequence[Ratio]) -> tuple[float, float]:
    """Of all values, with their intervals but for those so wide that nothing else would be seen."""
    values = [one.value for one in ratios]
    wide = 0.5 * (max(values) - min(values)) or 0.1
    low = min(max(one.low, one.value - wide) for one in ratios)
    high = max(min(one.high, one.value + wide) for one in ratios)
    return low - 0.05 * (high - low), high + 0.05 * (high - low)


def _points(
    ax: "Axes",
    ratios: Sequence[Ratio],
    key: str,
    scale: Callable[[float], float],
    law: Callable[[Ratio], float] | None = None,
) -> None:
    """Ratios, an outlet a colour; given a `law`, their distance from it in percent. Side by side where they fall
    together.
    """
    groups = list(dict.fromkeys(display.label(one.result.at, {key}) for one in ratios))
    span = float(np.ptp([scale(one.at) for one in ratios])) or 1.0
    for place, group in enumerate(groups):
        mine = sorted((one for one in ratios if display.label(one.result.at, {key}) == group), key=lambda one: one.at)
        offset = 0.005 * span * (place - (len(groups) - 1) / 2)
        style = {**look(place), "linestyle": "none", "markersize": 3.5}
        x, y, bars = [], [], []
        for one in mine:
            over = law(one) if law else 1.0
            part = 100 / over if law else 1.0
            x.append(scale(one.at) + offset)
            y.append((one.value - (over if law else 0.0)) * part)
            ends = [one.value - one.low, one.high - one.value]
            bars.append([end * part if math.isfinite(end) else 0.0 for end in ends])
        ax.errorbar(x, y, yerr=np.transpose(bars), label=group, **style)
