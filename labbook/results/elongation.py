"""How much more the flow of longer grains drops when the bottom begins to turn, and rises as it turns faster (Pongo et
al. 2022, Fig. 3)."""

import math
from collections.abc import Callable, Iterator, Sequence

from labbook.results.rotation import CONFIDENCE, Rotation, aspect_ratio, relative_orifice
from labbook.stats import Pooled
from labbook.stats.pooling import student, welch

CLOSE = 0.03
"""Relative difference within which two D/d* count as one."""


def drop_of(curve: Rotation, quantity: str) -> Pooled | None:
    """1 less the smallest ratio to that at rest, while turning; None with fewer than three frequencies or no pair of
    seeds."""
    if curve.lowest(quantity) is None:
        return None
    slowest = curve.lowest(quantity, first=1)
    assert slowest is not None
    one = curve.ratio(quantity, slowest)
    return one and Pooled(1 - one.value, one.error, one.half_width, one.n, one.confidence)


def rise_of(curve: Rotation, quantity: str) -> Pooled | None:
    """The quantity at the fastest rotation over the smallest at slower ones; None as for `drop_of`."""
    slowest = curve.lowest(quantity, first=1, before_last=True)
    return None if slowest is None else curve.ratio(quantity, len(curve.points) - 1, slowest)


WITH_LENGTH: dict[str, Callable[[Rotation, str], Pooled | None]] = {
    "drop_with_length": drop_of,
    "rise_with_length": rise_of,
}
"""What a curve has that may grow with the length of its grains, by the name of the feature in a statement."""


def neighbours(curves: Sequence[Rotation]) -> Iterator[tuple[Rotation, Rotation, str]]:
    """Each shape with the next longer one, by L/d, at equal D, and again at equal D/d* where that is another pair; and
    at which."""
    for longer in curves:
        shape, wide = aspect_ratio(longer.points[0]), relative_orifice(longer.points[0])
        shorter = [one for one in curves if aspect_ratio(one.points[0]) < shape]
        alike = (
            (f"D = {longer.orifice * 1e3:.4g} mm", [one for one in shorter if one.orifice == longer.orifice]),
            (
                f"D/d* = {wide:.3g}",
                [one for one in shorter if abs(relative_orifice(one.points[0]) / wide - 1) < CLOSE],
            ),
        )
        found: list[Rotation] = []
        for where, group in alike:
            nearest = max(group, key=lambda one: aspect_ratio(one.points[0]), default=None)
            if nearest is not None and not any(nearest is one for one in found):
                found.append(nearest)
                yield nearest, longer, where


def gained(shorter: Rotation, longer: Rotation, quantity: str, feature: str) -> Pooled | None:
    """A feature of `WITH_LENGTH` of the longer grains less that of the shorter, with Welch's interval: their packings
    are no pairs."""
    a, b = (WITH_LENGTH[feature](one, quantity) for one in (shorter, longer))
    if a is None or b is None:
        return None
    n, value, error = min(a.n, b.n), b.value - a.value, math.hypot(a.error, b.error)
    if n < 2:
        return Pooled(value, math.nan, math.inf, n, CONFIDENCE)
    freedom = welch(a.error**2, a.n, b.error**2, b.n)
    return Pooled(value, error, student(CONFIDENCE, freedom) * error, n, CONFIDENCE)
