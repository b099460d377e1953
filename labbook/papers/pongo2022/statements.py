"""What is stated of a turning bottom, held against ours."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from labbook.papers.pongo2022.rotation import (
    CONFIDENCE,
    FLOW,
    ROTATION,
    WITH_LENGTH,
    Rotation,
    drop_of,
    gained,
    neighbours,
    rise_of,
)
from labbook.results import display
from labbook.results.points import PointResult, by_seed
from labbook.results.reference import matches
from labbook.results.statements import LACKING, Judged
from labbook.stats import Pooled
from labbook.stats.ratio import paired_ratio
from labbook.study import Statement

TURNING = "rotation"
"""Statements on `rotation.QUANTITY` speak of the quantity over that with the bottom at rest."""
FEATURES = ("drop", "minimum", "rise", "for_O_zz", "drop_with_length", "rise_with_length")
"""What `rotation.QUANTITY.FEATURE` may be.

| feature            | number                                                                        |
|--------------------|-------------------------------------------------------------------------------|
| `drop`             | 1 less the smallest ratio, in size, while turning                             |
| `minimum`          | the frequency at which the quantity is smallest in size [Hz]                   |
| `rise`             | at the fastest rotation over the smallest at slower ones                      |
| `for_O_zz`         | of O_rr: what it gains over what O_zz loses                                   |
| `drop_with_length` | drop less that of the next shorter grains, by L/d, at the same D or D/d*      |
| `rise_with_length` | the same of the rise                                                          |
"""
_HOW = (
    "Ratios to the bottom at rest are of means over the seeds that both have, with 90 % intervals; so is the frequency "
    "of a minimum, from curves drawn from the scatter between seeds. The smallest of several means is a little too "
    "small by being chosen."
)


def judged(statement: Statement, curves: Sequence[Rotation]) -> list[Judged]:
    """A statement on `rotation.QUANTITY` or one of its FEATURES, at each curve that it speaks of."""
    quantity = statement.quantity.partition(".")[2]
    name, _, feature = quantity.partition(".")
    if feature in WITH_LENGTH:
        found = list(_with_length(statement, name, feature, curves))
    else:
        found = [one for curve in curves for one in _turning(statement, quantity or FLOW, curve)]
    if not found:
        why = "run points with the bottom at rest and turning"
        return [Judged(statement, display.label(statement.at), None, why=why)]
    return [replace(one, how=_HOW) for one in found]


def _turning(statement: Statement, name: str, curve: Rotation) -> Iterator[Judged]:
    """`QUANTITY`: over that at rest, at each frequency; `QUANTITY.FEATURE`: see FEATURES."""
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
                    yield Judged(statement, at, None, why=LACKING)
                    continue
                ratio = curve.ratio(quantity, k) if not feature else _exchange(curve, k)
                yield _of_ratio(statement, at, ratio, (curve.points[0], result))
        return
    if curve.unfinished:
        places = ", ".join(f"{f:g}" for f in curve.unfinished)
        yield Judged(statement, where, None, why=f"{LACKING} (f = {places} Hz)")
        return
    lowest = curve.lowest(quantity)
    if lowest is None:
        yield Judged(statement, where, None, why="a minimum needs three frequencies")
    elif feature == "minimum" and not any(statement.low <= f <= statement.high for f in curve.frequencies):
        yield Judged(statement, where, None, why="no frequency of the study lies where it is stated")
    elif feature == "minimum":
        extreme = curve.minimum(quantity)
        if extreme is None:
            ours, why = float(curve.frequencies[lowest]), "its interval needs two seeds"
            yield Judged(statement, where, ours, why=why, points=curve.points)
        else:
            ours, low, high = extreme.frequency, extreme.low, extreme.high
            yield Judged(statement, where, ours, low=low, high=high, points=curve.points)
    elif feature == "rise":
        yield _of_ratio(statement, where, rise_of(curve, quantity), curve.points)
    else:
        yield _of_ratio(statement, where, drop_of(curve, quantity), curve.points)


def _with_length(statement: Statement, quantity: str, feature: str, turning: Sequence[Rotation]) -> Iterator[Judged]:
    """Each shape against the next shorter one; those of which the longer is at what the statement asks for."""
    for shorter, longer, alike in neighbours(turning):
        if not matches(statement.at, longer.points[0].point):
            continue
        where = f"{longer.shape} less {shorter.shape}, {alike}"
        if not (shorter.has(quantity) and longer.has(quantity)):
            yield Judged(statement, where, None, why=f"{quantity} was not measured at two frequencies")
        elif shorter.unfinished or longer.unfinished:
            yield Judged(statement, where, None, why=LACKING)
        elif min(len(shorter.points), len(longer.points)) < 3:
            yield Judged(statement, where, None, why="a minimum needs three frequencies")
        else:
            points = (*shorter.points, *longer.points)
            yield _of_ratio(statement, where, gained(shorter, longer, quantity, feature), points)


def _exchange(curve: Rotation, k: int) -> Pooled | None:
    values = [by_seed(curve.points[i], f"orifice_O_{c}{c}") for i in (0, k) for c in "rz"]
    seeds = sorted(set.intersection(*map(set, values)))
    if not seeds:
        return None
    r0, z0, r, z = ([one[s] for s in seeds] for one in values)
    gained, lost = [b - a for a, b in zip(r0, r, strict=True)], [a - b for a, b in zip(z0, z, strict=True)]
    return paired_ratio(gained, lost, CONFIDENCE)


def _of_ratio(statement: Statement, where: str, ratio: Pooled | None, points: tuple[PointResult, ...]) -> Judged:
    if ratio is None:
        return Judged(statement, where, None, why="no seed has both runs")
    return Judged(statement, where, ratio.value, ratio.error, ratio.low, ratio.high, pairs=ratio.n, points=points)
