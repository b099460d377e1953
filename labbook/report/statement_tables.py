"""Tables of what a paper says in words: every statement at every place, and one row a statement."""

import math
from collections.abc import Sequence

from labbook.report.tables import Table
from labbook.results import display
from labbook.results.statements import Judged, at_all, by_statement
from labbook.study import Statement


def statement_table(judged: Sequence[Judged]) -> Table:
    """Every statement with ours, its interval, what it asks, and the verdict; those that do not hold are marked."""
    rows, marked, reasons = [], set(), []
    for place, one in enumerate(judged):
        stated, (scale, _) = one.statement, _shown(one.statement)
        asked = _asked(stated)
        if one.ours is None:
            rows.append((stated.says, one.label, asked, "–", "–", one.verdict))
            reasons.append(f"{stated.says} ({one.label}): {one.why}." if one.label else f"{stated.says}: {one.why}.")
            continue
        error = None if math.isnan(one.error) else one.error
        interval = " to ".join(display.number(end, error, scale) for end in (one.low, one.high))
        rows.append(
            (stated.says, one.label, asked, display.with_error(one.ours, one.error, scale), interval, one.verdict)
        )
        if one.verdict == "does not hold":
            marked.add(place)
    note = (
        "A statement holds if our interval lies within its range, does not hold if it lies outside (bold), and is "
        "undecided otherwise or where nothing was measured. Intervals are 95 % unless stated otherwise."
    )
    made = dict.fromkeys(one.how for one in judged if one.how)
    headings = ("statement", "at", "stated", "ours", "interval", "verdict")
    return Table(headings, tuple(rows), frozenset({0, 1, 5}), frozenset(marked), (note, *made, *dict.fromkeys(reasons)))


def statement_digest(judged: Sequence[Judged]) -> Table | None:
    """One row a statement, with the smallest and the largest of ours; None where none speaks of several places."""
    groups = by_statement(judged)
    if len(groups) == len(judged):
        return None
    rows, marked = [], set()
    for place, (stated, group) in enumerate(groups):
        verdict = at_all(group)
        there = sum(one.verdict == verdict for one in group)
        found = sorted((one for one in group if one.ours is not None), key=lambda one: one.ours or 0.0)
        ours = [_number(one) for one in (*found[:1], *found[-1:])]
        where = "" if len(group) == 1 else f" at all {there}" if there == len(group) else f" at {there} of {len(group)}"
        rows.append((stated.says, _asked(stated), " to ".join(dict.fromkeys(ours)) or "–", verdict + where))
        if verdict == "does not hold":
            marked.add(place)
    note = "A statement holds if it holds at all of its points, and does not hold (bold) if it fails at one."
    return Table(("statement", "stated", "ours", "verdict"), tuple(rows), frozenset({0, 3}), frozenset(marked), (note,))


def _number(one: Judged) -> str:
    assert one.ours is not None
    return display.number(one.ours, None if math.isnan(one.error) else one.error, _shown(one.statement)[0])


def _asked(stated: Statement) -> str:
    scale, unit = _shown(stated)
    low, high = (display.number(end, None, scale) for end in (stated.low, stated.high))
    if math.isinf(stated.low):
        return f"at most {high}{unit}"
    return f"at least {low}{unit}" if math.isinf(stated.high) else f"{low} to {high}{unit}"


def _shown(stated: Statement) -> tuple[float, str]:
    """Factor from SI to the unit that is shown, and that unit after a space; ratios have none."""
    shown = display.quantity(stated.quantity, stated.unit)
    return shown.scale, f" {shown.unit}" if shown.unit else ""
