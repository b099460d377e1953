"""Effect of numerics: points that differ in one key of `numerics` only, against the one that is listed first."""

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
    """Comparison of W of two points that differ in one key of `numerics`.

    Args:
        key: The key.
        first: Point whose value of the key is listed first.
        second: The point that is compared with it.
        margin: Largest difference of equivalent flow rates, relative to the first mean. None: nothing is tested, and of
            `test` only difference, error and interval mean something.
        test: Test of both means, relative to the first; None if `why` says why there is none.
        why: Reason that there is no test.
        paired: True if both points start from the same packings (`fill.numerics`), and the test is paired seed by seed.
            Else the samples are independent: every packing is filled with the numerics of its point.
    """

    key: str
    first: PointResult
    second: PointResult
    margin: float | None
    test: Equivalence | None
    why: str = ""
    paired: bool = False

    @property
    def label(self) -> str:
        """The value of the key, and the value that it replaces."""
        first = f"{display.amount(self.key, self.first.at[self.key])} {display.key(self.key).unit}".rstrip()
        return f"{display.setting(self.key, self.second.at[self.key])} instead of {first}"

    @property
    def where(self) -> str:
        """Swept values that both points have in common."""
        return display.label(self.second.at, {self.key})

    @property
    def finding(self) -> str:
        """Finding of the test; empty without a test."""
        return self.test.finding if self.test is not None and self.margin is not None else ""


def numerical(
    study_points: Sequence[Point], points: Sequence[PointResult], margin: float | None
) -> tuple[Numerical, ...]:
    """Compare every point of a sweep over numerics with its first one.

    Args:
        study_points: All points of the study, in its order.
        points: Points with finished runs.
        margin: Margin of equivalence, relative to the first mean; None: no test.

    Returns:
        A comparison for each further value of each key of `numerics`.
    """
    by_index = {result.point.index: result for result in points}
    comparisons = []
    for key in dict.fromkeys(name for result in points for name in result.at if name.startswith(NUMERICS)):
        groups: dict[tuple, list[Point]] = {}
        for point in (point for point in study_points if key in point.at):
            groups.setdefault(tuple((k, v) for k, v in point.at.items() if k != key), []).append(point)
        for first, *rest in groups.values():
            if first.index in by_index:
                there = (by_index[other.index] for other in rest if other.index in by_index)
                comparisons += [_against(key, by_index[first.index], other, margin) for other in there]
    return tuple(comparisons)


def _against(key: str, first: PointResult, second: PointResult, margin: float | None) -> Numerical:
    if first.partial or second.partial:
        return Numerical(key, first, second, margin, None, "runs are missing")
    first_rates, second_rates = (by_seed(result, FLOW_RATE) for result in (first, second))
    common = sorted(first_rates.keys() & second_rates.keys())
    beds = [{run.seed: run.packing_key for run in result.runs} for result in (first, second)]
    paired = len(common) >= 2 and all(beds[0][seed] == beds[1][seed] for seed in common)
    a, b = ([values[seed] for seed in (common if paired else values)] for values in (first_rates, second_rates))
    mean = math.fsum(a) / len(a) if a else 0.0
    if min(len(a), len(b)) < 2 or not mean > 0:
        return Numerical(key, first, second, margin, None, "at least two replicates of each that flowed are needed")
    test = tost(a, b, (margin or 1.0) * mean, paired=paired).relative_to(mean)
    return Numerical(key, first, second, margin, test, paired=paired)


def summed_up(comparisons: Sequence[Numerical]) -> str:
    """Findings of all tests in a sentence; empty if nothing was tested."""
    tested = [comparison for comparison in comparisons if comparison.finding]
    margins = [comparison.margin for comparison in tested if comparison.margin is not None]
    if not margins:
        return ""
    equivalent, beyond = (
        sum(comparison.finding == finding for comparison in tested) for finding in ("equivalent", "different")
    )
    excess = f", a larger difference in {beyond}" if beyond else ""
    of = f"{len(tested)} comparison{'' if len(tested) == 1 else 's'}"
    return f"Numerics: the same flow rate within ±{percent(margins[0])} is shown in {equivalent} of {of}{excess}."
