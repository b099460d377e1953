"""Flow, and what happens above the orifice, against the rotation of the bottom (Pongo et al. 2022, Figs 2, 3, 8-10)."""

import math
from collections.abc import Sequence
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from labbook.measure.acceleration import AccelerationProfile
from labbook.report.style import COLUMN, FAINT, MILLIMETRE, PAGE, from_zero, house, look
from labbook.results import display
from labbook.results.elongation import CLOSE
from labbook.results.rotation import FLOW, Rotation, aspect_ratio, by_seed, relative_orifice

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
    """Q(f) above and Q(f)/Q(0) below, a column a shape, a line an outlet; dots: seeds."""
    from matplotlib.figure import Figure

    shapes = [(shape, list(group)) for shape, group in groupby(curves, key=lambda one: one.shape)]
    labels = sorted({one.label: one.orifice for one in curves}.items(), key=lambda item: item[1])
    place = {label: index for index, (label, _) in enumerate(labels)}
    with house():
        width = COLUMN if len(shapes) == 1 and len(place) == 1 else PAGE
        figure = Figure(figsize=(width, 104 * MILLIMETRE))
        axes = figure.subplots(2, len(shapes), sharex=True, sharey="row", squeeze=False)
        for column, (shape, group) in enumerate(shapes):
            above, below = axes[:, column]
            above.set_title(shape)
            for curve in group:
                _rates(above, curve, place[curve.label])
                _ratios(below, curve, place[curve.label])
            below.axhline(1, color=FAINT, linewidth=0.6, zorder=0)
            below.set_xlabel(_FREQUENCY if len(shapes) < 3 else "$f$ [Hz]")
        from_zero(axes[0, 0])
        from_zero(axes[1, 0])
        axes[0, 0].set_ylabel("$Q$ [grains/s]")
        axes[1, 0].set_ylabel("$Q(f)/Q(0)$")
        lines = {text: line for ax in axes[1] for line, text in zip(*ax.get_legend_handles_labels(), strict=True)}
        if lines:
            shown = [label for label in place if label in lines]
            figure.legend([lines[label] for label in shown], shown, loc="outside right upper")
        figure.align_ylabels()
    return figure


def _rates(ax: "Axes", curve: Rotation, index: int) -> None:
    style, known = {**look(index), "markersize": 3}, [one for one in curve.points if FLOW in one.pooled]
    f = [curve.frequencies[curve.points.index(one)] for one in known]
    for x, one in zip(f, known, strict=True):
        seeds = list(by_seed(one, FLOW).values())
        ax.plot([x] * len(seeds), seeds, color=style["color"], marker=".", markersize=2.5, alpha=0.4, linestyle="none")
    values = [one.pooled[FLOW].value for one in known]
    errors = [np.nan_to_num(one.pooled[FLOW].error) for one in known]
    ax.errorbar(f, values, yerr=errors, **style)
    _hollow(ax, f, values, [one.partial for one in known], style)


def _ratios(ax: "Axes", curve: Rotation, index: int) -> None:
    rest, style = curve.points[0].partial, {**look(index), "markersize": 3}
    found = [(0.0, 1.0, 0.0, rest)]
    for k in range(1, len(curve.points)):
        ratio = curve.ratio(FLOW, k)
        if ratio is not None:
            half = ratio.half_width if math.isfinite(ratio.half_width) else 0.0
            found.append((float(curve.frequencies[k]), ratio.value, half, rest or curve.points[k].partial))
    f, values, errors, partial = zip(*found, strict=True)
    ax.errorbar(f, values, yerr=errors, label=curve.label or None, **style)
    _hollow(ax, f, values, partial, style)


def _hollow(ax: "Axes", f: Sequence[float], values: Sequence[float], partial: Sequence[bool], style: dict) -> None:
    """Empty the markers of points that lack runs."""
    empty = {**style, "linestyle": "none", "markerfacecolor": "white", "zorder": 4}
    for x, y in (at for at, lacks in zip(zip(f, values, strict=True), partial, strict=True) if lacks):
        ax.plot(x, y, **empty)


def drop_and_rise(curves: Sequence[Rotation]) -> "Figure":
    """Q_min/Q(0) and Q(fastest)/Q_min against L/d; full lines: the same D/d*, dashed: the same D."""
    from matplotlib.figure import Figure

    known = [one for one in curves if one.lowest() is not None]
    with house():
        figure = Figure(figsize=(PAGE, 66 * MILLIMETRE))
        axes = figure.subplots(1, 2)
        for ax, of in zip(axes, ("drop", "rise"), strict=True):
            for index, (text, group, dashed) in enumerate(_lines(known)):
                points = [(aspect_ratio(one.points[0]), ratio) for one in group if (ratio := _extreme(one, of))]
                half = [np.nan_to_num(ratio.half_width, posinf=0.0) for _, ratio in points]
                style = {**look(index), "linestyle": "--" if dashed else "-"}
                ax.errorbar([x for x, _ in points], [r.value for _, r in points], yerr=half, label=text, **style)
            ax.axhline(1, color=FAINT, linewidth=0.6, zorder=0)
            ax.set_xlabel("aspect ratio, $L/d$")
        axes[0].set_ylabel(r"$Q_\mathrm{min}/Q(0)$")
        fastest = known[0].frequencies[-1]
        axes[1].set_ylabel(rf"$Q({fastest:g}\,\mathrm{{Hz}})/Q_\mathrm{{min}}$")
        from_zero(axes[0])
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right upper")
    return figure


def _extreme(curve: Rotation, of: str):
    lowest = curve.lowest()
    assert lowest is not None
    return curve.ratio(FLOW, lowest) if of == "drop" else curve.ratio(FLOW, len(curve.points) - 1, lowest)


def _lines(curves: Sequence[Rotation]) -> list[tuple[str, list[Rotation], bool]]:
    """Curves of equal D, then of nearly equal D/d*, that hold two shapes at least."""
    lines = []
    for orifice in dict.fromkeys(one.orifice for one in curves):
        group = [one for one in curves if one.orifice == orifice]
        lines.append((f"D = {orifice * 1e3:.4g} mm", group, True))
    for first in curves:
        wide = relative_orifice(first.points[0])
        group = [one for one in curves if abs(relative_orifice(one.points[0]) / wide - 1) < CLOSE]
        if group[0] is first and len({one.orifice for one in group}) > 1:
            lines.append((f"D/d* = {wide:.2g}", group, False))
    return [(text, group, dashed) for text, group, dashed in lines if len({one.shape for one in group}) > 1]


def above_orifice(curves: Sequence[Rotation]) -> "Figure":
    """Means above the orifice against f, a panel a quantity, a line a shape and outlet; bars: one standard error."""
    from matplotlib.figure import Figure

    shown = [name for name in _PANELS if any(one.has(name) for one in curves)]
    columns = min(4, len(shown))
    rows = math.ceil(len(shown) / columns)
    with house():
        figure = Figure(figsize=(PAGE, (10 + 46 * rows) * MILLIMETRE))
        axes = figure.subplots(rows, columns, sharex=True, squeeze=False)
        for ax in axes.flat[len(shown) :]:
            ax.set_axis_off()
        for ax, name in zip(axes.flat, shown, strict=False):
            text, scale = _PANELS[name]
            for index, curve in enumerate(curves):
                known = [k for k, one in enumerate(curve.points) if name in one.pooled]
                pooled = [curve.points[k].pooled[name] for k in known]
                errors = [np.nan_to_num(one.error) * abs(scale) for one in pooled]
                label = ", ".join(filter(None, (curve.shape, curve.label)))
                f, values = curve.frequencies[known].tolist(), [one.value * scale for one in pooled]
                style = {**look(index), "markersize": 3}
                if known:
                    ax.errorbar(f, values, yerr=errors, label=label, **style)
                    _hollow(ax, f, values, [curve.points[k].partial for k in known], style)
            ax.set_ylabel(text)
            ax.set_xlabel("$f$ [Hz]")
            ax.tick_params(labelbottom=True)
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=min(4, len(curves)))
    return figure


def acceleration_against_rotation(
    found: Sequence[tuple[Rotation, Sequence[tuple[float, AccelerationProfile]]]], gravity: float
) -> "Figure":
    """a_eff/g against the height that grains start from, in widths of the outlet; a panel a curve, a line a frequency.

    `found`: of each curve, frequencies [Hz] and profiles. Bars: one standard error.
    """
    from matplotlib.figure import Figure

    columns = min(3, len(found))
    rows = math.ceil(len(found) / columns)
    with house():
        width = COLUMN if columns == 1 else PAGE
        figure = Figure(figsize=(width, (8 + 56 * rows) * MILLIMETRE))
        axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for ax in axes.flat[len(found) :]:
            ax.set_axis_off()
        for ax, (curve, profiles) in zip(axes.flat, found, strict=False):
            ax.set_title(", ".join(filter(None, (curve.shape, curve.label))))
            for index, (f, profile) in enumerate(profiles):
                known = np.isfinite(profile.error)
                height = (profile.edges[1:] + profile.edges[:-1])[known] / 2 / curve.orifice
                value, error = -profile.acceleration[known] / gravity, profile.error[known] / gravity
                label = f"f = {display.number(f)} Hz"
                ax.errorbar(height, value, yerr=error, label=label, **{**look(index), "markersize": 3})
            ax.axhline(0, color=FAINT, linewidth=0.6, zorder=0)
            ax.set_xlabel("$z/D$")
            ax.legend(loc="best")
        axes[0, 0].set_ylabel("downward acceleration / g")
    return figure
