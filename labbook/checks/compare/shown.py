"""A verdict as sentences, tables and a figure."""

from statistics import fmean
from typing import TYPE_CHECKING

from labbook.checks.compare.lockstep import AGREE
from labbook.checks.compare.verdict import Contrast, PointVerdict, Verdict
from labbook.report.style import COLOURS, FAINT, INK, MILLIMETRE, PAGE, house, look
from labbook.report.tables import Table
from labbook.results import display
from labbook.scene.quantities import percent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DASH = "–"
_MAX_CURVES = 6
"""Largest number of points whose divergence is plotted: the first points of the study."""
_ROW = 4.5 * MILLIMETRE


def summary(verdict: Verdict) -> list[str]:
    """State the outcome in a few sentences."""
    tests = [test for _, test in _tests(verdict)]
    equivalent, different = (sum(test.finding == finding for test in tests) for finding in ("equivalent", "different"))
    margin, n = percent(verdict.margin), len(tests)
    words = {
        "equivalent": f"equivalent within {margin} in all {n} tests",
        "different": f"DIFFERENT by more than {margin} in {different} of {n} tests",
        "undecided": (
            f"not decided: equivalence within {margin} is shown in {equivalent} of {n} tests, a difference in none"
        ),
    }[verdict.finding]
    first, second = (f"{entrant.called} {entrant.cache_version} ({entrant.device})" for entrant in verdict.entrants)
    lines = [f"{second} against {first}: {words}."]
    weak = [test.replicates_needed for test in tests if test.finding == "undecided" and test.power is not None]
    if weak:
        need = "more than 1000" if None in weak else max(number or 0 for number in weak)
        lines.append(f"With this scatter, {need} replicates would decide with 90 % power, if there is no difference.")
    return lines


def contrast_table(verdict: Verdict) -> Table:
    """Tabulate every point and quantity: both means, their difference with interval, power, and the finding."""
    first, second = (entrant.called for entrant in verdict.entrants)
    rows, marked = [], set()
    notes = [
        f"Two one-sided tests at {percent(verdict.alpha)} with a margin of ±{percent(verdict.margin)} of {first}’s "
        "mean: equivalent if the interval lies within the margin. Power: probability of that without a difference."
    ]
    for point, contrast in _tests(verdict):
        column = display.quantity(contrast.quantity)
        samples = contrast.first, contrast.second
        n = "/".join(dict.fromkeys(str(len(values)) for values in samples))
        means = (f"{fmean(values) * column.scale:.5g}" if values else _DASH for values in samples)
        interval = _DASH if contrast.low is None else f"{_percent(contrast.low)} to {_percent(contrast.high)}"
        power = _DASH if contrast.power is None else percent(contrast.power, ".0f")
        test = _percent(contrast.difference), interval, _formatted(contrast.p, ".2g"), power
        if contrast.finding == "different":
            marked.add(len(rows))
        packings = "shared" if contrast.paired else "own"
        rows.append((point.label or _DASH, column.heading, packings, n, *means, *test, contrast.finding))
        if contrast.note:
            notes.append(f"{column.heading} at {point.label or 'the point'}: {contrast.note}.")
    headings = ("point", "quantity", "packings", "n", first, second, "difference", "90 % interval", "p", "power")
    return Table((*headings, "finding"), tuple(rows), frozenset({0, 1, 2, 10}), frozenset(marked), tuple(notes))


def divergence_table(verdict: Verdict) -> Table:
    """Tabulate for every point the time for which both backends agree on positions."""
    rows = []
    notes = [f"From the same packing; the motions agree as long as no grain is more than {AGREE:g} d apart."]
    for point in verdict.points:
        cells = (_DASH,) * 4
        if curve := point.divergence:
            until = f"{'' if max(curve.largest) > AGREE else '> '}{curve.agree_until:.4g}"
            cells = until, f"{curve.time[-1]:.4g}", f"{curve.median[-1]:.2g}", f"{curve.largest[-1]:.2g}"
            if curve.note:
                notes.append(f"At {point.label or 'the point'}: {curve.note}.")
        rows.append((point.label or _DASH, *cells))
    headings = ("point", "agree until [s]", "looked until [s]", "median then [d]", "largest then [d]")
    return Table(headings, tuple(rows), frozenset({0}), notes=tuple(notes))


def cost_table(verdict: Verdict) -> Table:
    """Tabulate the cost of each backend's runs."""
    rows = []
    for index, cost in enumerate(verdict.costs):
        speeds = [rate for point in verdict.points if point.divergence and (rate := point.divergence.rates[index])]
        alone = fmean(speeds) if speeds else None
        rates = [_DASH if rate is None else f"{rate / 1e6:.2f}" for rate in (cost.rate, cost.session_rate, alone)]
        devices, session = ", ".join(cost.devices) or _DASH, _formatted(cost.session_wall, ".4g")
        rows.append((cost.backend, devices, str(cost.runs), f"{cost.wall_time:.4g}", *rates[:2], session, rates[2]))
    headings = ("backend", "runs made on", "runs", "wall time of runs [s]", "per run [M/s]", "session, all runs [M/s]")
    note = (
        "M/s: million grain-steps per second of wall time. A run’s wall time includes that of the other runs in its "
        "ensemble. A session is the last one that made runs, with compiling, filling and saving. One scene alone is "
        "followed frame by frame beside the other backend, without compiling."
    )
    headings = (*headings, "session [s]", "one scene alone [M/s]")
    return Table(headings, tuple(rows), frozenset({0, 1}), notes=(note,))


def _tests(verdict: Verdict) -> list[tuple[PointVerdict, Contrast]]:
    return [(point, contrast) for point in verdict.points for contrast in point.contrasts]


def _formatted(value: float | None, form: str) -> str:
    return _DASH if value is None else format(value, form)


def _percent(fraction: float | None) -> str:
    return _DASH if fraction is None else percent(fraction, "+.2f").replace("-", "−")


def figure(verdict: Verdict) -> "Figure":
    """Plot differences of positions from one packing (left) and differences of means with the margin (right)."""
    from matplotlib.figure import Figure

    rows = len(_tests(verdict))
    with house():
        chart = Figure(figsize=(PAGE, max(62 * MILLIMETRE, 22 * MILLIMETRE + rows * _ROW)))
        left, right = chart.subplots(1, 2, width_ratios=(1, 1.15))
        _apart(left, verdict)
        _means(right, verdict)
    return chart


def _apart(ax: "Axes", verdict: Verdict) -> None:
    curves = [(point.label, point.divergence) for point in verdict.points if point.divergence]
    for index, (label, divergence) in enumerate(curves[:_MAX_CURVES]):
        colour = look(index)["color"]
        for values, dash in ((divergence.largest, "-"), (divergence.median, ":")):
            positive = [(t, value) for t, value in zip(divergence.time, values, strict=True) if value > 0]
            if positive:
                ax.plot(*zip(*positive, strict=True), dash, color=colour)
        ax.plot([], [], color=colour, label=label or "largest")
    ax.plot([], [], ":", color=INK, label="median over grains")
    ax.axhline(AGREE, color=FAINT, linewidth=0.6)
    ax.annotate("agree", (0.99, AGREE), (0, -2), xycoords=("axes fraction", "data"), textcoords="offset points",
                ha="right", va="top", color=FAINT, fontsize=6)  # fmt: skip
    ax.set(yscale="log", xlabel="time since the opening, $t$ [s]", ylabel="difference of positions [d]")
    ax.legend(loc="lower right")


def _means(ax: "Axes", verdict: Verdict) -> None:
    margin, labels = 100 * verdict.margin, []
    first, second = (entrant.called for entrant in verdict.entrants)
    ax.axvspan(-margin, margin, color=FAINT, alpha=0.18, linewidth=0)
    ax.axvline(0, color=FAINT, linewidth=0.6)
    for row, (point, contrast) in enumerate(_tests(verdict)):
        labels.append(
            f"{display.quantity(contrast.quantity).name}, {point.label}" if point.label else contrast.quantity
        )
        if contrast.difference is None or contrast.low is None or contrast.high is None:
            continue
        colour = {"equivalent": COLOURS[2], "different": COLOURS[1]}.get(contrast.finding, COLOURS[4])
        reach = [[100 * (contrast.difference - contrast.low)], [100 * (contrast.high - contrast.difference)]]
        ax.errorbar([100 * contrast.difference], [row], xerr=reach, fmt="o" if contrast.paired else "s", color=colour)
    ax.set_yticks(range(len(labels)), labels)
    ax.set(ylim=(len(labels) - 0.5, -0.5), xlabel=f"{second} less {first} [% of {first}]")
    ax.set_title(f"90 % intervals; grey: the margin, ±{percent(verdict.margin)}")
