"""Statements of a paper compared with our numbers: they hold, do not hold, or are undecided."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Literal, get_args

from labbook.results import display
from labbook.results.points import PointResult
from labbook.results.reference import Own, entry_of
from labbook.results.series import Series
from labbook.study import Reference, Statement
from labbook.study.paper import of_fit

Verdict = Literal["holds", "does not hold", "undecided"]


@dataclass(frozen=True)
class Judged:
    """A statement of the reference and our number.

    Args:
        statement: The statement.
        label: Points or series that the number is of.
        ours: Our number [SI]; None if there is none.
        error: Its standard error [SI].
        low: Lower end of its interval [SI].
        high: Upper end of its interval [SI].
        why: Reason that there is no number.
    """

    statement: Statement
    label: str
    ours: float | None
    error: float = math.nan
    low: float = -math.inf
    high: float = math.inf
    why: str = ""
    pairs: int = 0
    """Seeds that the number rests on, where it is made of pairs."""
    points: tuple[PointResult, ...] = ()
    """Points that the number rests on."""
    how: str = ""
    """Method of number and interval, in a sentence, if they are not pooled means with 95 % intervals."""

    @property
    def verdict(self) -> Verdict:
        """`holds` if our interval lies within what is stated, `does not hold` if outside, else `undecided`."""
        if self.ours is None or math.isinf(self.high - self.low):
            return "undecided"
        statement = self.statement
        if statement.low <= self.low and self.high <= statement.high:
            return "holds"
        return "does not hold" if self.high < statement.low or self.low > statement.high else "undecided"


LACKING = "runs are missing, and runs that finish first are biased to fast flow"
"""Reason that a statement about points that lack runs is undecided."""
JudgedOwn = Callable[[Statement], Sequence[Judged] | None]
"""Function of a statement: judgements by the analysis of a paper; None if no paper has the quantity."""


def judge(
    reference: Reference | None,
    points: Sequence[PointResult],
    series: Sequence[Series],
    own: Own = lambda *_: None,
    judged: JudgedOwn = lambda _: None,
) -> tuple[Judged, ...]:
    """Every statement of the reference, for each series or point that it speaks of, or as papers judge it."""
    if reference is None:
        return ()
    return tuple(
        judged_statement
        for statement in reference.statements
        for judged_statement in _judge(statement, points, series, own, judged)
    )


def summed_up(judged: Sequence[Judged], source: str) -> str:
    """Count the statements that hold, in a sentence.

    A statement about several points counts once: it holds if it holds at all of them, and does not if it fails at one.
    """
    verdicts = [at_all(group) for _, group in by_statement(judged)]
    holds, fails, open_ones = (verdicts.count(verdict) for verdict in get_args(Verdict))
    statements = "statement" if len(verdicts) == 1 else "statements"
    return (
        f"Of {len(verdicts)} {statements} of {source}, {holds} hold{'s' if holds == 1 else ''}, "
        f"{fails} do{'es' if fails == 1 else ''} not, and {open_ones} {'is' if open_ones == 1 else 'are'} undecided."
    )


def by_statement(judged: Sequence[Judged]) -> list[tuple[Statement, list[Judged]]]:
    """Group judgements by statement, in the order of the statements."""
    return [(statement, list(group)) for statement, group in groupby(judged, lambda result: result.statement)]


def at_all(judged: Iterable[Judged]) -> Verdict:
    """The verdict on a statement that speaks of several places."""
    verdicts = {entry.verdict for entry in judged}
    if "does not hold" in verdicts:
        return "does not hold"
    return "undecided" if "undecided" in verdicts else "holds"


def _judge(
    statement: Statement, points: Sequence[PointResult], series: Sequence[Series], own: Own, judged: JudgedOwn
) -> Iterator[Judged]:
    judgements = judged(statement)
    if judgements is None:
        every = entry_of(statement.quantity, statement.at, points, series, own)
        fitted = of_fit(statement.quantity)  # of which a note tells which points lack runs
        judgements = [
            Judged(statement, comparison.label, None, why=LACKING, points=comparison.points)
            if not fitted and any(point.partial for point in comparison.points)
            else Judged(
                statement,
                comparison.label,
                comparison.ours,
                comparison.error,
                comparison.low,
                comparison.high,
                comparison.why,
                points=comparison.points,
            )
            for comparison in every
        ]
    yield from judgements or [Judged(statement, display.label(statement.at), None, why="no finished point matches")]
