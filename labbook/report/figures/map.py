"""Map of a quantity over two swept keys: the surface between the points, and points with their own mean."""

import math
from typing import TYPE_CHECKING

import numpy as np

from labbook.report.style import INK, MILLIMETRE, PAGE, house, mathtext
from labbook.results import display
from labbook.results.explore import DesignSurface, Factor
from labbook.results.points import PointResult

if TYPE_CHECKING:
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

WIDE = 0.15
"""Half width of an interval, over the mean, from which on a point has a ring."""
_PLACES = 121
_LEVELS = 6
_ROOM = 0.06
"""Room beside the outermost points, in ranges."""
_TICKS = 8
"""Swept values up to which each has a tick."""


def design_map(surface: DesignSurface) -> "Figure":
    """Draw a quantity over two keys: contours of the surface within the hull of its points, points filled by their own
    mean, rings around those whose 95 % interval is wide, crosses at those that are left out."""
    from matplotlib.figure import Figure

    unit = display.quantity(surface.quantity, surface.unit)
    with house():
        figure = Figure(figsize=(PAGE * 0.7, 84 * MILLIMETRE))
        ax = figure.subplots()
        u = np.linspace(-1, 1, _PLACES)
        designs = np.stack([axis.ravel() for axis in np.meshgrid(u, u)], axis=1)
        inside = surface.fit.inside(designs)
        field = np.full(len(designs), math.nan)
        field[inside] = surface.band(designs[inside])[0] * unit.scale
        values = np.array([result.pooled[surface.quantity].value for result in surface.points]) * unit.scale
        colours = {"cmap": "viridis", "vmin": float(values.min()), "vmax": float(values.max())}
        masked = np.ma.masked_invalid(field.reshape(_PLACES, _PLACES))
        image = ax.pcolormesh(u, u, masked, shading="nearest", rasterized=True, **colours)
        if values.max() > values.min():
            lines = ax.contour(u, u, masked, levels=_LEVELS, colors="white", linewidths=0.6)
            ax.clabel(lines, fontsize=5.5)
        used = np.array([_position(surface, result) for result in surface.points])
        ax.scatter(*used.T, c=values, s=34, edgecolors="white", linewidths=0.9, zorder=3, **colours)
        wide = np.array([result.pooled[surface.quantity].relative > WIDE for result in surface.points])
        ax.scatter(*used[wide].T, s=78, facecolors="none", edgecolors="#E69F00", linewidths=1.1, zorder=3)
        left_out = [_position(surface, result) for result in surface.left_out]
        if left_out:
            ax.scatter(*np.array(left_out).T, marker="x", s=26, color=INK, linewidths=1.1, zorder=3, clip_on=False)
        for limits, coordinates in zip((ax.set_xlim, ax.set_ylim), np.array([*used, *left_out]).T, strict=True):
            low, high = min(-1.0, float(coordinates.min())), max(1.0, float(coordinates.max()))
            limits(low - _ROOM * (high - low), high + _ROOM * (high - low))
        for axis, factor in zip((ax.xaxis, ax.yaxis), surface.factors, strict=True):
            _ticks(axis, factor, [float(result.at[factor.key]) for result in (*surface.points, *surface.left_out)])
            axis.set_label_text(mathtext(display.key(factor.key).heading))
        figure.colorbar(image, ax=ax, label=mathtext(unit.heading), shrink=0.9)
    return figure


def _position(surface: DesignSurface, result: PointResult) -> np.ndarray:
    return surface.scaled(np.array([[float(result.at[key]) for key in surface.keys]]))[0]


def _ticks(axis: "Axis", factor: Factor, values: list[float]) -> None:
    """Ticks at the swept values, or at some that are evenly spread."""
    ticks = sorted({*values})
    step = math.ceil(len(ticks) / _TICKS)
    ticks = [value for value in ticks[::step] if value > 0 or not factor.logarithmic]
    axis.set_ticks(factor.scaled(np.array(ticks)), [display.amount(factor.key, value) for value in ticks])
