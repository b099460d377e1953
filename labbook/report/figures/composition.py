"""Composition of the outflow against the discharged fraction."""

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.report.style import COLOURS, FAINT, MARKERS, MILLIMETRE, PAGE, house, legend_columns, verbatim
from labbook.results.composition import PooledShares

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLUMNS = 3
_TITLE = 36  # characters in a line of a panel's title


def composition_against_discharge(points: Sequence[PooledShares]) -> "Figure":
    """Draw X_i = x_i/x_i0 of each kind against the discharged fraction M, a panel for each point.

    Bars: standard error from seeds. Bands: counting error about a constant composition. Thin lines: single beds.
    """
    from matplotlib.figure import Figure

    columns = min(_COLUMNS, len(points))
    lines = math.ceil(len(points) / columns)
    with house():
        figure = Figure(figsize=(PAGE * max(columns, 2) / _COLUMNS, (16 + 44 * lines) * MILLIMETRE))
        axes = figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True)
        for ax, pooled in zip(axes.flat, points, strict=False):
            _draw(ax, pooled)
        for ax in axes.flat[len(points) :]:
            ax.set_axis_off()
        figure.supxlabel("discharged fraction of the mass, $M$", fontsize=7.5)
        figure.supylabel("relative share, $x_i/x_{i0}$", fontsize=7.5)
        handles, labels = axes[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=legend_columns(labels))
    return figure


def _draw(ax: "Axes", pooled: PooledShares) -> None:
    middle = (pooled.fraction[1:] + pooled.fraction[:-1]) / 2
    ax.axhline(1.0, color=FAINT, linewidth=0.6, zorder=0)
    for kind, name in enumerate(pooled.names):
        color, initial = COLOURS[kind % len(COLOURS)], pooled.initial[kind]
        noise = pooled.counting[kind] / initial
        ax.fill_between(middle, 1 - noise, 1 + noise, color=color, alpha=0.15, linewidth=0, zorder=0)
        for bed in pooled.beds if len(pooled.beds) > 1 else ():
            ax.plot(middle, bed.share[kind] / bed.initial[kind], color=color, alpha=0.3, linewidth=0.5, zorder=1)
        error = pooled.error[kind] / initial
        bars = error if np.isfinite(error).all() else None
        marker = MARKERS[kind % len(MARKERS)]
        value = pooled.share[kind] / initial
        ax.errorbar(middle, value, yerr=bars, color=color, marker=marker, markersize=3, label=name, zorder=2)
    title = verbatim(pooled.result.label)
    ax.set_title("\n".join(textwrap.wrap(title, _TITLE)))
    ax.set_xlim(0, max(1.0, pooled.fraction[-1]))
