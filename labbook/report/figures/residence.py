"""Residence times: maps over the initial position, layers in the outflow, distributions of fed silos."""

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.report.style import COLOURS, FAINT, MILLIMETRE, PAGE, house, verbatim
from labbook.results.residence import LAYER_NAMES, PooledCurve, PooledMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_TITLE = 40  # characters in a line of a panel's title
_ISOCHRONES = 6


def residence_maps(points: Sequence[PooledMap]) -> "Figure":
    """Draw for each point the time to leave over the initial position with isochrones, and the layers in the outflow.

    Grey: cells of which less than half had left at the end of the run.
    """
    from matplotlib.figure import Figure

    with house():
        figure = Figure(figsize=(PAGE, (12 + 62 * len(points)) * MILLIMETRE))
        axes = figure.subplots(len(points), 2, squeeze=False, width_ratios=(1, 1.4))
        for (left, right), pooled in zip(axes, points, strict=True):
            image = _map(left, pooled)
            figure.colorbar(image, ax=left, label="median time to leave [s]", shrink=0.9)
            _layers(right, pooled)
        handles, labels = axes[0, 1].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=len(labels))
    return figure


def _map(ax: "Axes", pooled: PooledMap):
    field = pooled.map
    across, z = field.across * 1e3, field.z * 1e3
    finite = np.ma.masked_invalid(field.median)
    image = ax.pcolormesh(across, z, finite, cmap="viridis", vmin=0)
    ax.pcolormesh(across, z, np.ma.masked_where(~np.isinf(field.median), np.ones_like(field.median)),
                  cmap="Greys", vmin=0, vmax=4)  # fmt: skip
    middle = [(edges[1:] + edges[:-1]) / 2 for edges in (across, z)]
    if min(field.median.shape) > 1 and finite.count() > 3 and np.ptp(finite.compressed()) > 0:
        lines = ax.contour(*middle, finite, levels=_ISOCHRONES, colors="white", linewidths=0.7)
        ax.clabel(lines, fontsize=5, fmt="%.3g s")
    ax.set_aspect("equal")
    ax.set_xlabel("initial distance from the axis [mm]" if field.across[0] >= 0 else "initial x [mm]")
    ax.set_ylabel("initial height [mm]")
    ax.set_title("\n".join(textwrap.wrap(verbatim(pooled.result.label), _TITLE)))
    return image


def _layers(ax: "Axes", pooled: PooledMap) -> None:
    """Stack the shares of the initial layers in the mass that leaves, the lowest at the bottom."""
    ax.set_xlabel("discharged fraction of the mass, $M$")
    ax.set_ylabel("share of the mass that leaves")
    ax.set_xlim(0, 1)
    ax.set_ylim(0, 1)
    if pooled.layers is None:
        return
    foot = np.zeros(pooled.layers.share.shape[1])
    for k, share in enumerate(pooled.layers.share):
        color = COLOURS[k % len(COLOURS)]
        ax.stairs(foot + share, pooled.layers.fraction, baseline=foot, fill=True, color=color, alpha=0.75,
                  label=LAYER_NAMES[k])  # fmt: skip
        foot = foot + share


def residence_distributions(points: Sequence[PooledCurve]) -> "Figure":
    """Draw F(t) and E(t) of fed silos: thin lines are single runs, thick ones their mean."""
    from matplotlib.figure import Figure

    with house():
        figure = Figure(figsize=(PAGE, 58 * MILLIMETRE))
        left, right = figure.subplots(1, 2)
        for k, pooled in enumerate(points):
            color, mean = COLOURS[k % len(COLOURS)], pooled.fractions.mean(axis=0)
            for curve in pooled.fractions if len(pooled.fractions) > 1 else ():
                left.plot(pooled.age, curve, color=color, alpha=0.35, linewidth=0.5)
            left.plot(pooled.age, mean, color=color, label=verbatim(pooled.result.label))
            right.stairs(np.diff(mean) / np.diff(pooled.age), pooled.age, color=color)
        left.axhline(1.0, color=FAINT, linewidth=0.6, zorder=0)
        left.set_ylabel("cumulative distribution, $F$")
        right.set_ylabel("exit-age distribution, $E$ [1/s]")
        for ax in (left, right):
            ax.set_xlabel("residence time, $t$ [s]")
            ax.set_xlim(left=0)
            ax.set_ylim(bottom=0)
        if any(pooled.result.label for pooled in points):
            left.legend(loc="lower right")
    return figure
