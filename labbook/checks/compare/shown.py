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
_SHOWN = 6
"""Most points whose drifting apart is drawn: the first ones."""
_ROW = 4.5 * MILLIMETRE


def summary(verdict: Verdict) -> list[str]:
    """What came of it, in a few sentences."""
    every = [one for _, one in _tests(verdict)]
    shown, apart = (sum(one.finding == found for one in every) for found in ("equivalent", "different"))
    margin, n = percent(verdict.margin), len(every)
    words = {
        "equivalent": f"equivalent within {margin} in all {n} tests",
        "different": f"DIFFERENT by more than {margin} in {apart} of {n} tests",
        "undecided": f"not decided: equivalence within {margin} is shown in {shown} of {n} tests, a difference in none",
    }[verdict.finding]
    first, second = (f"{one.called} {one.cache_version} ({one.device})" for one in verdict.entrants)
    lines = [f"{second} against {first}: {words}."]
    weak = [one.replicates_needed for one in every if one.finding == "undecided" and one.power is not None]
    if weak:
        need = "more than 1000" if None in weak else max(number or 0 for number in weak)
        lines.append(f"With this scatter, {need} replicates would decide with 90 % power, if there is no difference.")
    return lines


def contrast_table(verdict: Verdict) -> Table:
    """Every point and quantity: both means, their difference with interval, power, and the finding."""
    first, second = (entrant.called for entrant in verdict.entrants)
    rows, marked = [], set()
    notes = [
        f"Two one-sided tests at {percent(verdict.alpha)} with a margin of ±{percent(verdict.margin)} of {first}’s "
        "mean: equivalent if the interval lies within the margin. Power: probability of that without a difference."
    ]
    for point, one in _tests(verdict):
        shown = display.quantity(one.quantity)
        samples = one.first, one.second
        n = "/".join(dict.fromkeys(str(len(values)) for values in samples))
        means = (f"{fmean(values) * shown.scale:.5g}" if values else _DASH for values in samples)
        interval = _DASH if one.low is None else f"{_percent(one.low)} to {_percent(one.high)}"
        power = _DASH if one.power is None else percent(one.power, ".0f")
        test = _percent(one.difference), interval, _told(one.p, ".2g"), power
        if one.finding == "different":
            marked.add(len(rows))
        packings = "shared" if one.paired else "own"
        rows.append((point.label or _DASH, shown.heading, packings, n, *means, *test, one.finding))
        if one.note:
            notes.append(f"{shown.heading} at {point.label or 'the point'}: {one.note}.")
    headings = ("point", "quantity", "packings", "n", first, second, "difference", "90 % interval", "p", "power")
    return Table((*headings, "finding"), tuple(rows), frozenset({0, 1, 2, 10}), frozenset(marked), tuple(notes))


def divergence_table(verdict: Verdict) -> Table:
    """Every point: how long both backends agree on where the grains are."""
    rows = []
    notes = [f"From the same packing; the motions agree as long as no grain is more than {AGREE:g} d apart."]
    for point in verdict.points:
        cells = (_DASH,) * 4
        if found := point.divergence:
            until = f"{'' if max(found.largest) > AGREE else '> '}{found.agree_until:.4g}"
            cells = until, f"{found.time[-1]:.4g}", f"{found.median[-1]:.2g}", f"{found.largest[-1]:.2g}"
            if found.note:
                notes.append(f"At {point.label or 'the point'}: {found.note}.")
        rows.append((point.label or _DASH, *cells))
    headings = ("point", "agree until [s]", "looked until [s]", "median then [d]", "largest then [d]")
    return Table(headings, tuple(rows), frozenset({0}), notes=tuple(notes))


def cost_table(verdict: Verdict) -> Table:
    """What each backend's runs took."""
    rows = []
    for which, cost in enumerate(verdict.costs):
        speeds = [rate for one in verdict.points if one.divergence and (rate := one.divergence.rates[which])]
        alone = fmean(speeds) if speeds else None
        rates = [_DASH if rate is None else f"{rate / 1e6:.2f}" for rate in (cost.rate, cost.session_rate, alone)]
        made, session = ", ".join(cost.devices) or _DASH, _told(cost.session_wall, ".4g")
        rows.append((cost.backend, made, str(cost.runs), f"{cost.wall_time:.4g}", *rates[:2], session, rates[2]))
    headings = ("backend", "runs made on", "runs", "wall time of runs [s]", "per run [M/s]", "session, all runs [M/s]")
    note = (
        "M/s: million grain-steps per second of wall time. A run’s wall time includes that of the other runs in its "
        "ensemble. A session is the last one that made runs, with compiling, filling and saving. One scene alone is "
        "followed frame by frame beside the other backend, without compiling."
    )
    headings = (*headings, "session [s]", "one scene alone [M/s]")
    return Table(headings, tuple(rows), frozenset({0, 1}), notes=(note,))


def _tests(verdict: Verdict) -> list[tuple[PointVerdict, Contrast]]:
    return [(point, one) for point in verdict.points for one in point.contrasts]


def _told(value: float | None, form: str) -> str:
    return _DASH if value is None else format(value, form)


def _percent(part: float | None) -> str:
    return _DASH if part is None else percent(part, "+.2f").replace("-", "−")


def figure(verdict: Verdict) -> "Figure":
    """Left: differences of positions from one packing. Right: differences of means with intervals and the margin."""
    from matplotlib.figure import Figure

    rows = len(_tests(verdict))
    with house():
        drawn = Figure(figsize=(PAGE, max(62 * MILLIMETRE, 22 * MILLIMETRE + rows * _ROW)))
        left, right = drawn.subplots(1, 2, width_ratios=(1, 1.15))
        _apart(left, verdict)
        _means(right, verdict)
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
    ax.set(yscale="log", xlabel="time since the opening, $t$ [s]", ylabel="difference of positions [d]")
    ax.legend(loc="lower right")


def _means(ax: "Axes", verdict: Verdict) -> None:
    margin, labels = 100 * verdict.margin, []
    first, second = (entrant.called for entrant in verdict.entrants)
    ax.axvspan(-margin, margin, color=FAINT, alpha=0.18, linewidth=0)
    ax.axvline(0, color=FAINT, linewidth=0.6)
    for row, (point, one) in enumerate(_tests(verdict)):
        labels.append(f"{display.quantity(one.quantity).name}, {point.label}" if point.label else one.quantity)
        if one.difference is None or one.low is None or one.high is None:
            continue
        colour = {"equivalent": COLOURS[2], "different": COLOURS[1]}.get(one.finding, COLOURS[4])
        reach = [[100 * (one.difference - one.low)], [100 * (one.high - one.difference)]]
        ax.errorbar([100 * one.difference], [row], xerr=reach, fmt="o" if one.paired else "s", color=colour)
    ax.set_yticks(range(len(labels)), labels)
    ax.set(ylim=(len(labels) - 0.5, -0.5), xlabel=f"{second} less {first} [% of {first}]")
    ax.set_title(f"90 % intervals; grey: the margin, ±{percent(verdict.margin)}")
