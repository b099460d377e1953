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
    for index, judgement in enumerate(judged):
        statement, (scale, _) = judgement.statement, _scale_and_unit(judgement.statement)
        range_text = _range_text(statement)
        if judgement.ours is None:
            rows.append((statement.says, judgement.label, range_text, "–", "–", judgement.verdict))
            reasons.append(
                f"{statement.says} ({judgement.label}): {judgement.why}."
                if judgement.label
                else f"{statement.says}: {judgement.why}."
            )
            continue
        error = None if math.isnan(judgement.error) else judgement.error
        interval = " to ".join(display.number(end, error, scale) for end in (judgement.low, judgement.high))
        rows.append(
            (
                statement.says,
                judgement.label,
                range_text,
                display.with_error(judgement.ours, judgement.error, scale),
                interval,
                judgement.verdict,
            )
        )
        if judgement.verdict == "does not hold":
            marked.add(index)
    note = (
        "A statement holds if our interval lies within its range, does not hold if it lies outside (bold), and is "
        "undecided otherwise or where nothing was measured. Intervals are 95 % unless stated otherwise."
    )
    methods = dict.fromkeys(one.how for one in judged if one.how)
    headings = ("statement", "at", "stated", "ours", "interval", "verdict")
    return Table(
        headings, tuple(rows), frozenset({0, 1, 5}), frozenset(marked), (note, *methods, *dict.fromkeys(reasons))
    )


def statement_digest(judged: Sequence[Judged]) -> Table | None:
    """One row a statement, with the smallest and the largest of ours; None where none speaks of several places."""
    groups = by_statement(judged)
    if len(groups) == len(judged):
        return None
    rows, marked = [], set()
    for index, (statement, group) in enumerate(groups):
        verdict = at_all(group)
        there = sum(member.verdict == verdict for member in group)
        ordered = sorted((member for member in group if member.ours is not None), key=lambda one: one.ours or 0.0)
        ours = [_number(one) for one in (*ordered[:1], *ordered[-1:])]
        where = "" if len(group) == 1 else f" at all {there}" if there == len(group) else f" at {there} of {len(group)}"
        rows.append((statement.says, _range_text(statement), " to ".join(dict.fromkeys(ours)) or "–", verdict + where))
        if verdict == "does not hold":
            marked.add(index)
    note = "A statement holds if it holds at all of its points, and does not hold (bold) if it fails at one."
    return Table(("statement", "stated", "ours", "verdict"), tuple(rows), frozenset({0, 3}), frozenset(marked), (note,))


def _number(one: Judged) -> str:
    assert one.ours is not None
    return display.number(one.ours, None if math.isnan(one.error) else one.error, _scale_and_unit(one.statement)[0])


def _range_text(statement: Statement) -> str:
    scale, unit = _scale_and_unit(statement)
    low, high = (display.number(end, None, scale) for end in (statement.low, statement.high))
    if math.isinf(statement.low):
        return f"at most {high}{unit}"
    return f"at least {low}{unit}" if math.isinf(statement.high) else f"{low} to {high}{unit}"


def _scale_and_unit(statement: Statement) -> tuple[float, str]:
    """Factor from SI to the unit that is shown, and that unit after a space; ratios have none."""
    notation = display.quantity(statement.quantity, statement.unit)
    return notation.scale, f" {notation.unit}" if notation.unit else ""
