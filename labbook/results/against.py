"""Effect of a parameter on the flow rate: ratios of points that differ in one swept key to the first of them.

Runs of equal seed often start from the same packing, for points that differ only in what happens after the opening.
What the packing does to both flow rates then divides out of their ratio, which is known better than each of them. Only
runs that did start from one packing are paired; all others are independent (Welch).
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from labbook.results import display
from labbook.results.points import FLOW_RATE, ORIFICE, PointResult, by_seed, followers, names_scene
from labbook.stats import Pooled
from labbook.stats.ratio import independent_ratio, paired_ratio
from labbook.warning import RenamedAttribute

Value = float | str


@dataclass(frozen=True, eq=False)
class RatioPoint:
    """A point at a value of the swept key.

    Args:
        result: The point.
        value: Value of the key [SI or word].
        ratio: Ratio of its quantity to that of the first point of its line, with a 95 % interval; None for the first
            point, and if one of both lacks the quantity.
        pairs: Number of pairs of runs that share a packing, on which the ratio rests; 0: the runs are independent.
    """

    result: PointResult
    value: Value
    ratio: Pooled | None = None
    pairs: int = 0


@dataclass(frozen=True, eq=False)
class Line:
    """Points that differ in the key only.

    Args:
        at: Swept values that they have in common.
        points: The points: numbers ascending, words as the study lists them.
        first: Point that the others are compared with; None if no point has the quantity.
    """

    at: Mapping[str, Value]
    points: tuple[RatioPoint, ...]
    first: RatioPoint | None
    places = RenamedAttribute("points")

    @property
    def label(self) -> str:
        """Swept values that the points have in common; empty if nothing else was swept."""
        return display.label(self.at)

    @property
    def largest(self) -> RatioPoint | None:
        """Point at which the quantity differs most from that of the first; None without any ratio."""
        with_ratio = [point for point in self.points if point.ratio is not None]
        return max(with_ratio, key=lambda point: abs(point.ratio.value - 1) if point.ratio else 0.0, default=None)


@dataclass(frozen=True, eq=False)
class Against:
    """A quantity against one swept key.

    Args:
        key: The key.
        quantity: Name of the quantity.
        lines: A line for each combination of the other keys that was run at two values of the key or more.
        along: Other keys whose values follow from the key's and change with it.
        unset: Points at which the key has no value.
    """

    key: str
    quantity: str
    lines: tuple[Line, ...]
    along: tuple[str, ...] = ()
    unset: tuple[PointResult, ...] = ()

    def setting(self, point: RatioPoint) -> str:
        """`L = 6 mm, d = 3 mm`: the key at a place, with the keys that change along."""
        values = {**point.result.at, **point.result.along}
        along = {name: values[name] for name in self.along if name in values and names_scene(name)}
        return display.label({self.key: point.value, **along})

    @property
    def heading(self) -> str:
        """The key as on an axis, with the keys that change along."""
        along = [display.key(name).name for name in self.along if names_scene(name)]
        return display.key(self.key).heading + (f" (with {', '.join(along)})" if along else "")

    @property
    def words(self) -> bool:
        """True if the values of the key are words."""
        return any(isinstance(point.value, str) for line in self.lines for point in line.points)

    @property
    def values(self) -> tuple[Value, ...]:
        """All values of the key: numbers ascending, words as the study lists them."""
        return _ordered([point for line in self.lines for point in line.points], self.words)


def against(
    points: Sequence[PointResult], quantity: str = FLOW_RATE, references: Mapping[str, Value] | None = None
) -> tuple[Against, ...]:
    """One Against for every swept key but the orifice that takes two values or more, in the study's order.

    Ratios are to the value in `references` of each key; without one to the value that the study lists first. A line
    that has no such point, or none with the quantity, is compared with the first of its points that has it.
    """
    keys = dict.fromkeys(name for result in points for name in result.at if name != ORIFICE)
    comparisons = (_of_key(key, points, quantity, (references or {}).get(key)) for key in keys)
    return tuple(comparison for comparison in comparisons if len(comparison.values) > 1)


def rows(comparisons: Sequence[Against]) -> Iterator[dict[str, Any]]:
    """Every ratio as a row of plain values, in SI: what a data frame is made of."""
    for comparison in comparisons:
        for line in comparison.lines:
            for point in line.points:
                if point.ratio is None or line.first is None:
                    continue
                numbers = {name: getattr(point.ratio, name) for name in ("value", "error", "low", "high", "confidence")}
                head = {"point": point.result.point.index + 1, **point.result.point.at, "key": comparison.key}
                ratio = {
                    "quantity": comparison.quantity,
                    "over": line.first.value,
                    "ratio": numbers.pop("value"),
                    **numbers,
                }
                yield {**head, **ratio, "pairs": point.pairs}


def _of_key(key: str, points: Sequence[PointResult], quantity: str, reference: Value | None) -> Against:
    valued = [(result, result.at.get(key, result.point.value(key))) for result in points]
    ratio_points = [RatioPoint(result, value) for result, value in valued if value is not None]
    unset = tuple(result for result, value in valued if value is None)
    other_keys = [name for name in dict.fromkeys(name for result in points for name in result.at) if name != key]
    along: tuple[str, ...] = ()
    groups = _groups(ratio_points, other_keys)
    if all(len({point.value for point in group}) < 2 for group in groups.values()):  # nothing varies alone
        along = tuple(name for name in other_keys if _follows(name, ratio_points))
        groups = _groups(ratio_points, [name for name in other_keys if name not in along])
    if any(len({point.value for point in group}) > 1 for group in groups.values()):  # one value says nothing of the key
        groups = {at: group for at, group in groups.items() if len({point.value for point in group}) > 1}
    words = any(isinstance(point.value, str) for point in ratio_points)
    start = reference if reference is not None else ratio_points[0].value if ratio_points else None
    lines = tuple(_line(dict(at), group, quantity, start, words) for at, group in groups.items())
    return Against(key, quantity, lines, (*along, *followers(points, key)), unset)


def _groups(
    points: Sequence[RatioPoint], other_keys: Sequence[str]
) -> dict[tuple[tuple[str, Value], ...], list[RatioPoint]]:
    groups: dict[tuple[tuple[str, Value], ...], list[RatioPoint]] = {}
    for point in points:
        at = point.result.at
        groups.setdefault(tuple((name, at[name]) for name in other_keys if name in at), []).append(point)
    return groups


def _follows(name: str, points: Sequence[RatioPoint]) -> bool:
    """True if each value of the compared key goes with one value of the key `name`."""
    values: dict[Value, set[Value | None]] = {}
    for point in points:
        values.setdefault(point.value, set()).add(point.result.at.get(name))
    return all(len(known) == 1 for known in values.values())


def _line(
    at: Mapping[str, Value], group: Sequence[RatioPoint], quantity: str, start: Value | None, words: bool
) -> Line:
    able = [point for point in group if point.result.pooled.get(quantity) is not None]
    first = next((point for point in able if point.value == start), able[0] if able else None)
    if first is not None and first.result.pooled[quantity].value == 0:
        first = None  # nothing can be divided by it
    order = _ordered(group, words)
    ranked = sorted(group, key=lambda point: order.index(point.value))
    return Line(at, tuple(point if point is first else _relative_to(point, first, quantity) for point in ranked), first)


def _relative_to(point: RatioPoint, first: RatioPoint | None, quantity: str) -> RatioPoint:
    if first is None or point.result.pooled.get(quantity) is None:
        return point
    return RatioPoint(point.result, point.value, *ratio_of(point.result, first.result, quantity))


def ratio_of(result: PointResult, first: PointResult, quantity: str) -> tuple[Pooled, int]:
    """A quantity of a point over that of another, which is not zero; and how many pairs of runs that share a packing it
    rests on (0: the runs are independent). Both points have the quantity."""
    above, below = by_seed(result, quantity), by_seed(first, quantity)
    shared = _shared(result, first, sorted(above.keys() & below.keys()))
    # two pairs among many runs that have none would leave most of what is known unused; one pair has no interval, nor
    # has any ratio to a single run
    fewest = min(len(above), len(below))
    if shared and (len(shared) > 1 or fewest == 1) and 2 * len(shared) >= fewest:
        return paired_ratio([above[s] for s in shared], [below[s] for s in shared]), len(shared)
    return independent_ratio(result.pooled[quantity], first.pooled[quantity]), 0


def _shared(first: PointResult, second: PointResult, seeds: Sequence[int]) -> list[int]:
    """Seeds whose runs at both points started from the same packing."""
    packings = [{run.seed: run.packing_key for run in result.runs} for result in (first, second)]
    return [seed for seed in seeds if packings[0][seed] == packings[1][seed]]


def _ordered(points: Sequence[RatioPoint], words: bool) -> tuple[Value, ...]:
    distinct = dict.fromkeys(point.value for point in sorted(points, key=lambda point: point.result.point.index))
    if words:
        return tuple(distinct)
    return tuple(sorted(distinct, key=lambda value: value if isinstance(value, float | int) else math.inf))
