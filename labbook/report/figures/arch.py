"""Arches that hold an outlet: grains and forces near it, and the number of grains against D/d."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.measure.arch import StoppedBed
from labbook.report.style import COLOURS, COLUMN, INK, MILLIMETRE, PAGE, house
from labbook.results.arch import PointArches
from labbook.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PICTURES = 3
"""Points whose bed is drawn, at most."""
_BESIDE, _ABOVE, _BELOW = 3.0, 2.5, 1.0
"""Diameters beside the outlet, above the arch and below the outlet that are drawn."""
_WIDEST = 3.0
"""Width of the line of the largest force [pt]."""


def arch_figure(points: Sequence[PointArches]) -> "Figure":
    """Draw the bed near the outlet at the last stop, of the narrowest, the widest and a middle outlet, and the size of
    arches against D/d."""
    from matplotlib.figure import Figure

    pictured = np.unique(np.linspace(0, len(points) - 1, min(_PICTURES, len(points))).round().astype(int))
    with house():
        figure = Figure(figsize=(PAGE, 48 * MILLIMETRE))
        *pictures, sizes = figure.subplots(1, len(pictured) + 1)
        for ax, place in zip(pictures, pictured, strict=True):
            point = points[place]
            draw_bed(ax, point.result.point.scene, point.last)
            ax.set_title(f"$D/d$ = {point.width:.3g}")
        pictures[0].set_ylabel("$z$ [mm]")
        _sizes(sizes, points)
    return figure


def stopped_bed(scene: Scene, bed: StoppedBed) -> "Figure":
    """Draw the bed near the outlet at a stop, with the arch that holds it."""
    from matplotlib.figure import Figure

    with house():
        figure = Figure(figsize=(COLUMN, 0.6 * COLUMN))
        ax = figure.subplots()
        draw_bed(ax, scene, bed)
        ax.set_ylabel("$z$ [mm]")
    return figure


def draw_bed(ax: "Axes", scene: Scene, bed: StoppedBed) -> None:
    """Draw grains near the outlet with the forces between them, those of the arch marked, and the walls."""
    from matplotlib.collections import EllipseCollection, LineCollection

    outlet, d = scene.container.outlets[0], scene.grains.diameter
    half, top = outlet.width / 2 + _BESIDE * d, bed.x[bed.rows, 2].max() + _ABOVE * d
    places = bed.x[:, [0, 2]] * 1e3
    inside = (np.abs(bed.x[:, 0] - outlet.centre) < half + d) & (bed.x[:, 2] < top + d)
    for rows, face, edge in ((np.flatnonzero(inside), "#eceff3", "#b9c3cf"), (bed.rows, "#f6c667", "#8a5a00")):
        size = np.full(len(rows), d * 1e3)
        circles = {"offsets": places[rows], "facecolors": face, "edgecolors": edge, "linewidths": 0.5, "zorder": 1}
        ax.add_collection(EllipseCollection(size, size, 0 * size, units="xy", offset_transform=ax.transData, **circles))
    near = inside[bed.pairs].all(axis=1)
    pairs, force = bed.pairs[near], bed.force[near]
    widths = _WIDEST * force / max(float(force.max(initial=0.0)), 1e-300)
    ax.add_collection(LineCollection(list(places[pairs]), linewidths=widths, colors=INK, capstyle="round", zorder=2))
    links = places[np.column_stack([bed.rows[:-1], bed.rows[1:]])]
    along = _WIDEST * bed.link / max(float(force.max(initial=0.0)), 1e-300)
    ax.add_collection(LineCollection(list(links), linewidths=along, colors=COLOURS[1], capstyle="round", zorder=3))
    for wall in scene.container.walls():
        for (x0, z0), (x1, z1) in wall.shape.section(scene.container.bounds):
            ax.plot([x0 * 1e3, x1 * 1e3], [z0 * 1e3, z1 * 1e3], color=INK, linewidth=1.2, zorder=4)
    ax.set_xlim((outlet.centre - half) * 1e3, (outlet.centre + half) * 1e3)
    ax.set_ylim((outlet.plane - _BELOW * d) * 1e3, top * 1e3)
    ax.set_aspect("equal")
    ax.locator_params(nbins=4)
    ax.set_xlabel("$x$ [mm]")


def _sizes(ax: "Axes", points: Sequence[PointArches]) -> None:
    for point in points:
        numbers, counts = np.unique(point.sizes, return_counts=True)
        ax.scatter(np.full(len(numbers), point.width), numbers, 40 * counts / counts.sum(), color=COLOURS[5], zorder=1)
    means, errors = ([getattr(point.size, name) for point in points] for name in ("value", "error"))
    ax.errorbar([point.width for point in points], means, errors, color=COLOURS[0], marker="o", linestyle="none")
    ax.set(xlabel="$D/d$", ylabel="grains of an arch")
    ax.set_ylim(0, max(point.sizes.max() for point in points) + 1)
