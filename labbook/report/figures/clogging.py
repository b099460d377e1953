"""Survival of avalanches, hazard per grain, mean avalanche against D/d, and times between grains."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.report.style import COLOURS, DASHES, FAINT, MARKERS, MILLIMETRE, PAGE, house
from labbook.results.clogging import PointClogging, SeriesClogging
from labbook.stats.survival import PowerTail, kaplan_meier

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PANELS = 7
"""Points drawn in the panels of avalanches and of times, at most."""
_BEGIN = 0.98
"""Part of the times that are longer than the shortest one drawn."""


def clogging_figure(series: SeriesClogging) -> "Figure":
    """Draw the clogging of a series in two to four panels.

    They are the part of avalanches that are longer than s and the hazard over its mean, where a flow stopped; 1/q
    against D/d with the fitted laws; and the times between grains with their power laws, where walls move.

    Args:
        series: The points of one outlet or one other setting.
    """
    from matplotlib.figure import Figure

    points = [point for point in series.points if point.probability is not None]
    stopped = [point for point in points if point.probability is not None and not point.probability.bound]
    timed = [point for point in series.points if point.times is not None]
    with house():
        figure = Figure(figsize=(PAGE, 62 * MILLIMETRE))
        axes = list(figure.subplots(1, 2 * bool(stopped) + 1 + bool(timed), squeeze=False)[0])
        if stopped:
            _avalanches(axes[0], axes[1], stopped)
        if timed:
            _times(axes[-1], timed)
        _means(axes[2 * bool(stopped)], series, points)
    return figure


def _avalanches(longer: "Axes", hazards: "Axes", stopped: Sequence[PointClogging]) -> None:
    for place, index in enumerate(_spread(stopped)):
        _survival(longer, stopped[index], place)
        _hazard(hazards, stopped[index], place)
    longer.plot([0, 6], [1, math.exp(-6)], color=FAINT, linewidth=0.8, zorder=1)
    longer.set(
        yscale="log",
        ylim=(2e-3, 1.2),
        xlim=(0, 6),
        xlabel="grains $s$ / mean avalanche",
        ylabel="fraction that is longer",
    )
    longer.legend(loc="upper right", title="$D/d$", title_fontsize=6.5)
    hazards.axhline(1, color=FAINT, linewidth=0.8, zorder=1)
    hazards.set(xlabel="grains $s$ / mean avalanche", ylabel="stops per grain / $q$", ylim=(0, None))
    hazards.set_xlim(left=0)


def _spread(points: Sequence[PointClogging]) -> list[int]:
    """Indices of at most `_PANELS` points, evenly spaced."""
    return sorted({round(index) for index in np.linspace(0, len(points) - 1, min(_PANELS, len(points)))})


def _times(ax: "Axes", points: Sequence[PointClogging]) -> None:
    begins, ends = list[float](), list[float]()
    for place, index in enumerate(_spread(points)):
        point, colour = points[index], COLOURS[place]
        assert point.times is not None
        curve, label = kaplan_meier(*point.times), f"{point.width_ratio:.3g}"
        if isinstance(tail := point.tail, PowerTail):
            longest = float(point.times[0].max())
            start = float(curve.p[max(np.searchsorted(curve.x, tail.t_min) - 1, 0)])
            power = np.array([1.0, (longest / tail.t_min) ** (1 - tail.alpha)])
            ax.plot([tail.t_min, longest], start * power, color=colour, linestyle=DASHES[1], linewidth=0.9)
            label += f": α = {tail.alpha:.2f}"
        ax.step(curve.x, curve.p, where="post", color=colour, linewidth=0.9, label=label)
        begins.append(float(curve.x[np.argmax((curve.p < _BEGIN) & (curve.x > 0))]))
        ends.append(float(curve.p[curve.p > 0].min()))
    ax.set(xscale="log", yscale="log", xlabel="time between grains $T$ [s]", ylabel="fraction that is longer")
    ax.set_xlim(left=min(begins))
    ax.set_ylim(min(ends) / 5, 1.5)
    ax.legend(loc="lower left", title="$D/d$", title_fontsize=6.5)


def _survival(ax: "Axes", point: PointClogging, index: int) -> None:
    curve, q = point.survival, point.probability
    assert curve is not None
    assert q is not None
    ax.step(
        curve.x * q.value, curve.p, where="post", color=COLOURS[index], linewidth=0.9, label=f"{point.width_ratio:.3g}"
    )


def _hazard(ax: "Axes", point: PointClogging, index: int) -> None:
    curve, q = point.hazard, point.probability
    assert curve is not None
    assert q is not None
    middle = (curve.edges[:-1] + curve.edges[1:]) / 2 * q.value * (1 + 0.02 * index)
    rates = np.array([[rate.value, rate.low, rate.high] for rate in curve.rates]) / q.value
    bars = np.array([rates[:, 0] - rates[:, 1], rates[:, 2] - rates[:, 0]])
    style = {"color": COLOURS[index], "marker": MARKERS[index], "markersize": 3, "linewidth": 0.7}
    ax.errorbar(middle, rates[:, 0], bars, linestyle="none", **style)


def _means(ax: "Axes", series: SeriesClogging, points: Sequence[PointClogging]) -> None:
    for point in points:
        mean, low, high = point.mean_avalanche
        if math.isinf(mean):
            ax.plot([point.width_ratio], [low], marker=r"$\uparrow$", color=COLOURS[0], linestyle="none", markersize=6)
            continue
        ax.errorbar(
            [point.width_ratio], [mean], [[mean - low], [high - mean]], color=COLOURS[0], marker="o", linestyle="none"
        )
    if points:
        x = np.linspace(min(p.width_ratio for p in points), max(p.width_ratio for p in points), 200)
        for index, fit in enumerate(series.fits):
            mean = fit.mean(x)
            mean[~np.isfinite(mean)] = np.nan
            ax.plot(x, mean, color=COLOURS[1 + index], linestyle=DASHES[index], label=fit.law.name)
        ends = [end for p in points for end in p.mean_avalanche if math.isfinite(end)]
        ax.set_ylim(min(ends) / 2, max(ends) * 3)
    ax.set(yscale="log", xlabel="$D/d$", ylabel="mean avalanche $1/q$ [grains]")
    if series.fits:
        ax.legend(loc="upper left")
