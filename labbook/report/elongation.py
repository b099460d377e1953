"""How much more the flow of longer grains drops when the bottom begins to turn (Pongo et al. 2022, Fig. 3a)."""

import math
from collections.abc import Iterator, Sequence

from labbook.report.rotation import CONFIDENCE, Rotation, aspect_ratio, relative_orifice
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


def gained(shorter: Rotation, longer: Rotation, quantity: str) -> Pooled | None:
    """Drop of the longer grains less that of the shorter, with Welch's interval: their packings are no pairs."""
    a, b = drop_of(shorter, quantity), drop_of(longer, quantity)
    if a is None or b is None:
        return None
    n, value, error = min(a.n, b.n), b.value - a.value, math.hypot(a.error, b.error)
    if n < 2:
        return Pooled(value, math.nan, math.inf, n, CONFIDENCE)
    freedom = welch(a.error**2, a.n, b.error**2, b.n)
    return Pooled(value, error, student(CONFIDENCE, freedom) * error, n, CONFIDENCE)
