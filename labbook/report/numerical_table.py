"""Table of points that differ in numerics only."""

from collections.abc import Sequence

from labbook.report.tables import Table
from labbook.results import display
from labbook.results.numerical import Numerical
from labbook.results.points import FLOW_RATE
from labbook.stats.equivalence import replicates_needed


def numerical_table(found: Sequence[Numerical]) -> Table:
    """Every comparison: both means, their difference with its interval, and what the test of equivalence shows."""
    shown = display.quantity(FLOW_RATE)
    rows, notes = [], [_CONVENTIONS]
    for one in found:
        means = [
            "–" if flow is None else display.with_error(flow.value, flow.error, shown.scale)
            for flow in (one.first.flow_rate, one.other.flow_rate)
        ]
        runs = f"{len(one.first.runs)}, {len(one.other.runs)}"
        rows.append((one.label, one.where or "–", runs, *means, *_cells(one)))
        if one.test is not None and one.finding == "undecided":
            need = replicates_needed(one.test, min(len(one.first.runs), len(one.other.runs)))
            many = "more than 1000" if need is None else str(need)
            notes.append(f"{one.label}: {many} replicates of each would decide with a power of 90 %, were W the same.")
    margin = next((one.margin for one in found if one.margin is not None), None)
    if margin is None:
        notes.append("No margin is stated (accuracy.numerics), so that equivalence is not tested.")
    else:
        notes.insert(1, _TEST.format(margin=100 * margin))
    headings = ("changed", "at", "runs", f"first {shown.heading}", f"other {shown.heading}", "difference")
    return Table(
        (*headings, "90 % interval", "p", "power", "finding"),
        tuple(rows),
        frozenset({0, 1, 9}),
        frozenset(k for k, one in enumerate(found) if one.finding == "different"),
        tuple(notes),
    )


def _cells(one: Numerical) -> tuple[str, ...]:
    test = one.test
    if test is None:
        return ("–", "–", "–", "–", one.why)
    low, high = (display.number(end, test.error, 100) for end in (test.low, test.high))
    difference = f"{display.with_error(test.difference, test.error, 100)} %"
    if not one.finding:
        return (difference, f"{low} to {high} %", "–", "–", "–")
    return (difference, f"{low} to {high} %", f"{test.p:.2g}", f"{test.power:.0%}".replace("%", " %"), one.finding)


_CONVENTIONS = (
    "Differences are parts of the mean with the value that is listed first; ± is one standard error, of means that are "
    "independent (Welch)."
)
_TEST = (
    "Two one-sided tests at 5 % with a margin of ±{margin:.3g} %: equivalent if the interval lies within the margin, "
    "different if it lies beyond, undecided otherwise. Power: the chance to show equivalence, were W the same."
)
