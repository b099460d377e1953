"""Figures of Pongo et al. (2022): flow rate and fields above the orifice against the rotation of the bottom (Figs 2, 3
and 8 to 10), Q(D) on logarithmic axes (Figs 4 and 5), and maps in a plane through the axis of a silo (Figs 6 and 7)."""

import math
from collections.abc import Callable, Sequence
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from labbook.fields import Fields, Ring, pattern_of
from labbook.measure.acceleration import AccelerationProfile
from labbook.measure.bed import omega_of
from labbook.measure.stress import contact_pressure
from labbook.papers.pongo2022.rotation import (
    CLOSE,
    FLOW,
    ROTATION,
    Rotation,
    aspect_ratio,
    relative_orifice,
    shape_of,
    turning_at,
)
from labbook.report.figures.pattern import draw_means, draw_walls, even, row_height, speed_of, top_of
from labbook.report.style import COLUMN, FAINT, MILLIMETRE, PAGE, from_zero, house, look
from labbook.results import display
from labbook.results.points import by_seed
from labbook.results.recorded import Flowing, across, both
from labbook.results.series import Series

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FREQUENCY = "rotation of the bottom, $f$ [Hz]"
_PANELS = {
    "orifice_packing_fraction": (r"$\langle\phi\rangle$", 1.0),
    "orifice_v_z": (r"$-\langle v_z\rangle$ [m/s]", -1.0),
    "orifice_kinetic_pressure": (r"$\langle p_k\rangle$ [Pa]", 1.0),
    "free_fall_height": ("free-fall height [mm]", 1e3),
    "orifice_O_zz": (r"$\langle O_{zz}\rangle$", 1.0),
    "orifice_O_rr": (r"$\langle O_{rr}\rangle$", 1.0),
    "orifice_O_tt": (r"$\langle O_{tt}\rangle$", 1.0),
    "orifice_S": (r"$\langle S\rangle$", 1.0),
}


def flow_against_rotation(curves: Sequence[Rotation]) -> "Figure":
    """Plot Q(f) above and Q(f)/Q(0) below, if any is measured; a column a shape, a line an outlet.

    Above, dots are seeds, and bars one standard error; below, bars are 90 % intervals. Points with a remark are hollow,
    and so are ratios to one.
    """
    from matplotlib.figure import Figure

    rated = any(curve.rated for curve in curves)
    shapes = [(shape, list(group)) for shape, group in groupby(curves, key=lambda curve: curve.shape)]
    labels = sorted({curve.label: curve.orifice for curve in curves}.items(), key=lambda item: item[1])
    position = {label: index for index, (label, _) in enumerate(labels)}
    with house():
        width = COLUMN if len(shapes) == 1 and len(position) == 1 else PAGE
        figure = Figure(figsize=(width, (104 if rated else 62) * MILLIMETRE))
        axes = figure.subplots(2 if rated else 1, len(shapes), sharex=True, sharey="row", squeeze=False)
        for column, (shape, group) in enumerate(shapes):
            above, lowest = axes[0, column], axes[-1, column]
            above.set_title(shape)
            for curve in group:
                _rates(above, curve, position[curve.label])
                if curve.rated:
                    _ratios(lowest, curve, position[curve.label])
            if rated:
                lowest.axhline(1, color=FAINT, linewidth=0.6, zorder=0)
            lowest.set_xlabel(_FREQUENCY if len(shapes) < 3 else "$f$ [Hz]")
        if rated:
            from_zero(axes[1, 0])
            axes[1, 0].set_ylabel("$Q(f)/Q(0)$")
        from_zero(axes[0, 0])
        axes[0, 0].set_ylabel("$Q$ [grains/s]")
        lines = {text: line for ax in axes[0] for line, text in zip(*ax.get_legend_handles_labels(), strict=True)}
        if lines:
            visible = [label for label in position if label in lines]
            figure.legend([lines[label] for label in visible], visible, loc="outside right upper")
        figure.align_ylabels()
    return figure


def _rates(ax: "Axes", curve: Rotation, index: int) -> None:
    style, measured = {**look(index), "markersize": 3}, [point for point in curve.points if FLOW in point.pooled]
    f = [curve.frequencies[curve.points.index(point)] for point in measured]
    for x, point in zip(f, measured, strict=True):
        seeds = list(by_seed(point, FLOW).values())
        ax.plot([x] * len(seeds), seeds, color=style["color"], marker=".", markersize=2.5, alpha=0.4, linestyle="none")
    values = [point.pooled[FLOW].value for point in measured]
    errors = [np.nan_to_num(point.pooled[FLOW].error) for point in measured]
    if measured:
        ax.errorbar(f, values, yerr=errors, label=curve.label or None, **style)
    _hollow(ax, f, values, [bool(point.remark) for point in measured], style)


def _ratios(ax: "Axes", curve: Rotation, index: int) -> None:
    is_open, style = bool(curve.points[0].remark), {**look(index), "markersize": 3}
    ratios = [(0.0, 1.0, 0.0, is_open)]
    for k in range(1, len(curve.points)):
        ratio = curve.ratio(FLOW, k)
        if ratio is not None:
            half = ratio.half_width if math.isfinite(ratio.half_width) else 0.0
            ratios.append((float(curve.frequencies[k]), ratio.value, half, is_open or bool(curve.points[k].remark)))
    f, values, errors, remarked = zip(*ratios, strict=True)
    ax.errorbar(f, values, yerr=errors, **style)
    _hollow(ax, f, values, remarked, style)


def _hollow(ax: "Axes", f: Sequence[float], values: Sequence[float], flags: Sequence[bool], style: dict) -> None:
    """Empty the markers of points with a remark."""
    empty = {**style, "linestyle": "none", "markerfacecolor": "white", "zorder": 4}
    for x, y in (at for at, marked in zip(zip(f, values, strict=True), flags, strict=True) if marked):
        ax.plot(x, y, **empty)


def drop_and_rise(curves: Sequence[Rotation]) -> "Figure":
    """Plot Q_min/Q(0) and Q(fastest)/Q_min against L/d.

    Full lines: equal D/d*, dashed: equal D; bars: 90 % intervals.
    """
    from matplotlib.figure import Figure

    determined = [curve for curve in curves if curve.lowest() is not None]
    with house():
        figure = Figure(figsize=(PAGE, 66 * MILLIMETRE))
        axes = figure.subplots(1, 2)
        for ax, of in zip(axes, ("drop", "rise"), strict=True):
            for index, (text, group, dashed) in enumerate(_lines(determined)):
                points = [(aspect_ratio(curve.points[0]), ratio) for curve in group if (ratio := _extreme(curve, of))]
                half = [np.nan_to_num(ratio.half_width, posinf=0.0) for _, ratio in points]
                style = {**look(index), "linestyle": "--" if dashed else "-"}
                ax.errorbar([x for x, _ in points], [r.value for _, r in points], yerr=half, label=text, **style)
            ax.axhline(1, color=FAINT, linewidth=0.6, zorder=0)
            ax.set_xlabel("aspect ratio, $L/d$")
        axes[0].set_ylabel(r"$Q_\mathrm{min}/Q(0)$")
        fastest = determined[0].frequencies[-1]
        axes[1].set_ylabel(rf"$Q({fastest:g}\,\mathrm{{Hz}})/Q_\mathrm{{min}}$")
        from_zero(axes[0])
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right upper")
    return figure


def _extreme(curve: Rotation, of: str):
    """Flow rate at its minimum over that at rest (`drop`), or at the fastest rotation over the minimum."""
    lowest = curve.lowest()
    assert lowest is not None
    return curve.ratio(FLOW, lowest) if of == "drop" else curve.ratio(FLOW, len(curve.points) - 1, lowest)


def _lines(curves: Sequence[Rotation]) -> list[tuple[str, list[Rotation], bool]]:
    """Group curves by equal D, then by nearly equal D/d*; groups have at least two shapes."""
    lines = []
    for orifice in dict.fromkeys(curve.orifice for curve in curves):
        group = [curve for curve in curves if curve.orifice == orifice]
        lines.append((f"D = {orifice * 1e3:.4g} mm", group, True))
    for first in curves:
        wide = relative_orifice(first.points[0])
        group = [curve for curve in curves if abs(relative_orifice(curve.points[0]) / wide - 1) < CLOSE]
        if group[0] is first and len({curve.orifice for curve in group}) > 1:
            lines.append((f"D/d* = {wide:.2g}", group, False))
    return [(text, group, dashed) for text, group, dashed in lines if len({curve.shape for curve in group}) > 1]


def above_orifice(curves: Sequence[Rotation]) -> "Figure":
    """Plot means above the orifice against f, a panel a quantity, a line a shape and outlet.

    Bars: one standard error.
    """
    from matplotlib.figure import Figure

    panels = [name for name in _PANELS if any(curve.has(name) for curve in curves)]
    columns = min(4, len(panels))
    rows = math.ceil(len(panels) / columns)
    with house():
        figure = Figure(figsize=(PAGE, (10 + 46 * rows) * MILLIMETRE))
        axes = figure.subplots(rows, columns, sharex=True, squeeze=False)
        for ax in axes.flat[len(panels) :]:
            ax.set_axis_off()
        for ax, name in zip(axes.flat, panels, strict=False):
            text, scale = _PANELS[name]
            for index, curve in enumerate(curves):
                indices = [k for k, point in enumerate(curve.points) if name in point.pooled]
                pooled = [curve.points[k].pooled[name] for k in indices]
                errors = [np.nan_to_num(mean.error) * abs(scale) for mean in pooled]
                label = ", ".join(filter(None, (curve.shape, curve.label)))
                f, values = curve.frequencies[indices].tolist(), [mean.value * scale for mean in pooled]
                style = {**look(index), "markersize": 3}
                if indices:
                    ax.errorbar(f, values, yerr=errors, label=label, **style)
                    _hollow(ax, f, values, [bool(curve.points[k].remark) for k in indices], style)
            ax.set_ylabel(text)
            ax.set_xlabel("$f$ [Hz]")
            ax.tick_params(labelbottom=True)
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=min(4, len(curves)))
    return figure


def acceleration_against_rotation(
    accelerations: Sequence[tuple[Rotation, Sequence[tuple[float, AccelerationProfile]]]], gravity: float
) -> "Figure":
    """Plot a_eff/g against the starting height of grains, in widths of the outlet; a panel a curve, a line a frequency.

    `accelerations`: of each curve, frequencies [Hz] and profiles. Bars: one standard error.
    """
    from matplotlib.figure import Figure

    columns = min(3, len(accelerations))
    rows = math.ceil(len(accelerations) / columns)
    with house():
        width = COLUMN if columns == 1 else PAGE
        figure = Figure(figsize=(width, (8 + 56 * rows) * MILLIMETRE))
        axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for ax in axes.flat[len(accelerations) :]:
            ax.set_axis_off()
        for ax, (curve, profiles) in zip(axes.flat, accelerations, strict=False):
            ax.set_title(", ".join(filter(None, (curve.shape, curve.label))))
            for index, (f, profile) in enumerate(profiles):
                finite = np.isfinite(profile.error)
                height = (profile.edges[1:] + profile.edges[:-1])[finite] / 2 / curve.orifice
                value, error = -profile.acceleration[finite] / gravity, profile.error[finite] / gravity
                label = f"f = {display.number(f)} Hz"
                ax.errorbar(height, value, yerr=error, label=label, **{**look(index), "markersize": 3})
            ax.axhline(0, color=FAINT, linewidth=0.6, zorder=0)
            ax.set_xlabel("$z/D$")
            ax.legend(loc="best")
        axes[0, 0].set_ylabel("downward acceleration / g")
    return figure


_LAWS = ("power", "exponential")


def flow_scaling(series: Sequence[Series]) -> "Figure":
    """Plot Q against D, a column a frequency: both axes logarithmic above, only Q below; side by side for one column.

    Lines: the fitted power and exponential; bars: one standard error; grey: the slope 5/2.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

    turns = list(dict.fromkeys(entry.at.get(ROTATION) for entry in series))
    names = list(dict.fromkeys(map(_name, series)))
    with house():
        alone = len(turns) == 1
        figure = Figure(figsize=(PAGE, (74 if alone else 116) * MILLIMETRE))
        axes = figure.subplots(*((1, 2) if alone else (2, len(turns))), sharey=True, squeeze=False).reshape(2, -1)
        for column, turn in enumerate(turns):
            if turn is not None:
                axes[0, column].set_title(display.setting(ROTATION, turn))
            for entry in (entry for entry in series if entry.at.get(ROTATION) == turn):
                for ax, law in zip(axes[:, column], _LAWS, strict=True):
                    _draw(ax, entry, law, names.index(_name(entry)))
            _slope(axes[0, column])
            axes[0, column].set_xscale("log")
            axes[0, column].xaxis.set_major_locator(LogLocator(subs=(2, 3, 4, 5, 6, 7, 8)))
            axes[0, column].xaxis.set_major_formatter(ScalarFormatter())
            axes[0, column].xaxis.set_minor_formatter(NullFormatter())
            for ax in axes[:, column] if alone else axes[1:, column]:
                ax.set_xlabel("$D$ [mm]")
        for ax in axes[:, 0]:
            ax.set_ylabel("$Q$ [grains/s]" if ax.get_subplotspec().is_first_col() else "")
            ax.set_yscale("log")
            ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            ax.yaxis.set_major_formatter(ScalarFormatter())
            ax.yaxis.set_minor_formatter(NullFormatter())
        lines = {text: line for ax in axes[0] for line, text in zip(*ax.get_legend_handles_labels(), strict=True)}
        labels = [name for name in (*names, _SLOPE) if name in lines]
        figure.legend([lines[name] for name in labels], labels, loc="outside upper right", ncols=min(4, len(labels)))
    return figure


_SLOPE = "slope 5/2"


def _name(series: Series) -> str:
    other_keys = display.label({k: v for k, v in series.at.items() if k != ROTATION and not k.startswith("grains.")})
    return ", ".join(filter(None, (shape_of(series.points[0]), other_keys)))


def _draw(ax: "Axes", series: Series, law: str, index: int) -> None:
    measured = [result for result in series.points if FLOW in result.pooled]
    D = np.array([result.orifice for result in measured])
    pooled = [result.pooled[FLOW] for result in measured]
    errors = [min(np.nan_to_num(p.error), 0.95 * p.value) for p in pooled]
    style = look(index)
    points = {**style, "linestyle": "none", "markersize": 3}
    ax.errorbar(D * 1e3, [p.value for p in pooled], yerr=errors, label=_name(series), **points)
    if law in series.fits:
        fine = np.geomspace(D.min(), D.max(), 60)
        value, _, _ = series.fits[law].band(fine)
        mass = series.points[0].point.scene.grains.mass
        ax.plot(fine * 1e3, value / mass, color=style["color"], linestyle=style["linestyle"], linewidth=0.8)


def _slope(ax: "Axes") -> None:
    """Draw a line of slope 5/2 through the largest value."""
    D, Q = (np.concatenate([np.asarray(line[0].get_data()[k], float) for line in ax.containers]) for k in (0, 1))
    ends, top = np.array([D.min(), D.max()]), int(Q.argmax())
    ax.plot(ends, Q[top] * (ends / D[top]) ** 2.5, color=FAINT, linewidth=0.9, label=_SLOPE, zorder=0)


_COLUMNS = 4
Map = tuple[np.ndarray, np.ndarray, np.ndarray]
"""x and z [mm], and values, shape [z, x]."""


def packing_maps(rows: Sequence[Sequence[Flowing]]) -> "Figure":
    """Map the packing fraction, a row a point, a column an instant."""
    from matplotlib.colors import Normalize

    maps = {
        id(flowing): _mirrored(flowing, flowing.fields, flowing.fields.packing_fraction, flowing.pattern.bed)
        for row in rows
        for flowing in row
    }
    norm = Normalize(*_range(maps.values()))

    def draw(ax: "Axes", flowing: Flowing) -> None:
        _mesh(ax, maps[id(flowing)], norm)

    return _instants(rows, draw, norm, r"packing fraction $\phi$")


def speed_maps(rows: Sequence[Sequence[Flowing]]) -> "Figure":
    """Map the speed in the plane with streamlines, a row a point, a column an instant; hatched: stagnant."""
    from matplotlib.colors import PowerNorm

    sections = {id(flowing): flowing.section() for row in rows for flowing in row}
    highest = max(float(np.nanpercentile(speed_of(section), 99.5)) for section in sections.values())
    norm = PowerNorm(0.5, 0.0, highest)

    def draw(ax: "Axes", flowing: Flowing) -> None:
        draw_means(ax, sections[id(flowing)], norm)

    return _instants(rows, draw, norm, "speed [m/s]")


def pressure_maps(pressed: Sequence[tuple[Flowing, Fields]]) -> "Figure":
    """Map a third of the trace of the contact stress, a column a point, for the first four points."""
    maps = [_mirrored(flowing, stress, contact_pressure(stress), pattern_of(stress).bed) for flowing, stress in pressed]
    return _points([flowing for flowing, _ in pressed], [("contact pressure [Pa]", maps)])


def order_maps(patterns: Sequence[Flowing]) -> "Figure":
    """Map O_zz of rods and, below, the order S (largest eigenvalue of the orientation tensor).

    A column a point, for the first four points.
    """

    def maps(of: Callable[[Fields], np.ndarray]) -> list[Map]:
        return [_mirrored(flowing, flowing.fields, of(flowing.fields), flowing.pattern.bed) for flowing in patterns]

    upright = maps(lambda fields: fields.orientation[2, 2])
    return _points(patterns, [("$O_{zz}$", upright), ("order $S$", maps(lambda fields: fields.nematic_order))])


def _points(patterns: Sequence[Flowing], rows: Sequence[tuple[str, Sequence[Map]]]) -> "Figure":
    """Map means over the window: a column a point, for the first four points; a row a quantity, with its own scale."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    patterns = patterns[:_COLUMNS]
    top = top_of(patterns)
    with house():
        height = 8 + len(rows) * row_height(patterns, top)
        figure = Figure(figsize=(PAGE * min(1, (len(patterns) + 0.5) / _COLUMNS), height * MILLIMETRE))
        axes = figure.subplots(len(rows), len(patterns), squeeze=False)
        for line, (text, maps) in zip(axes, rows, strict=True):
            norm = Normalize(*_range(maps[:_COLUMNS]))
            for ax, flowing, values in zip(line, patterns, maps, strict=False):
                ax.set_title(turning_at(flowing.result))
                _mesh(ax, values, norm)
                draw_walls(ax, flowing, top)
            figure.colorbar(ScalarMappable(norm, "viridis"), ax=line, shrink=0.9).set_label(text)
    return figure


def _instants(rows: Sequence[Sequence[Flowing]], draw: Callable[["Axes", Flowing], None], norm, text: str) -> "Figure":
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

    patterns = [flowing for row in rows for flowing in row]
    top, columns = top_of(patterns), max(map(len, rows))
    with house():
        height = 8 + len(rows) * row_height(patterns, top)
        figure = Figure(figsize=(PAGE * (columns + 0.4) / _COLUMNS, height * MILLIMETRE))
        axes = figure.subplots(len(rows), columns, squeeze=False)
        for ax in axes.flat:
            ax.set_axis_off()
        for line, row in zip(axes, rows, strict=True):
            for ax, flowing in zip(line, row, strict=False):
                draw(ax, flowing)
                draw_walls(ax, flowing, top)
                begin, end = flowing.window
                ax.set_title(f"{turning_at(flowing.result)}, t = {begin:.3g} to {end:.3g} s", fontsize=6)
        bar = figure.colorbar(ScalarMappable(norm, "viridis"), ax=axes, shrink=0.6, aspect=40)
        bar.set_label(text)
    return figure


def _mirrored(pattern: Flowing, fields: Fields, values: np.ndarray, bed: np.ndarray) -> Map:
    """Values of the bed on both sides of the axis, without the places within the width of the coarse-graining function:
    the mean over the azimuth has few grains there."""
    assert isinstance(fields.grid, Ring)
    x, z = across(fields.grid)
    r, _ = fields.grid.points
    inside = bed & (r >= omega_of(pattern.result.point.scene))[:, None]
    return even(x) * 1e3, even(z) * 1e3, both(np.where(inside, values, np.nan))


def _range(maps) -> tuple[float, float]:
    finite = np.concatenate([values[np.isfinite(values)] for _, _, values in maps])
    low, high = np.quantile(finite, [0.005, 0.995])
    return float(low), float(high)


def _mesh(ax: "Axes", values: Map, norm) -> None:
    ax.pcolormesh(*values, cmap="viridis", norm=norm, shading="nearest", rasterized=True)
