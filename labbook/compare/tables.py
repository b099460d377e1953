"""A verdict as tables and sentences, for the terminal."""

from labbook.compare.divergence import AGREE
from labbook.compare.verdict import Contrast, Verdict
from labbook.report.tables import Table
from labbook.results import display

_DASH = "–"


def summary(verdict: Verdict) -> list[str]:
    """What came of it, in a few sentences."""
    first, second = verdict.entrants
    every = [one for point in verdict.points for one in point.contrasts]
    shown = sum(one.finding == "equivalent" for one in every)
    margin = f"{100 * verdict.margin:.3g} %"
    words = {
        "equivalent": f"equivalent within {margin} in all {len(every)} tests",
        "different": f"DIFFERENT by more than {margin} in "
        f"{sum(one.finding == 'different' for one in every)} of {len(every)} tests",
        "undecided": f"not decided: equivalence within {margin} is shown in {shown} of "
        f"{len(every)} tests, a difference in none",
    }[verdict.finding]
    lines = [
        f"{second.called} {second.cache_version} ({second.device}) against {first.called} {first.cache_version} "
        f"({first.device}): {words}."
    ]
    weak = [one.replicates_needed for one in every if one.finding == "undecided" and one.power is not None]
    if weak:
        most = None if None in weak else max(number or 0 for number in weak)
        need = f"{most} replicates" if most else "more than 1000 replicates"
        lines.append(f"With this scatter, {need} would decide with 90 % power, if there is no difference.")
    return lines


def contrast_table(verdict: Verdict) -> Table:
    """Every point and quantity: both means, their difference with interval, power, and the finding."""
    first, second = (entrant.called for entrant in verdict.entrants)
    rows, marked, notes = [], set(), []
    for point in verdict.points:
        for one in point.contrasts:
            if one.finding == "different":
                marked.add(len(rows))
            rows.append((point.label or _DASH, *_contrast(one)))
            if one.note:
                notes.append(f"{_named(one)} at {point.label or 'the point'}: {one.note}.")
    headings = ("point", "quantity", "packings", "n", first, second, "difference", "90 % interval", "p", "power")
    notes.insert(
        0,
        f"Two one-sided tests at {verdict.alpha:.0%} with a margin of ±{100 * verdict.margin:.3g} % of {first}’s mean: "
        "equivalent if the interval lies within the margin. Power: the chance to show that if there is none.",
    )
    words = frozenset({0, 1, 2, len(headings)})
    return Table((*headings, "finding"), tuple(rows), words, frozenset(marked), tuple(notes))


def _named(one: Contrast) -> str:
    return display.quantity(one.quantity).heading


def _contrast(one: Contrast) -> tuple[str, ...]:
    scale = display.quantity(one.quantity).scale
    how = "shared" if one.paired else "own"
    n = str(len(one.first)) if len(one.first) == len(one.second) else f"{len(one.first)}/{len(one.second)}"
    means = [f"{sum(values) / len(values) * scale:.5g}" if values else _DASH for values in (one.first, one.second)]
    if one.difference is None or one.low is None or one.high is None or one.p is None or one.power is None:
        return (_named(one), how, n, *means, _DASH, _DASH, _DASH, _DASH, one.finding)
    interval = f"{_percent(one.low)} to {_percent(one.high)}"
    return (
        _named(one),
        how,
        n,
        *means,
        _percent(one.difference),
        interval,
        f"{one.p:.2g}",
        f"{one.power:.0%}",
        one.finding,
    )


def _percent(part: float) -> str:
    return f"{100 * part:+.2f} %".replace("-", "−")


def divergence_table(verdict: Verdict) -> Table:
    """Every point: how long both backends agree on where the grains are."""
    rows, notes = [], []
    for point in verdict.points:
        found = point.divergence
        if found is None:
            rows.append((point.label or _DASH, _DASH, _DASH, _DASH, _DASH))
            continue
        until = f"{found.agree_until:.4g}" if max(found.largest) > AGREE else f"> {found.agree_until:.4g}"
        rows.append(
            (
                point.label or _DASH,
                until,
                f"{found.time[-1]:.4g}",
                f"{found.median[-1]:.2g}",
                f"{found.largest[-1]:.2g}",
            )
        )
        if found.note:
            notes.append(f"At {point.label or 'the point'}: {found.note}.")
    notes.insert(0, f"From the same packing; they agree as long as no grain is more than {AGREE:g} d apart.")
    headings = ("point", "agree until [s]", "looked until [s]", "median then [d]", "largest then [d]")
    return Table(headings, tuple(rows), frozenset({0}), notes=tuple(notes))


def cost_table(verdict: Verdict) -> Table:
    """What each backend's runs took."""
    rows = []
    for which, cost in enumerate(verdict.costs):
        alone = [d.rates[which] for point in verdict.points if (d := point.divergence)]
        known = [rate for rate in alone if rate is not None]
        rows.append(
            (
                cost.backend,
                ", ".join(cost.devices) or _DASH,
                str(cost.runs),
                f"{cost.wall_time:.4g}",
                _millions(cost.rate),
                _millions(cost.session_rate),
                _DASH if cost.session_wall is None else f"{cost.session_wall:.4g}",
                _millions(sum(known) / len(known) if known else None),
            )
        )
    headings = (
        "backend",
        "runs made on",
        "runs",
        "their wall time [s]",
        "a run [M/s]",
        "session, all runs [M/s]",
        "session [s]",
        "one scene alone [M/s]",
    )
    notes = (
        "M/s: million grain-steps per second of wall time. A run’s wall time counts that of its neighbours in the same "
        "ensemble; the last session that ran anything has compiling, filling and saving in it; alone: followed frame "
        "by frame beside the other backend, compiling left out.",
    )
    return Table(headings, tuple(rows), frozenset({0, 1}), notes=notes)


def _millions(rate: float | None) -> str:
    return _DASH if rate is None else f"{rate / 1e6:.2f}"
