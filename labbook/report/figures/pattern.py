"""How beds flow: velocities of grains at one moment, and the mean speed with its streamlines."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.report.style import COLOURS, FAINT, INK, MILLIMETRE, PAGE, house
from labbook.scene.walls import Strip

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from labbook.report.pattern import FlowPattern

_COLUMNS = 4
_HEIGHT = 1.6  # widths of the hopper that are shown


def flow_patterns(patterns: Sequence["FlowPattern"]) -> "Figure":
    """Two rows a point: velocities of the grains at one moment; mean speed, streamlines and, hatched, what stands.

    Speeds have one scale of colours for all, that of a square root.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import PowerNorm
    from matplotlib.figure import Figure

    columns = min(_COLUMNS, len(patterns))
    rows = math.ceil(len(patterns) / columns)
    highest = max(float(np.nanpercentile(_speed(one), 99.5)) for one in patterns)
    norm = PowerNorm(0.5, 0.0, highest)
    with house():
        figure = Figure(figsize=(PAGE * max(columns, 2) / _COLUMNS, (12 + 120 * rows) * MILLIMETRE))
        axes = figure.subplots(2 * rows, columns, squeeze=False)
        for ax in axes.flat:
            ax.set_axis_off()
        for k, one in enumerate(patterns):
            above, below = axes[2 * (k // columns), k % columns], axes[2 * (k // columns) + 1, k % columns]
            _vectors(above, one, norm)
            _means(below, one, norm)
            above.set_title(one.result.label)
            below.set_title(f"{one.pattern.kind}, {100 * one.pattern.fraction:.2g} % stagnant")
            for ax in (above, below):
                _walls(ax, one)
        bar = figure.colorbar(ScalarMappable(norm, "viridis"), ax=axes, shrink=0.5, aspect=40)
        bar.set_label("speed [m/s]")
    return figure


def _speed(one: "FlowPattern") -> np.ndarray:
    return np.where(one.pattern.bed, np.hypot(one.fields.velocity[0], one.fields.velocity[2]), np.nan)


def _vectors(ax: "Axes", one: "FlowPattern", norm) -> None:
    x, z, u, w = (one.moment[name] for name in ("x", "z", "vx", "vz"))
    arrow = {"angles": "xy", "scale_units": "xy", "scale": norm.vmax / 12, "width": 0.003, "zorder": 3}
    ax.quiver(x * 1e3, z * 1e3, u, w, np.hypot(u, w), cmap="viridis", norm=norm, **arrow)


def _means(ax: "Axes", one: "FlowPattern", norm) -> None:
    z, x = one.fields.grid.points
    ax.pcolormesh(x * 1e3, z * 1e3, _speed(one), cmap="viridis", norm=norm, shading="nearest", rasterized=True)
    u, w = (np.where(one.pattern.bed & ~one.pattern.stagnant, one.fields.velocity[c], np.nan) for c in (0, 2))
    line = {"density": 0.7, "linewidth": 0.5, "arrowsize": 0.5, "color": "white"}
    ax.streamplot(x * 1e3, z * 1e3, u, w, **line)
    if one.pattern.stagnant.any():
        marked = np.ma.masked_where(~one.pattern.stagnant, np.ones(one.pattern.stagnant.shape))
        ax.contourf(x * 1e3, z * 1e3, marked, levels=[0.5, 1.5], colors="none", hatches=["////"])
        ax.contour(
            x * 1e3, z * 1e3, one.pattern.stagnant.astype(float), levels=[0.5], colors=[COLOURS[1]], linewidths=0.8
        )


def _walls(ax: "Axes", one: "FlowPattern") -> None:
    half = one.hopper.width / 2 * 1e3
    for wall in one.hopper.walls():
        if isinstance(wall.shape, Strip):
            (x0, z0), (x1, z1) = wall.shape.start, wall.shape.end
            ax.plot([x0 * 1e3, x1 * 1e3], [z0 * 1e3, z1 * 1e3], color=INK, linewidth=1.2, zorder=4)
    top = 2 * half * _HEIGHT
    for side in (-half, half):
        ax.axvline(side, color=FAINT, linewidth=0.6, zorder=0)
    ax.set_xlim(-1.04 * half, 1.04 * half)
    ax.set_ylim(-0.15 * half, top)
    ax.set_aspect("equal")
