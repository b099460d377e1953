"""Whether numerics matter: points that differ in one key of `numerics` only, against the one that is listed first."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from labbook.results import display
from labbook.results.points import FLOW_RATE, PointResult, by_seed
from labbook.scene.quantities import percent
from labbook.stats.equivalence import Equivalence, tost
from labbook.study import Point

NUMERICS = "numerics."


@dataclass(frozen=True)
class Numerical:
    """W of a point against that of the one whose value of `key` is listed first.

    `test`: of both means, in parts of the first. It is `paired`, seed by seed, where both start from the same packings
    (`fill.numerics`); else the samples are independent: every packing is filled with the numerics of its point. None
    where `why` says why not. `margin`: within which both count as the same, a part of the first mean; None: nothing is
    tested, and of `test` only difference, error and interval mean something.
    """

    key: str
    first: PointResult
    other: PointResult
    margin: float | None
    test: Equivalence | None
    why: str = ""
    paired: bool = False

    @property
    def label(self) -> str:
        """What differs."""
        first = f"{display.amount(self.key, self.first.at[self.key])} {display.key(self.key).unit}".rstrip()
        return f"{display.setting(self.key, self.other.at[self.key])} instead of {first}"

    @property
    def where(self) -> str:
        """What is the same."""
        return display.label(self.other.at, {self.key})

    @property
    def finding(self) -> str:
        """What the test shows; empty without one."""
        return self.test.finding if self.test is not None and self.margin is not None else ""


def numerical(asked: Sequence[Point], points: Sequence[PointResult], margin: float | None) -> tuple[Numerical, ...]:
    """Every point of a sweep over numerics against its first one. asked: all points of the study, in its order."""
    known = {result.point.index: result for result in points}
    found = []
    for key in dict.fromkeys(name for one in points for name in one.at if name.startswith(NUMERICS)):
        groups: dict[tuple, list[Point]] = {}
        for point in (point for point in asked if key in point.at):
            groups.setdefault(tuple((k, v) for k, v in point.at.items() if k != key), []).append(point)
        for first, *others in groups.values():
            if first.index in known:
                there = (known[other.index] for other in others if other.index in known)
                found += [_against(key, known[first.index], other, margin) for other in there]
    return tuple(found)


def _against(key: str, first: PointResult, other: PointResult, margin: float | None) -> Numerical:
    if first.partial or other.partial:
        return Numerical(key, first, other, margin, None, "runs are missing")
    one, two = (by_seed(result, FLOW_RATE) for result in (first, other))
    common = sorted(one.keys() & two.keys())
    beds = [{run.seed: run.packing_key for run in result.runs} for result in (first, other)]
    paired = len(common) >= 2 and all(beds[0][seed] == beds[1][seed] for seed in common)
    a, b = ([values[seed] for seed in (common if paired else values)] for values in (one, two))
    mean = math.fsum(a) / len(a) if a else 0.0
    if min(len(a), len(b)) < 2 or not mean > 0:
        return Numerical(key, first, other, margin, None, "at least two replicates of each that flowed are needed")
    test = tost(a, b, (margin or 1.0) * mean, paired=paired).over(mean)
    return Numerical(key, first, other, margin, test, paired=paired)


def summed_up(found: Sequence[Numerical]) -> str:
    """What came of all tests, in a sentence; empty if nothing was tested."""
    tested = [one for one in found if one.finding]
    margins = [one.margin for one in tested if one.margin is not None]
    if not margins:
        return ""
    same, beyond = (sum(one.finding == finding for one in tested) for finding in ("equivalent", "different"))
    more = f", a larger difference in {beyond}" if beyond else ""
    of = f"{len(tested)} comparison{'' if len(tested) == 1 else 's'}"
    return f"Numerics: the same flow rate within ±{percent(margins[0])} is shown in {same} of {of}{more}."
