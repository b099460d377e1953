"""What a flow rate owes to seeds, numerics, window, bed and filling: an error budget, with what was not measured."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from labbook.accuracy import Calibration, OutOfRange, bias_of
from labbook.results import display
from labbook.results.points import DRIFT, FLOW_RATE, PointResult
from labbook.results.study import Results

Source = Literal["seeds", "numerics", "window", "filling", "bed"]
SOURCES: dict[Source, str] = {
    "seeds": "scatter between replicates",
    "numerics": "time step, stiffness, precision",
    "window": "drift of W across the window",
    "filling": "how the packing was made",
    "bed": "number of grains",
}
_SWEPT: dict[Source, tuple[str, ...]] = {"numerics": ("numerics.",), "filling": ("fill.",), "bed": ("grains.count",)}
NOT_MEASURED = "not measured"


@dataclass(frozen=True)
class Share:
    """What one source adds to the error of a flow rate. `part`: of the flow rate, None where `basis` says why it is not
    known; `basis`: what it rests on."""

    source: Source
    part: float | None
    basis: str


@dataclass(frozen=True)
class Budget:
    """The error of a point's flow rate by source."""

    result: PointResult
    shares: tuple[Share, ...]

    @property
    def total(self) -> float:
        """Sum of all parts that are known: a bias does not average out, so that parts are added as they are."""
        return math.fsum(share.part for share in self.shares if share.part is not None)

    @property
    def unknown(self) -> tuple[Source, ...]:
        """Sources of which nothing is known."""
        return tuple(share.source for share in self.shares if share.part is None)

    @property
    def line(self) -> str:
        """`W = 108.5 ± 0.8 (seeds) ± 0.3 (numerics) ± 0.6 (window) g/s; not measured: filling, bed`."""
        flow, shown = self.result.flow_rate, display.quantity(FLOW_RATE)
        assert flow is not None
        known = [(share.source, abs(flow.value) * share.part) for share in self.shares if share.part is not None]
        finest = min((error for _, error in known if error > 0 and math.isfinite(error)), default=math.nan)
        parts = [f"± {display.number(error, finest, shown.scale)} ({source})" for source, error in known]
        value = display.number(flow.value, finest, shown.scale)
        lacking = f"; {NOT_MEASURED}: {', '.join(self.unknown)}" if self.unknown else ""
        return f"{shown.name} = {' '.join([value, *parts])} {shown.unit}".rstrip() + lacking


def budgets(results: Results) -> tuple[Budget, ...]:
    """The budget of every point with a flow rate."""
    return tuple(_budget(one, results) for one in results.points if one.flow_rate is not None)


def _budget(result: PointResult, results: Results) -> Budget:
    points = results.points
    shares = (_seeds(result), _numerics(result, points, results.study.calibration), _window(result))
    return Budget(result, (*shares, *(_swept(result, points, source) for source in ("filling", "bed"))))


def _seeds(result: PointResult) -> Share:
    flow = result.flow_rate
    assert flow is not None
    if not math.isfinite(flow.half_width):
        return Share("seeds", None, "one replicate")
    of = f"{flow.n} replicates" if flow.n > 1 else "one long run, by its own scatter"
    return Share("seeds", flow.relative, f"95 % interval of {of}")


def _numerics(result: PointResult, points: Sequence[PointResult], known: Calibration | None) -> Share:
    """From the study's own sweep over numerics, else from the calibration."""
    swept = _swept(result, points, "numerics")
    if swept.part is not None:
        return swept
    point = result.point
    if point.numerics.precision != "double":
        why = f"precision {point.numerics.precision}"
    else:
        try:
            bias = bias_of(point.scene, point.numerics, point.fill.numerics or point.numerics, known)
            return Share("numerics", bias.bound, f"calibration: bias {_percent(bias.value)} ± {bias.half_width:.2%}")
        except OutOfRange as reason:
            why = str(reason)
    return Share("numerics", None, f"{NOT_MEASURED}; beyond the calibration ({why})")


def _window(result: PointResult) -> Share:
    """Half of the drift: by so much W at either end of the window differs from its mean."""
    drift = result.pooled.get(DRIFT)
    if drift is None:
        return Share("window", None, NOT_MEASURED)
    error = f" ± {drift.half_width:.1%}" if math.isfinite(drift.half_width) else ""
    return Share("window", abs(drift.value) / 2, f"half of the drift, {_percent(drift.value)}{error}")


def _swept(result: PointResult, points: Sequence[PointResult], source: Source) -> Share:
    """The largest difference to points of the study that differ in nothing but keys of this source."""
    flow = result.flow_rate
    assert flow is not None
    begins = _SWEPT[source]
    others = {key: value for key, value in result.at.items() if not key.startswith(begins)}
    if len(others) == len(result.at):
        return Share(source, None, NOT_MEASURED)
    alike = [
        one.flow_rate.value
        for one in points
        if one.flow_rate is not None
        and one is not result
        and {key: value for key, value in one.at.items() if not key.startswith(begins)} == others
    ]
    if not alike:
        return Share(source, None, NOT_MEASURED)
    part = max(abs(value / flow.value - 1) for value in alike)
    return Share(source, part, f"largest difference to {len(alike)} other settings of this study")


def _percent(part: float) -> str:
    return f"{part:+.2%}"


def summed_up(found: Sequence[Budget]) -> str:
    """The budget of a study in a sentence: that of its only point, or the largest part of every source and where."""
    if len(found) == 1:
        return f"{found[0].line}."
    parts = []
    for source in SOURCES:
        known = [(share.part, one) for one in found for share in one.shares if share.source == source]
        largest = max(((part, one) for part, one in known if part is not None), key=lambda pair: pair[0], default=None)
        if largest is not None:
            parts.append(f"{source} up to {100 * largest[0]:.2g} % ({largest[1].result.label})")
    lacking = [source for source in SOURCES if all(source in one.unknown for one in found)]
    told = "; ".join(parts) + (f"; {NOT_MEASURED}: {', '.join(lacking)}" if lacking else "")
    return f"Of W: {told}." if told else ""
