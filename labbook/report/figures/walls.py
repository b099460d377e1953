"""Stress on the walls of a silo against height and radius, and against time after the opening."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from labbook.fit.janssen import JanssenFit
from labbook.report.style import COLOURS, DASHES, FAINT, MARKERS, MILLIMETRE, PAGE, house
from labbook.results.walls import PooledWalls
from labbook.scene.timescales import gravity_time

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_KILO = 1e-3


def wall_profiles(walls: PooledWalls, fits: Mapping[str, Mapping[str, JanssenFit]]) -> "Figure":
    """Normal and shear stress by height of walls that are not level; normal stress on level walls; and the normal force
    on upright walls after the opening, over that at rest."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    layout = walls.layout
    level = [name for name, along in zip(layout.names, layout.coordinates, strict=True) if along != "height"]
    touched = [name for name in level if np.nansum(walls.by_bed("rest")[:, layout.of_wall(name), 0]) > 0]
    time, opening = walls.opening()
    panels = 2 + bool(touched) + bool(len(time))
    with house():
        figure = Figure(figsize=(PAGE, 75 * MILLIMETRE))
        axes = figure.subplots(1, panels, squeeze=False)[0]
        for ax, component, heading in zip(axes, (0, 1), ("normal", "shear"), strict=False):
            _by_height(ax, walls, component, fits)
            ax.set_xlabel(f"{heading} stress [kPa]")
        axes[0].set_ylabel("z [mm]")
        handles, labels = axes[0].get_legend_handles_labels()
        mark = {"color": FAINT, "marker": "o", "markersize": 3, "linestyle": ""}
        handles += [Line2D([], [], fillstyle="full", **mark), Line2D([], [], fillstyle="none", **mark)]
        labels += ["at rest", "later"]
        figure.legend(handles, labels, loc="outside lower center", ncols=7)
        if touched:
            _on_level_walls(axes[2], walls, touched)
        if len(time):
            _after_opening(axes[-1], walls, time, opening)
    return figure


def _by_height(ax: "Axes", walls: PooledWalls, component: int, fits: Mapping[str, Mapping[str, JanssenFit]]) -> None:
    layout = walls.layout
    (rest, error), (flow, within) = walls.pooled("rest"), walls.pooled("flow")
    if len(walls.beds) == 1:
        within, _ = walls.pooled("flow_error")
    sloped = [name for name, along in zip(layout.names, layout.coordinates, strict=True) if along == "height"]
    for index, name in enumerate(sloped):
        mine = layout.of_wall(str(name)) & (walls.by_bed("rest_contacts").sum(axis=0) > 0)
        if not mine.any():
            continue
        z = (layout.low + layout.high)[mine] / 2 * 1e3
        colour, marker = COLOURS[index % len(COLOURS)], MARKERS[index % len(MARKERS)]
        per_area = _KILO / layout.rest_area[mine]
        stress, bars = rest[mine, component] * per_area, np.nan_to_num(error[mine, component] * per_area)
        style = {"color": colour, "marker": marker, "markersize": 3, "linestyle": ""}
        ax.errorbar(stress, z, xerr=bars, elinewidth=0.7, label=str(name), **style)
        later = flow[mine, component] * per_area, np.nan_to_num(within[mine, component] * per_area)
        ax.errorbar(later[0], z, xerr=later[1], elinewidth=0.7, fillstyle="none", **style)
    surface = float(np.mean(walls.by_bed("surface")))
    for when, models in fits.items():
        for index, (model, fit) in enumerate(models.items()):
            if not fit.parameters["length"].determined():
                continue
            depth = np.linspace(float(fit.profile.depth.min()), float(fit.profile.depth.max()), 200)
            best = model in walls.preferred(when)
            style = {"color": "black" if best else FAINT, "linestyle": DASHES[index], "linewidth": 0.9}
            label = model if when == next(iter(fits)) else None
            ax.plot(fit.curves(depth)[component] * _KILO, (surface - depth) * 1e3, label=label, **style)
    ax.axvline(0, color=FAINT, linewidth=0.5, zorder=0)


def _on_level_walls(ax: "Axes", walls: PooledWalls, names: list[str]) -> None:
    layout = walls.layout
    rest, error = walls.pooled("rest")
    for index, name in enumerate(names):
        mine = layout.of_wall(name)
        with np.errstate(divide="ignore", invalid="ignore"):
            per_area = np.where(layout.rest_area[mine] > 0, _KILO / layout.rest_area[mine], np.nan)
        along = (layout.low + layout.high)[mine] / 2 * 1e3
        style = {"fmt": MARKERS[index % len(MARKERS)], "color": COLOURS[index % len(COLOURS)], "markersize": 3}
        ax.errorbar(along, rest[mine, 0] * per_area, yerr=np.nan_to_num(error[mine, 0] * per_area), label=name, **style)
    kind = layout.coordinates[list(layout.names).index(names[0])]
    ax.set_xlabel("r [mm]" if kind == "radius" else "x [mm]")
    ax.set_ylabel("normal stress at rest [kPa]")
    ax.legend()


def _after_opening(ax: "Axes", walls: PooledWalls, time: np.ndarray, opening: np.ndarray) -> None:
    scale = gravity_time(walls.result.point.scene)
    for row in opening:
        ax.plot(time / scale, row, color=FAINT, linewidth=0.5)
    ax.plot(time / scale, opening.mean(axis=0), color=COLOURS[0])
    ax.axhline(1, color=FAINT, linewidth=0.5, zorder=0)
    ax.set_xlabel("time [√(d*/g)]")
    ax.set_ylabel("normal force / at rest")
