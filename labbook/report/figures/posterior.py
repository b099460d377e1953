"""The posterior of parameters: each one alone, and each pair."""

from typing import TYPE_CHECKING, Literal

import numpy as np

from labbook.campaign.space import Axis
from labbook.report.style import COLOURS, FAINT, MILLIMETRE, PAGE, house
from labbook.results import display
from labbook.results.calibrated import CalibrationResults

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DRAWS = 60_000
_BINS = 32
_SMOOTHED = 1.0
"""Standard deviation [bins] by which counts of draws are smoothed."""
_DECADE = 30.0
"""Largest over smallest value of a logarithmic axis up to which it has ticks as a linear one has."""


def posterior_figure(calibration: CalibrationResults) -> "Figure":
    """Draw densities of parameters on the diagonal, and regions of 50 % and 95 % of each pair below."""
    from matplotlib.figure import Figure

    axes = calibration.inference.parameters
    p = len(axes)
    units = calibration.inference.draws(_DRAWS)
    draws = np.column_stack([axis.value(units[:, k]) * display.key(axis.key).scale for k, axis in enumerate(axes)])
    side = min(PAGE, (45 + 38 * p) * MILLIMETRE)
    with house():
        figure = Figure(figsize=(side, side if p > 1 else 0.7 * side))
        panels = figure.subplots(p, p, squeeze=False)
        for row in range(p):
            for column in range(p):
                ax = panels[row, column]
                if column > row:
                    ax.remove()
                    continue
                if row == column:
                    _alone(ax, calibration, row, draws[:, row])
                else:
                    _pair(ax, calibration, (column, row), draws)
                unit = display.key(axes[column].key)
                if row == p - 1:
                    ax.set_xlabel(unit.heading)
                if column == 0 and row > 0:
                    ax.set_ylabel(display.key(axes[row].key).heading)
    return figure


def _alone(ax: "Axes", calibration: CalibrationResults, index: int, draws: np.ndarray) -> None:
    from scipy.ndimage import gaussian_filter

    axis = calibration.inference.parameters[index]
    scale, interval = display.key(axis.key).scale, calibration.parameters[axis.key]
    edges = _edges(axis)
    counts = gaussian_filter(np.histogram(draws, edges)[0].astype(float), _SMOOTHED, mode="reflect")
    ax.axvspan(interval.low * scale, interval.high * scale, color=FAINT, alpha=0.3, linewidth=0)
    ax.plot(_middle(axis, edges), counts / counts.max(), color=COLOURS[0])
    ax.axvline(interval.median * scale, color=COLOURS[1], linewidth=0.9)
    ax.set(ylim=(0, 1.1), yticks=[])
    _range(ax, "x", axis)


def _pair(ax: "Axes", calibration: CalibrationResults, pair: tuple[int, int], draws: np.ndarray) -> None:
    from scipy.ndimage import gaussian_filter

    across, up = (calibration.inference.parameters[index] for index in pair)
    edges = [_edges(axis) for axis in (across, up)]
    counts = gaussian_filter(np.histogram2d(draws[:, pair[0]], draws[:, pair[1]], edges)[0], _SMOOTHED, mode="reflect")
    ordered = np.sort(counts.ravel())[::-1]
    mass = np.cumsum(ordered) / ordered.sum()
    levels = sorted({float(ordered[int(np.searchsorted(mass, probability))]) for probability in (0.95, 0.5)})
    middle = [_middle(axis, edge) for axis, edge in zip((across, up), edges, strict=True)]
    ax.contourf(*middle, counts.T, levels=[*levels, counts.max() + 1], colors=[COLOURS[0]], alpha=0.3)
    ax.contour(*middle, counts.T, levels=levels, colors=[COLOURS[0]], linewidths=0.8)
    trials = calibration.inference.trials
    for marker, clogged in ((".", False), ("x", True)):
        there = [trial.at for trial in trials if (trial.outcome == "clogged") == clogged]
        x, y = ([float(at[axis.key]) * display.key(axis.key).scale for at in there] for axis in (across, up))
        ax.plot(x, y, marker, color=COLOURS[1] if clogged else FAINT, markersize=2, zorder=0)
    _range(ax, "x", across)
    _range(ax, "y", up)


def _edges(axis: Axis) -> np.ndarray:
    """Edges of the bins of a parameter, in the unit that people read."""
    return axis.value(np.linspace(0, 1, _BINS + 1)) * display.key(axis.key).scale


def _middle(axis: Axis, edges: np.ndarray) -> np.ndarray:
    """Middles of bins, the outer ones at the ends of the range."""
    middle = np.sqrt(edges[1:] * edges[:-1]) if axis.logarithmic else (edges[1:] + edges[:-1]) / 2
    middle[[0, -1]] = edges[[0, -1]]
    return middle


def _range(ax: "Axes", letter: Literal["x", "y"], axis: Axis) -> None:
    """Show the range of the prior."""
    from matplotlib.ticker import FixedLocator, MaxNLocator, NullFormatter, ScalarFormatter

    low, high = axis.low * display.key(axis.key).scale, axis.high * display.key(axis.key).scale
    ax.set(**{f"{letter}lim": (low, high), f"{letter}scale": "log" if axis.logarithmic else "linear"})
    ticks = ax.xaxis if letter == "x" else ax.yaxis
    if axis.logarithmic:
        ticks.set_minor_formatter(NullFormatter())
        if high / low < _DECADE:
            tick_values = [tick for tick in MaxNLocator(4).tick_values(low, high) if low <= tick <= high]
            ticks.set_major_locator(FixedLocator(tick_values))
            ticks.set_major_formatter(ScalarFormatter())
    else:
        ticks.set_major_locator(MaxNLocator(4))
