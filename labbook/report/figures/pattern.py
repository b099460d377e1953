"""Flow patterns of beds: velocities of grains at one moment, and the mean speed with its streamlines."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labbook.fields import Ring
from labbook.report.style import COLOURS, FAINT, INK, MILLIMETRE, PAGE, house
from labbook.results.recorded import Flowing, PlaneSection
from labbook.scene.quantities import percent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_COLUMNS = 4
_HEIGHT = 1.6  # widths of the hopper that are shown
_TITLE = 21  # characters that there is room for above a panel
_ARROW = 0.1  # widths of the hopper that the longest arrow is long
_KEY = -0.06  # where arrows with their speeds are shown, in heights of a panel


def flow_patterns(patterns: Sequence[Flowing], titles: Sequence[str] = ()) -> "Figure":
    """Two rows a point: velocities of the grains at one moment; mean speed, streamlines and, hatched, what stands.

    `titles`: of the points, if not their labels. Speeds have one scale of colours for all, that of a square root.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import PowerNorm
    from matplotlib.figure import Figure

    columns = min(_COLUMNS, len(patterns))
    rows = math.ceil(len(patterns) / columns)
    sections = [pattern.section() for pattern in patterns]
    highest = max(float(np.nanpercentile(speed_of(section), 99.5)) for section in sections)
    top = top_of(patterns)
    norm = PowerNorm(0.5, 0.0, highest)
    with house():
        figure = Figure(
            figsize=(
                PAGE * min(1, (columns + 0.5) / _COLUMNS),
                (12 + 2 * rows * row_height(patterns, top)) * MILLIMETRE,
            )
        )
        axes = figure.subplots(2 * rows, columns, squeeze=False)
        for ax in axes.flat:
            ax.set_axis_off()
        for k, flowing in enumerate(patterns):
            above, below = axes[2 * (k // columns), k % columns], axes[2 * (k // columns) + 1, k % columns]
            _vectors(above, flowing, norm)
            draw_means(below, sections[k], norm)
            title = titles[k] if titles else flowing.result.label
            above.set_title(title if len(title) <= _TITLE else title.replace(", ", "\n"))
            below.set_title(f"{percent(flowing.pattern.fraction, '.2g')} stagnant", fontsize=6.5)
            for ax in (above, below):
                draw_walls(ax, flowing, top)
        bar = figure.colorbar(ScalarMappable(norm, "viridis"), ax=axes, shrink=0.5, aspect=40)
        bar.set_label("speed [m/s]")
    return figure


def speed_of(section: PlaneSection) -> np.ndarray:
    """Speed in the plane [m/s]; NaN beyond the bed."""
    return np.where(section.bed, np.hypot(section.u, section.w), np.nan)


def _vectors(ax: "Axes", flowing: Flowing, norm) -> None:
    """Arrows as long as the square root of the speed: the bed is a hundred times slower than the outlet."""
    x, z, u, w = (flowing.moment[name] for name in ("x", "z", "vx", "vz"))
    shrink = 1 / np.sqrt(np.maximum(np.hypot(u, w), 1e-12))
    arrow = {
        "angles": "xy",
        "scale_units": "xy",
        "scale": np.sqrt(norm.vmax) / (_ARROW * 2e3 * _half_width(flowing)),
        "width": 0.004,
        "headwidth": 4,
        "headlength": 4,
        "minlength": 0.3,
        "zorder": 3,
        "rasterized": True,
    }
    # in ink: the light colours of fast grains would vanish on white, on screen and in grey
    arrows = ax.quiver(x * 1e3, z * 1e3, u * shrink, w * shrink, color=INK, **arrow)
    digit = float(f"{norm.vmax / 2:.1g}")
    for speed, x in ((digit / 10, 0.4), (digit, 0.87)):
        # The arrow alone: a key's own label takes no room in the layout. As an image it is lost in SVG and PDF.
        ax.quiverkey(arrows, x, _KEY, math.sqrt(speed), "", labelpos="W", coordinates="axes", rasterized=False)
        ax.annotate(
            f"{speed:g} m/s",
            (x, _KEY),
            (-6, 0),
            "axes fraction",
            "offset points",
            size=6,
            ha="right",
            va="center",
            annotation_clip=False,
        )


def draw_means(ax: "Axes", section: PlaneSection, norm) -> None:
    """Mean speed with streamlines; what stands is hatched."""
    from matplotlib.patheffects import Normal, Stroke

    x, z = even(section.x) * 1e3, even(section.z) * 1e3
    ax.pcolormesh(x, z, speed_of(section), cmap="viridis", norm=norm, shading="nearest", rasterized=True)
    u, w = (np.where(section.bed & ~section.stagnant, v, np.nan) for v in (section.u, section.w))
    lines = ax.streamplot(x, z, u, w, density=0.7, linewidth=0.5, arrowsize=0.5, color="white").lines
    lines.set_path_effects([Stroke(linewidth=1.1, foreground=INK, alpha=0.5), Normal()])  # seen on light colours too
    if section.stagnant.any():
        marked = np.ma.masked_where(~section.stagnant, np.ones(section.stagnant.shape))
        ax.contourf(x, z, marked, levels=[0.5, 1.5], colors="none", hatches=["////"])
        ax.contour(x, z, section.stagnant.astype(float), levels=[0.5], colors=[COLOURS[1]], linewidths=0.8)


def even(points: np.ndarray) -> np.ndarray:
    """Coordinates with exactly equal spacings, which streamlines require."""
    return np.linspace(points[0], points[-1], len(points))


def top_of(patterns: Sequence[Flowing]) -> float:
    """Height [m] up to which beds are shown: a little above the highest, and no more than 1.6 widths."""
    beds = []
    for flowing in patterns:
        grid = flowing.fields.grid
        z_axis = grid.axes.index("z")
        filled = flowing.pattern.bed.any(axis=tuple(k for k in range(len(grid.axes)) if k != z_axis))
        beds.append(float(grid.points[z_axis][filled].max()))
    return min(1.08 * max(beds), 2 * _HEIGHT * _half_width(patterns[0]))


def row_height(patterns: Sequence[Flowing], top: float) -> float:
    """Height [mm] of a panel that is a quarter of a page wide, with its title."""
    return 8 + 34 * (top / (2 * _half_width(patterns[0])) + 0.1)


def _half_width(one: Flowing) -> float:
    return one.fields.grid.radius if isinstance(one.fields.grid, Ring) else one.container.width / 2


def draw_walls(ax: "Axes", flowing: Flowing, top: float) -> None:
    """Walls in the plane of the map, up to the height `top` [m], and axes in mm, with numbers at the edges only."""
    half = _half_width(flowing)
    for wall in flowing.container.walls():
        for (x0, z0), (x1, z1) in wall.shape.section():
            ax.plot([x0 * 1e3, x1 * 1e3], [z0 * 1e3, z1 * 1e3], color=INK, linewidth=1.2, zorder=4)
    half *= 1e3
    ax.set_axis_on()
    ax.spines[:].set_visible(False)
    ax.locator_params(nbins=5)
    subplot = ax.get_subplotspec()
    first, last = subplot is None or subplot.is_first_col(), subplot is None or subplot.is_last_row()
    ax.tick_params(left=first, labelleft=first, bottom=last, labelbottom=last)
    ax.set_ylabel("z [mm]" if first else "")
    ax.set_xlabel("x [mm]" if last else "")
    for side in (-half, half):
        ax.axvline(side, color=FAINT, linewidth=0.6, zorder=0)
    ax.set_xlim(-1.04 * half, 1.04 * half)
    ax.set_ylim(-0.15 * half, top * 1e3)
    ax.set_aspect("equal")
