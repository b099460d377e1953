"""Numbers of a bottom that turns, of accelerations above outlets and of statements, as rows of tables."""

from collections.abc import Iterator
from typing import Any

from labbook.report.analysis import Analysis
from labbook.report.pattern import acceleration

Row = dict[str, Any]


def ratios(analysis: Analysis) -> Iterator[Row]:
    """Every quantity over that with the bottom at rest, paired by seeds; intervals have the stated confidence."""
    for curve in analysis.turning:
        for k, result in enumerate(curve.points):
            for quantity in result.pooled if k else ():
                ratio = curve.ratio(quantity, k) if _positive(curve.points[0], quantity) else None
                if ratio is not None:
                    ends = {"low": ratio.low, "high": ratio.high, "confidence": ratio.confidence}
                    numbers = {"ratio": ratio.value, "error": ratio.error, **ends, "pairs": ratio.n}
                    yield {"shape": curve.shape, **result.at, "quantity": quantity, **numbers}


def _positive(at_rest, quantity: str) -> bool:
    """Whether a ratio to the value at rest means anything: a drift or a waiting time may be 0."""
    pooled = at_rest.pooled.get(quantity)
    return pooled is not None and pooled.value != 0 and not quantity.startswith("flow_rate_drift")


def accelerations(analysis: Analysis) -> Iterator[Row]:
    """Mean upward acceleration [m/s^2] of the grains that start within each bin of height [m] above an outlet."""
    for result in analysis.points:
        profile = acceleration(result)
        if profile is None:
            continue
        columns = (profile.edges[:-1], profile.edges[1:], profile.acceleration, profile.error, profile.count)
        for bottom, top, value, error, count in zip(*columns, strict=True):
            height = {"bottom": float(bottom), "top": float(top)}
            numbers = {"acceleration": float(value), "error": float(error), "pairs": int(count)}
            yield {
                "point": result.point.index + 1,
                **result.point.at,
                **height,
                **numbers,
                "interval": profile.interval,
            }


def statements(analysis: Analysis) -> Iterator[Row]:
    """What a paper states, ours, and the verdict."""
    for one in analysis.judged:
        stated = one.statement
        asked = {"quantity": stated.quantity, "at": one.label, "says": stated.says}
        ours = {"from": stated.low, "to": stated.high, "ours": one.ours, "error": one.error}
        yield {**asked, **ours, "low": one.low, "high": one.high, "verdict": one.verdict, "why": one.why}
