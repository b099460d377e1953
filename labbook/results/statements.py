"""What a paper says in words, held against our numbers: it holds, it does not, or ours do not decide."""

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
    """A statement and ours, in SI. `ours` is None where we have none; `why` then says so."""

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
    """Those that the number rests on."""
    how: str = ""
    """How number and interval were made, in a sentence, where they are not pooled means with 95 % intervals."""

    @property
    def verdict(self) -> Verdict:
        """`holds` if our interval lies within what is stated, `does not hold` if outside, else `undecided`."""
        if self.ours is None or math.isinf(self.high - self.low):
            return "undecided"
        stated = self.statement
        if stated.low <= self.low and self.high <= stated.high:
            return "holds"
        return "does not hold" if self.high < stated.low or self.low > stated.high else "undecided"


LACKING = "runs are missing, and runs that finish first are biased to fast flow"
"""Why a statement about points that lack runs is undecided."""
JudgedOwn = Callable[[Statement], Sequence[Judged] | None]
"""What papers judge of a statement themselves; None if its quantity is not theirs."""


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
    return tuple(one for statement in reference.statements for one in _judge(statement, points, series, own, judged))


def summed_up(judged: Sequence[Judged], source: str) -> str:
    """How many of the statements hold, in a sentence.

    One that speaks of several points counts once: it holds if it does at all of them, and does not if it fails at one.
    """
    found = [at_all(group) for _, group in by_statement(judged)]
    holds, fails, open_ones = (found.count(verdict) for verdict in get_args(Verdict))
    statements = "statement" if len(found) == 1 else "statements"
    return (
        f"Of {len(found)} {statements} of {source}, {holds} hold{'s' if holds == 1 else ''}, "
        f"{fails} do{'es' if fails == 1 else ''} not, and {open_ones} {'is' if open_ones == 1 else 'are'} undecided."
    )


def by_statement(judged: Sequence[Judged]) -> list[tuple[Statement, list[Judged]]]:
    """What was judged, statement by statement, in their order."""
    return [(statement, list(group)) for statement, group in groupby(judged, lambda one: one.statement)]


def at_all(places: Iterable[Judged]) -> Verdict:
    """The verdict on a statement that speaks of several places."""
    found = {one.verdict for one in places}
    if "does not hold" in found:
        return "does not hold"
    return "undecided" if "undecided" in found else "holds"


def _judge(
    statement: Statement, points: Sequence[PointResult], series: Sequence[Series], own: Own, judged: JudgedOwn
) -> Iterator[Judged]:
    found = judged(statement)
    if found is None:
        every = entry_of(statement.quantity, statement.at, points, series, own)
        fitted = of_fit(statement.quantity)  # of which a note tells which points lack runs
        found = [
            Judged(statement, one.label, None, why=LACKING, points=one.points)
            if not fitted and any(point.partial for point in one.points)
            else Judged(statement, one.label, one.ours, one.error, one.low, one.high, one.why, points=one.points)
            for one in every
        ]
    yield from found or [Judged(statement, display.label(statement.at), None, why="no finished point matches")]
