"""The figure of a comparison: how positions drift apart, and how far measured means lie from each other."""

from typing import TYPE_CHECKING

from labbook.compare.divergence import AGREE
from labbook.compare.verdict import Contrast, Verdict
from labbook.report.style import COLOURS, FAINT, INK, MILLIMETRE, PAGE, house, look
from labbook.results import display

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SHOWN = 6
"""Most points whose drifting apart is drawn: the first ones."""
_ROW = 4.5 * MILLIMETRE


def figure(verdict: Verdict) -> "Figure":
    """Left: differences of positions from one packing. Right: differences of means with intervals and the margin."""
    from matplotlib.figure import Figure

    rows = sum(len(point.contrasts) for point in verdict.points)
    first, second = (entrant.called for entrant in verdict.entrants)
    with house():
        drawn = Figure(figsize=(PAGE, max(62 * MILLIMETRE, 22 * MILLIMETRE + rows * _ROW)))
        left, right = drawn.subplots(1, 2, width_ratios=(1, 1.15))
        _apart(left, verdict)
        _means(right, verdict, f"{second} less {first} [% of {first}]")
    return drawn


def _apart(ax: "Axes", verdict: Verdict) -> None:
    found = [(point.label, point.divergence) for point in verdict.points if point.divergence]
    for place, (label, one) in enumerate(found[:_SHOWN]):
        colour = look(place)["color"]
        for values, dash in ((one.largest, "-"), (one.median, ":")):
            known = [(t, value) for t, value in zip(one.time, values, strict=True) if value > 0]
            if known:
                ax.plot(*zip(*known, strict=True), dash, color=colour)
        ax.plot([], [], color=colour, label=label or "largest")
    ax.plot([], [], ":", color=INK, label="median over grains")
    ax.axhline(AGREE, color=FAINT, linewidth=0.6)
    ax.annotate("agree", (0.99, AGREE), (0, -2), xycoords=("axes fraction", "data"), textcoords="offset points",
                ha="right", va="top", color=FAINT, fontsize=6)  # fmt: skip
    ax.set_yscale("log")
    ax.set_xlabel("time since the opening, $t$ [s]")
    ax.set_ylabel("difference of positions [d]")
    ax.legend(loc="lower right")


def _means(ax: "Axes", verdict: Verdict, axis: str) -> None:
    percent = 100 * verdict.margin
    ax.axvspan(-percent, percent, color=FAINT, alpha=0.18, linewidth=0)
    ax.axvline(0, color=FAINT, linewidth=0.6)
    labels: list[str] = []
    for point in verdict.points:
        for one in point.contrasts:
            _mean(ax, len(labels), one)
            labels.append(f"{display.quantity(one.quantity).name}, {point.label}" if point.label else one.quantity)
    ax.set_yticks(range(len(labels)), labels)
    ax.set_ylim(len(labels) - 0.5, -0.5)
    ax.set_xlabel(axis)
    ax.set_title(f"90 % intervals; grey: the margin, ±{percent:.3g} %")


def _mean(ax: "Axes", row: int, one: Contrast) -> None:
    if one.difference is None or one.low is None or one.high is None:
        return
    colour = {"equivalent": COLOURS[2], "different": COLOURS[1]}.get(one.finding, COLOURS[4])
    reach = [[100 * (one.difference - one.low)], [100 * (one.high - one.difference)]]
    ax.errorbar([100 * one.difference], [row], xerr=reach, fmt="o" if one.paired else "s", color=colour)
