"""What a paper says in words, held against our numbers: it holds, it does not, or ours do not decide."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Literal, get_args

from labbook.results import display
from labbook.results.elongation import WITH_LENGTH, drop_of, gained, neighbours, rise_of
from labbook.results.points import PointResult
from labbook.results.reference import Comparison, entry_of, matches
from labbook.results.rotation import CONFIDENCE, FLOW, ROTATION, Rotation, by_seed
from labbook.results.series import Series
from labbook.stats import Pooled
from labbook.stats.ratio import paired_ratio
from labbook.study import Reference, Statement
from labbook.study.schema import TURNING

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

    @property
    def verdict(self) -> Verdict:
        """`holds` if our interval lies within what is stated, `does not hold` if outside, else `undecided`."""
        if self.ours is None or math.isinf(self.high - self.low):
            return "undecided"
        stated = self.statement
        if stated.low <= self.low and self.high <= stated.high:
            return "holds"
        return "does not hold" if self.high < stated.low or self.low > stated.high else "undecided"


_LACKING = "runs are lacking, and the first to end are no fair sample"


def judge(
    reference: Reference | None,
    points: Sequence[PointResult],
    series: Sequence[Series],
    turning: Sequence[Rotation],
) -> tuple[Judged, ...]:
    """Every statement of the reference, for each curve, series or point that it speaks of."""
    if reference is None:
        return ()
    return tuple(one for statement in reference.statements for one in _judge(statement, points, series, turning))


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
    statement: Statement, points: Sequence[PointResult], series: Sequence[Series], turning: Sequence[Rotation]
) -> Iterator[Judged]:
    head, _, quantity = statement.quantity.partition(".")
    name, _, feature = quantity.partition(".")
    if head == TURNING and feature in WITH_LENGTH:
        found = list(_with_length(statement, name, feature, turning))
    elif head == TURNING:
        found = [one for curve in turning for one in _turning(statement, quantity or FLOW, curve)]
    else:
        found = [_other(statement, one) for one in entry_of(statement.quantity, statement.at, points, series)]
    nothing = "run points with the bottom at rest and turning" if head == TURNING else "no finished point is there"
    yield from found or [Judged(statement, display.label(statement.at), None, why=nothing)]


def _other(statement: Statement, one: Comparison) -> Judged:
    return Judged(statement, one.label, one.ours, one.error, one.low, one.high, one.why)


def _turning(statement: Statement, name: str, curve: Rotation) -> Iterator[Judged]:
    """`QUANTITY`: over that at rest, at each frequency; `QUANTITY.FEATURE`: see `labbook.study.schema.FEATURES`."""
    asked = {key: value for key, value in statement.at.items() if key != ROTATION}
    if not matches(asked, curve.points[0].point):
        return
    quantity, _, feature = name.partition(".")
    where = ", ".join(filter(None, (curve.shape, curve.label)))
    if not curve.has(quantity):
        yield Judged(statement, where, None, why=f"{quantity} was not measured at two frequencies")
        return
    if feature in ("", "for_O_zz"):
        for k, result in enumerate(curve.points):
            if k and matches(statement.at, result.point):
                at = f"{where}, f = {curve.frequencies[k]:g} Hz"
                if result.partial or curve.points[0].partial:
                    yield Judged(statement, at, None, why=_LACKING)
                    continue
                ratio = curve.ratio(quantity, k) if not feature else _exchange(curve, k)
                yield _of_ratio(statement, at, ratio)
        return
    if curve.unfinished:
        places = ", ".join(f"{f:g}" for f in curve.unfinished)
        yield Judged(statement, where, None, why=f"{_LACKING} (f = {places} Hz)")
        return
    lowest = curve.lowest(quantity)
    if lowest is None:
        yield Judged(statement, where, None, why="a minimum needs three frequencies")
    elif feature == "minimum" and not any(statement.low <= f <= statement.high for f in curve.frequencies):
        yield Judged(statement, where, None, why="no frequency of the study lies where it is stated")
    elif feature == "minimum":
        extreme = curve.minimum(quantity)
        if extreme is None:
            yield Judged(statement, where, float(curve.frequencies[lowest]), why="its interval needs two seeds")
        else:
            yield Judged(statement, where, extreme.frequency, low=extreme.low, high=extreme.high)
    elif feature == "rise":
        yield _of_ratio(statement, where, rise_of(curve, quantity))
    else:
        yield _of_ratio(statement, where, drop_of(curve, quantity))


def _with_length(statement: Statement, quantity: str, feature: str, turning: Sequence[Rotation]) -> Iterator[Judged]:
    """Each shape against the next shorter one; those of which the longer is at what the statement asks for."""
    for shorter, longer, alike in neighbours(turning):
        if not matches(statement.at, longer.points[0].point):
            continue
        where = f"{longer.shape} less {shorter.shape}, {alike}"
        if not (shorter.has(quantity) and longer.has(quantity)):
            yield Judged(statement, where, None, why=f"{quantity} was not measured at two frequencies")
        elif shorter.unfinished or longer.unfinished:
            yield Judged(statement, where, None, why=_LACKING)
        elif min(len(shorter.points), len(longer.points)) < 3:
            yield Judged(statement, where, None, why="a minimum needs three frequencies")
        else:
            yield _of_ratio(statement, where, gained(shorter, longer, quantity, feature))


def _exchange(curve: Rotation, k: int) -> Pooled | None:
    values = [by_seed(curve.points[i], f"orifice_O_{c}{c}") for i in (0, k) for c in "rz"]
    seeds = sorted(set.intersection(*map(set, values)))
    if not seeds:
        return None
    r0, z0, r, z = ([one[s] for s in seeds] for one in values)
    gained, lost = [b - a for a, b in zip(r0, r, strict=True)], [a - b for a, b in zip(z0, z, strict=True)]
    return paired_ratio(gained, lost, CONFIDENCE)


def _of_ratio(statement: Statement, where: str, ratio: Pooled | None) -> Judged:
    if ratio is None:
        return Judged(statement, where, None, why="no seed has both runs")
    return Judged(statement, where, ratio.value, ratio.error, ratio.low, ratio.high, pairs=ratio.n)
