"""Survival of avalanches, hazard per grain, and mean avalanche against D/d."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.report.style import COLOURS, DASHES, FAINT, MARKERS, MILLIMETRE, PAGE, house
from labbook.results.clogging import PointClogging, SeriesClogging

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PANELS = 7
"""Points drawn in the two panels of avalanches, at most."""


def clogging_figure(series: SeriesClogging) -> "Figure":
    """Draw three panels: the part of avalanches that are longer than s, the hazard over its mean, and 1/q against
    D/d with the fitted laws."""
    from matplotlib.figure import Figure

    with house():
        figure = Figure(figsize=(PAGE, 62 * MILLIMETRE))
        longer, hazards, mean = figure.subplots(1, 3)
        points = [point for point in series.points if point.probability is not None]
        stopped = [point for point in points if point.probability is not None and not point.probability.bound]
        spread = np.unique(np.linspace(0, len(stopped) - 1, min(_PANELS, len(stopped))).round().astype(int))
        for rank, index in enumerate(spread):
            _survival(longer, stopped[index], rank)
            _hazard(hazards, stopped[index], rank)
        longer.plot([0, 6], [1, math.exp(-6)], color=FAINT, linewidth=0.8, zorder=1)
        longer.set(
            yscale="log", ylim=(2e-3, 1.2), xlim=(0, 6), xlabel="grains $s$ / mean avalanche", ylabel="part longer"
        )
        hazards.axhline(1, color=FAINT, linewidth=0.8, zorder=1)
        hazards.set(xlabel="grains $s$ / mean avalanche", ylabel="stops per grain / $q$", ylim=(0, None))
        hazards.set_xlim(left=0)
        _means(mean, series, points)
        if len(spread):
            longer.legend(loc="upper right", title="$D/d$", title_fontsize=6.5)
    return figure


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
