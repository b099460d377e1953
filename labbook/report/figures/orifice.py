"""W^{2/3} (of a hole W^{2/5}) against D with fits, bands and residuals: a straight line where Beverloo's law holds."""

import math
from collections.abc import Hashable, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from labbook.fit import FitResult
from labbook.fit.beverloo import Beverloo
from labbook.report.figures.arrangement import arranged
from labbook.report.style import (
    COLOURS,
    COLUMN,
    DASHES,
    FAINT,
    INK,
    MARKERS,
    MILLIMETRE,
    PAGE,
    band,
    crosses,
    from_zero,
    house,
    legend_columns,
    legend_point,
    mathtext,
    point,
    verbatim,
)
from labbook.results import display
from labbook.results.points import ORIFICE, PointResult
from labbook.results.reference import NORMAL, Comparison, belongs, of_reference
from labbook.results.series import Series

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_POWERS = {"slot": (2 / 3, "2/3"), "hole": (2 / 5, "2/5")}
_BEYOND = {"linestyle": (0, (2, 2)), "linewidth": 0.7}
_FITS = {"beverloo": 1, "janda": 2}  # place in the palette; others follow
_ACROSS = 3  # panels side by side


def flow_against_orifice(series: Series, comparisons: Sequence[Comparison] = (), source: str = "") -> "Figure":
    """One series: the points with 95 % intervals, every fit with its 95 % bands over the fitted points, dashed beyond
    them, and below it the residuals in percent, if anything was fitted: with the standard errors that the test uses
    (thick) and their own 95 % intervals (thin).

    Points outside a law's range or with a remark are hollow. Crosses at the foot are outlets without a flow rate.
    Diamonds are flow rates of the reference, with 95 % intervals where it states errors. A bar on the axis is k d of
    Beverloo's law, where its line meets zero, with the 95 % interval.
    """
    from matplotlib.figure import Figure

    power, power_text = _POWERS[series.outlet]
    with house():
        heights = (2.6, 1) if series.fits else (2.6,)
        figure = Figure(figsize=(COLUMN, 100 * MILLIMETRE * sum(heights) / 3.6))
        axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
        main, below = axes[0], axes[-1]
        zeros = [zero for fit in series.fits.values() if (zero := zero_of(fit)) is not None]
        first = min([0.92 * min(series.orifices), *zeros])
        orifices = np.linspace(first, 1.04 * max(series.orifices), 200)
        for index, (law, fit) in enumerate(series.fits.items()):
            style = {"color": COLOURS[_FITS.get(law, 3 + index)], "linestyle": DASHES[index]}
            _law(main, fit, orifices, power, label=display.law(law), **style)
            _residuals(below, series, law, style["color"], index)
        _points(main, series.points, series.flagged, power, color=INK, marker="o", label="labbook", words=True)
        theirs = _flow_rates(series, comparisons)
        _reference(main, theirs, source, power)
        if series.fits:
            _their_residuals(below, theirs, next(iter(series.fits.values())))
        _their_law(main, series, comparisons, source, power, orifices)
        below.set_xlabel("orifice, $D$ [mm]")
        if series.fits:
            below.axhline(0, color=FAINT, linewidth=0.6, zorder=0)
            below.set_ylabel("(W − fit) / fit [%]")
        main.set_ylabel(_heading(power_text))
        from_zero(main)
        _bands(main, series, power)
        for index, (law, fit) in enumerate(series.fits.items()):
            _zero(main, fit, COLOURS[_FITS.get(law, 3 + index)])
        if series.label:
            main.set_title(series.label)
        labels = main.get_legend_handles_labels()[1]
        figure.legend(loc="outside upper center", ncols=legend_columns(labels, COLUMN))
        figure.align_ylabels()
    return figure


def overview(series: Sequence[Series]) -> "Figure":
    """All series of a study, each with its first fit; points at one orifice stand side by side. Many series are parted
    into panels (`arranged`)."""
    from matplotlib.figure import Figure

    power, power_text = _POWERS[series[0].outlet]
    arrangement = arranged([each_series.at for each_series in series], [each_series.label for each_series in series])
    panels = arrangement.panels
    across = 2 if len(panels) == 4 else min(_ACROSS, len(panels))
    down = math.ceil(len(panels) / across)
    width = PAGE if across > 1 else PAGE * 0.75 if arrangement.bar else COLUMN
    with house():
        height = (78 if across == 1 else 62) * down + 5 * arrangement.rows(width)
        figure = Figure(figsize=(width, height * MILLIMETRE))
        axes = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False)
        for ax in axes.flat[len(panels) :]:
            ax.remove()
        step = _apart(series, arrangement.together)
        for ax, (title, members) in zip(axes.flat, panels.items(), strict=False):
            for index in members:
                member, style = series[index], arrangement.looks[index]
                if member.fits:
                    fit = next(iter(member.fits.values()))
                    orifices = np.linspace(min(member.orifices), max(member.orifices), 200)
                    _law(ax, fit, orifices, power, color=style["color"], linestyle=style["linestyle"])
                shift = step * (arrangement.ranks[index] - (arrangement.together - 1) / 2)
                shape = {"color": style["color"], "marker": style["marker"], "label": member.label}
                _points(ax, member.points, member.flagged, power, shift=shift, **shape)
            ax.set_title(mathtext(verbatim(title)))
            ax.set_xlabel("orifice, $D$ [mm]")
            ax.xaxis.set_tick_params(labelbottom=True)
            if ax.get_subplotspec().is_first_col():
                ax.set_ylabel(_heading(power_text))
        from_zero(axes[0, 0])
        arrangement.explain(figure, linestyle="none")
    return figure


def side_by_side(series: Sequence[Series]) -> bool:
    """True if two series have a point at the same orifice."""
    orifices = [D for each_series in series for D in set(each_series.orifices)]
    return len(set(orifices)) < len(orifices)


def _apart(series: Sequence[Series], together: int) -> float:
    """Distance [mm] of points of neighbouring series at one orifice; all `together` of a panel take a third of the
    distance to the next orifice at most."""
    orifices = sorted({D * 1e3 for each_series in series for D in each_series.orifices})
    if not side_by_side(series) or len(orifices) < 2:
        return 0.0
    nearest = float(np.diff(orifices).min())
    return min(0.012 * (orifices[-1] - orifices[0]), nearest / 3 / together)


def _bands(ax: "Axes", series: Series, power: float) -> None:
    """95 % bands of each law and of one more point, from the smallest to the largest fitted orifice, within the frame
    that points and curves have set: the band of a law which these orifices do not determine has no bounds."""
    frame = ax.get_ylim()
    for index, (law, fit) in enumerate(series.fits.items()):
        D = np.linspace(fit.D.min(), fit.D.max(), 200)
        _, *of_law = fit.band(D)
        _, *of_point = fit.band(D, new_point=True)
        law_ends, point_ends = (
            [np.minimum(_scaled(end, power), 2 * frame[1]) for end in ends] for ends in (of_law, of_point)
        )
        band(ax, D * 1e3, law_ends, point_ends, COLOURS[_FITS.get(law, 3 + index)])
        if index == 0:
            _name_bands(ax, float(D[-1]) * 1e3, float(law_ends[1][-1]), float(point_ends[1][-1]), frame)
    ax.set_ylim(frame)


def _name_bands(ax: "Axes", end: float, law: float, one_more: float, frame: tuple[float, float]) -> None:
    """The names of both bands at the right of the panel, with lines to their upper edges at the last orifice, or to the
    top of the frame where they leave it."""
    apart = 0.1 * (frame[1] - frame[0])
    law, one_more = min(law, frame[1]), min(one_more, frame[1])
    for edge, level, name in ((law, min(law, one_more - apart), "law"), (one_more, one_more, "one more\npoint")):
        beside = {"textcoords": ("axes fraction", "data"), "va": "center", "size": 5.5, "color": FAINT}
        line = {"arrowstyle": "-", "color": FAINT, "linewidth": 0.5, "shrinkA": 0, "shrinkB": 0}
        ax.annotate(name, (end, edge), (1.02, level), arrowprops=line, annotation_clip=False, **beside)


def zero_of(fit: FitResult) -> float | None:
    """k d [m] of Beverloo's law, where its line meets zero; None of other laws, and unless it is below all orifices."""
    if not isinstance(fit.law, Beverloo) or "k" not in fit.parameters:
        return None
    zero = fit.parameters["k"].value * fit.context.d
    return zero if 0 < zero < fit.D.min() else None


def _zero(ax: "Axes", fit: FitResult, color: str) -> None:
    """A mark on the axis at k d with its 95 % interval."""
    if (zero := zero_of(fit)) is None:
        return
    k, first = fit.parameters["k"], float(fit.D.min())
    low, high = (min(max(end * fit.context.d, 0.0), first) * 1e3 for end in (k.low, k.high))
    bar = {"color": color, "solid_capstyle": "butt", "clip_on": False, "zorder": 3, "scalex": False}
    ax.plot([max(low, ax.get_xlim()[0]), high], [0, 0], linewidth=2.6, alpha=0.6, **bar)
    mark = {"marker": "|", "markersize": 8, "markeredgewidth": 1.1, "linestyle": "none"}
    ax.plot(zero * 1e3, 0, label=f"$k\\,d$ = {zero * 1e3:.3g} mm", **mark, **bar)


def _law(ax: "Axes", fit: FitResult, D: np.ndarray, power: float, *, label: str | None = None, **style: Any) -> None:
    """A law at orifices D [m]: solid or in its own dashes over the fitted points, finely dashed beyond them, down to
    where it lets nothing pass."""
    D = np.unique(np.concatenate([D, [fit.D.min(), fit.D.max()]]))
    value = _scaled(fit.band(D)[0], power)
    value[:-1][value[1:] < 1e-3 * value.max()] = math.nan  # below its zero a law runs along the axis
    among = (fit.D.min() <= D) & (fit.D.max() >= D)
    ax.plot(D[among] * 1e3, value[among], label=label, zorder=2, **style)
    for beyond in (fit.D.min() >= D, fit.D.max() <= D):
        ax.plot(D[beyond] * 1e3, value[beyond], zorder=2, **{**style, **_BEYOND})


def _scaled(flow_rate: np.ndarray, power: float) -> np.ndarray:
    """(g/s)^power of a flow rate in kg/s; a band that reaches below zero ends there."""
    return np.maximum(np.asarray(flow_rate) * 1e3, 0) ** power


def _heading(power: str) -> str:
    return f"$W^{{{power}}}$ [(g/s)$^{{{power}}}$]"


def _flow_rates(series: Series, comparisons: Sequence[Comparison]) -> list[Comparison]:
    """Flow rates of the reference at the points of a series, and measured ones between them."""
    ours = [result.at for result in series.points]
    theirs = [c for c in comparisons if c.quantity == "flow_rate" and ORIFICE in c.at]
    return [c for c in theirs if c.at in ours or (c.measured and belongs(c.at, series))]


def _reference(ax: "Axes", theirs: Sequence[Comparison], source: str, power: float) -> None:
    """Flow rates of the reference, with 95 % intervals where their errors are known."""
    for marker, says in zip(cycle("Ds^v"), dict.fromkeys(c.says for c in theirs), strict=False):
        some = [c for c in theirs if c.says == says]
        orifices_mm = [float(c.at[ORIFICE]) * 1e3 for c in some]
        rates = np.array([c.reference for c in some])
        values, half = _scaled(rates, power), NORMAL * np.array([c.reference_error or 0.0 for c in some])
        ends = np.abs([_scaled(end, power) - values for end in (rates - half, rates + half)])
        look = {"marker": marker, "markersize": 6, "markerfacecolor": "none", "linestyle": "none", "zorder": 4}
        ax.plot(orifices_mm, values, color=INK, label=verbatim(f"{source}, {says}" if says else source), **look)
        ax.errorbar(orifices_mm, values, ends, color=INK, fmt="none", elinewidth=0.7, zorder=4)


def _their_residuals(ax: "Axes", theirs: Sequence[Comparison], fit: FitResult) -> None:
    """Flow rates of the reference less the fit to ours, where that has points on both sides."""
    inside = [c for c in theirs if fit.D.min() <= float(c.at[ORIFICE]) <= fit.D.max()]
    D = np.array([float(c.at[ORIFICE]) for c in inside])
    if len(D):
        W, half = np.array([(c.reference, NORMAL * (c.reference_error or 0.0)) for c in inside]).T / fit.band(D)[0]
        look = {"marker": "D", "markersize": 4, "markerfacecolor": "none", "linestyle": "none", "elinewidth": 0.7}
        ax.errorbar(1e3 * D, 100 * (W - 1), 100 * half, color=INK, **look)


def _their_law(
    ax: "Axes", series: Series, comparisons: Sequence[Comparison], source: str, power: float, D: np.ndarray
) -> None:
    """Beverloo's law with the reference's C, of the density of the grains, and k, where it has both."""
    for law, fit in series.fits.items():
        published = of_reference(comparisons, law, series)
        if isinstance(fit.law, Beverloo) and published.keys() >= {"C_particle", "k"}:
            free = np.array([math.log(published["C_particle"]), published["k"]])
            W = fit.law.flow(D, free, fit.context)
            label = f"{verbatim(source)}, C = {published['C_particle']:.4g}, k = {published['k']:.4g}"
            ax.plot(D * 1e3, _scaled(W, power), color=INK, linestyle=":", zorder=1, label=label)


def _points(
    ax: "Axes",
    points: Sequence[PointResult],
    flagged: frozenset[Hashable],
    power: float,
    *,
    color: str,
    marker: str,
    label: str,
    shift: float = 0.0,
    words: bool = False,
) -> None:
    """Points with 95 % intervals, `shift` [mm] beside their orifices; crosses where there is no flow rate, with the
    reason in words or without."""
    legend_point(ax, label, color=color, marker=marker)
    for result in points:
        if (pooled := result.flow_rate) is not None:
            low, value, high = _scaled(np.array([pooled.low, pooled.value, pooled.high]), power)
            ends = (low, high) if math.isfinite(pooled.half_width) else (-math.inf, math.inf)
            hollow = result.hollow or result.identity in flagged
            point(ax, result.orifice * 1e3 + shift, value, ends, color=color, hollow=hollow, marker=marker, zorder=3)
    stopped = [result for result in points if result.flow_rate is None]
    marks = [(result.orifice * 1e3 + shift, result.lacking if words else "") for result in stopped]
    crosses(ax, marks, color)


def _residuals(ax: "Axes", series: Series, law: str, color: str, index: int) -> None:
    offset = 0.35 * (index - (len(series.fits) - 1) / 2)  # mm: side by side, not on top of each other
    hollow = {result.orifice for result in series.points if result.hollow or result.identity in series.flagged}
    for residual in series.residuals(law):
        x, value, half, error = (
            residual.orifice * 1e3 + offset,
            100 * residual.value,
            100 * residual.half_width,
            100 * residual.error,
        )
        look = {
            "color": color,
            "marker": MARKERS[index],
            "markersize": 3,
            "hollow": residual.orifice in hollow,
            "elinewidth": 0.7,
        }
        ax.plot([x, x], [value - error, value + error], color=color, linewidth=2.6, alpha=0.6, solid_capstyle="butt")
        point(ax, x, value, (value - half, value + half), **look)
