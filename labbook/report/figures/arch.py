"""Arches and domes that hold an outlet: grains and forces near it, and the number of grains against D/d."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.measure.arch import StoppedBed, planes_of
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
    arches against D/d. Domes are drawn from the front and, below, from above."""
    from matplotlib.figure import Figure

    pictured = np.unique(np.linspace(0, len(points) - 1, min(_PICTURES, len(points))).round().astype(int))
    above = any(not flat(points[index].result.point.scene) for index in pictured)
    with house():
        figure = Figure(figsize=(PAGE, (96 if above else 48) * MILLIMETRE))
        grid = figure.add_gridspec(1 + above, len(pictured) + 1)
        for column, index in enumerate(pictured):
            point = points[index]
            scene, bed = point.result.point.scene, point.last
            front = figure.add_subplot(grid[0, column])
            draw_bed(front, scene, bed)
            front.set_title(f"$D/d$ = {point.width_ratio:.3g}")
            front.set_ylabel("" if column else "$z$ [mm]")
            if above:
                plan = figure.add_subplot(grid[1, column])
                draw_from_above(plan, scene, bed)
                plan.set_ylabel("" if column else "$y$ [mm]")
        _sizes(figure.add_subplot(grid[:, -1]), points)
    return figure


def stopped_bed(scene: Scene, bed: StoppedBed) -> "Figure":
    """Draw the bed near the outlet at a stop, with the arch that holds it; a dome also from above."""
    from matplotlib.figure import Figure

    with house():
        if flat(scene):
            figure = Figure(figsize=(COLUMN, 0.6 * COLUMN))
            front = figure.subplots()
        else:
            figure = Figure(figsize=(PAGE, 0.6 * COLUMN))
            front, plan = figure.subplots(1, 2)
            draw_from_above(plan, scene, bed)
            plan.set_ylabel("$y$ [mm]")
        draw_bed(front, scene, bed)
        front.set_ylabel("$z$ [mm]")
    return figure


def flat(scene: Scene) -> bool:
    """True of a layer, whose arch is a chain in one plane."""
    return len(planes_of(scene)) == 1


def draw_bed(ax: "Axes", scene: Scene, bed: StoppedBed) -> None:
    """Draw grains near the outlet with the forces between them, those of the arch marked, and the walls. Of a deep bed
    only the section in the middle, with all of the dome."""
    outlet, d = scene.container.outlets[0], scene.grains.diameter
    half, top = outlet.width / 2 + _BESIDE * d, bed.x[bed.rows, 2].max() + _ABOVE * d
    inside = (np.abs(bed.x[:, 0] - outlet.centre) < half + d) & (bed.x[:, 2] < top + d)
    if not flat(scene):
        inside &= np.abs(bed.x[:, 1]) < d / 2
    _draw_grains(ax, scene, bed, inside, (0, 2))
    for wall in scene.container.walls():
        for (x0, z0), (x1, z1) in wall.shape.section(scene.container.bounds):
            ax.plot([x0 * 1e3, x1 * 1e3], [z0 * 1e3, z1 * 1e3], color=INK, linewidth=1.2, zorder=4)
    ax.set_xlim((outlet.centre - half) * 1e3, (outlet.centre + half) * 1e3)
    ax.set_ylim((outlet.plane - _BELOW * d) * 1e3, top * 1e3)


def draw_from_above(ax: "Axes", scene: Scene, bed: StoppedBed) -> None:
    """Draw the dome with the forces along it, and the edge of the outlet, from above."""
    from matplotlib.patches import Circle

    outlet, d = scene.container.outlets[0], scene.grains.diameter
    half = outlet.width / 2 + _BESIDE * d
    _draw_grains(ax, scene, bed, np.zeros(len(bed.x), bool), (0, 1))
    if outlet.form == "hole":
        middle = (outlet.centre * 1e3, 0.0)
        ax.add_patch(Circle(middle, outlet.width / 2 * 1e3, fill=False, color=INK, linewidth=1.2, zorder=4))
        ax.set_ylim(-half * 1e3, half * 1e3)
    else:
        for edge in (outlet.centre - outlet.width / 2, outlet.centre + outlet.width / 2):
            ax.axvline(edge * 1e3, color=INK, linewidth=1.2, zorder=4)
        depth = scene.container.front_to_back * 1e3
        ax.set_ylim(-depth / 2, depth / 2)
    ax.set_xlim((outlet.centre - half) * 1e3, (outlet.centre + half) * 1e3)


def _draw_grains(ax: "Axes", scene: Scene, bed: StoppedBed, inside: np.ndarray, axes: tuple[int, int]) -> None:
    """Draw grains of the bed and, over them, those of the arch, with the forces between them, seen along an axis."""
    from matplotlib.collections import EllipseCollection, LineCollection

    centres, d = bed.x[:, list(axes)] * 1e3, scene.grains.diameter
    depth = {1: -bed.x[:, 1], 2: bed.x[:, 2]}[3 - sum(axes)]
    arch = bed.rows[np.argsort(depth[bed.rows], kind="stable")]
    for rows, face, edge in ((np.flatnonzero(inside), "#eceff3", "#b9c3cf"), (arch, "#f6c667", "#8a5a00")):
        size = np.full(len(rows), d * 1e3)
        circles = {"offsets": centres[rows], "facecolors": face, "edgecolors": edge, "linewidths": 0.5, "zorder": 1}
        ax.add_collection(EllipseCollection(size, size, 0 * size, units="xy", offset_transform=ax.transData, **circles))
    near = inside[bed.pairs].all(axis=1)
    pairs, force = bed.pairs[near], bed.force[near]
    largest = max(float(force.max(initial=0.0)), float(bed.link.max(initial=0.0)), 1e-300)
    widths, along = _WIDEST * force / largest, _WIDEST * bed.link / largest
    ax.add_collection(LineCollection(list(centres[pairs]), linewidths=widths, colors=INK, capstyle="round", zorder=2))
    links = list(centres[bed.links])
    ax.add_collection(LineCollection(links, linewidths=along, colors=COLOURS[1], capstyle="round", zorder=3))
    ax.set_aspect("equal")
    ax.locator_params(nbins=4)
    ax.set_xlabel("$x$ [mm]")


def _sizes(ax: "Axes", points: Sequence[PointArches]) -> None:
    for point in points:
        numbers, counts = np.unique(point.sizes, return_counts=True)
        ax.scatter(
            np.full(len(numbers), point.width_ratio), numbers, 40 * counts / counts.sum(), color=COLOURS[5], zorder=1
        )
    means, errors = ([getattr(point.size, name) for point in points] for name in ("value", "error"))
    ax.errorbar([point.width_ratio for point in points], means, errors, color=COLOURS[0], marker="o", linestyle="none")
    ax.set(xlabel="$D/d$", ylabel="grains of an arch")
    ax.set_ylim(0, max(point.sizes.max() for point in points) + 1)
