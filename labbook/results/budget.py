"""Error budget of a number: parts by seeds, numerics, window, bed and filling, and the sources without measurement."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from labbook.accuracy import Calibration, OutOfRange, bias_of
from labbook.fit import Parameter
from labbook.results import display
from labbook.results.points import BED, DRIFT, FILLING, FLOW_RATE, NUMERICS, PointResult
from labbook.results.series import PACKING_FRACTION, Series
from labbook.results.starts import window_share
from labbook.results.study import StudyResults
from labbook.scene.quantities import percent
from labbook.stats import Pooled
from labbook.warning import RenamedAttribute

Source = Literal["seeds", "numerics", "window", "filling", "bed"]
SOURCES: dict[Source, str] = {
    "seeds": "scatter between replicates",
    "numerics": "time step, stiffness, precision",
    "window": "drift of W across the window",
    "filling": "filling of the packing",
    "bed": "number of grains",
}
_SWEPT: dict[Source, str] = {"numerics": NUMERICS, "filling": FILLING, "bed": BED}
NOT_MEASURED = "not measured"


@dataclass(frozen=True)
class Share:
    """Part of one source in the error of a number.

    Args:
        source: Source of the error.
        relative: Half-width or largest difference, relative to the number; None if it is unknown.
        basis: Measurement that the part rests on, or the reason that there is none, in words.
        beside: Measured number that tables print beside the part.
    """

    source: Source
    relative: float | None
    basis: str
    beside: str = ""
    part = RenamedAttribute("relative")


@dataclass(frozen=True, eq=False)
class Budget:
    """The error of a number by source.

    Args:
        quantity: Name of the quantity of a point (flow rate, packing fraction), or `LAW.PARAMETER` of a series.
        of: The point or series.
        value: The number, in SI.
        shares: Part of each source.
    """

    quantity: str
    of: PointResult | Series
    value: float
    shares: tuple[Share, ...]

    @property
    def total(self) -> float:
        """Sum of all parts that are known: a bias does not average out, so that parts are added as they are."""
        return math.fsum(share.relative for share in self.shares if share.relative is not None)

    @property
    def unmeasured(self) -> tuple[Source, ...]:
        """Sources whose part is unknown."""
        return tuple(share.source for share in self.shares if share.relative is None)

    @property
    def name(self) -> str:
        """For people: `W`, `φ`, `k, beverloo`."""
        law, _, _ = self.quantity.rpartition(".")
        return ", ".join(filter(None, (display.quantity(self.quantity).name, law)))

    @property
    def line(self) -> str:
        """`Bounds: W = 108.5 ± 0.8 (seeds, 95 %) ± 0.3 (numerics) ± 0.6 (window) g/s; not measured: filling, bed`.

        These are half-widths and largest differences, no standard errors.
        """
        notation = display.quantity(self.quantity)
        bounds = [
            (share.source, abs(self.value) * share.relative) for share in self.shares if share.relative is not None
        ]
        finest = min((error for _, error in bounds if error > 0 and math.isfinite(error)), default=math.nan)
        parts = [
            f"± {display.number(error, finest, notation.scale)} ({source}{', 95 %' if source == 'seeds' else ''})"
            for source, error in bounds
        ]
        value = display.number(self.value, finest, notation.scale)
        lacking = f"; {NOT_MEASURED}: {', '.join(self.unmeasured)}" if self.unmeasured else ""
        before = "Bounds: " if parts else ""
        return before + f"{self.name} = {' '.join([value, *parts])} {notation.unit}".rstrip() + lacking


def budgets(results: StudyResults) -> tuple[Budget, ...]:
    """The budget of W and of the packing fraction of every point that has them, and of every parameter that was fitted
    to a series."""
    return (*point_budgets(results), *_of_series(results))


def point_budgets(results: StudyResults) -> tuple[Budget, ...]:
    """The budget of W and of the packing fraction of every point that has them. No other start of the window is
    evaluated for these."""
    return (*_of_points(results, FLOW_RATE), *_of_points(results, PACKING_FRACTION))


def _of_points(results: StudyResults, quantity: str) -> Iterator[Budget]:
    there = [(point, point.pooled[quantity]) for point in results.points if quantity in point.pooled]
    values = [(point.at, pooled.value) for point, pooled in there]
    for result, pooled in there:
        shares = [_seeds(pooled)]
        if quantity == FLOW_RATE:
            shares += [_numerics(result, values, results.study.calibration), _window(result)]
        else:  # of the bed at rest, before there is a window
            shares += [_swept("numerics", result.at, pooled.value, values)]
        shares += [_swept(source, result.at, pooled.value, values) for source in ("filling", "bed")]
        yield Budget(quantity, result, pooled.value, tuple(shares))


def _of_series(results: StudyResults) -> Iterator[Budget]:
    """Numerics, filling and bed move a parameter by as much as it differs between series that differ in these only."""
    for law in dict.fromkeys(law for series in results.series for law in series.fits):
        there = [series for series in results.series if law in series.fits]
        for name in dict.fromkeys(name for series in there for name in series.parameters(law)):
            fitted = [series for series in there if name in series.parameters(law)]
            values = [(series.at, series.parameters(law)[name].value) for series in fitted]
            for series, (at, value) in zip(fitted, values, strict=True):
                swept = {source: _swept(source, at, value, values) for source in _SWEPT}
                shares = [_fitted(series.parameters(law)[name]), swept["numerics"]]
                shares += [_opening(results, series, law, name), swept["filling"], swept["bed"]]
                yield Budget(f"{law}.{name}", series, value, tuple(shares))


def _seeds(pooled: Pooled) -> Share:
    if not math.isfinite(pooled.half_width):
        return Share("seeds", None, "one replicate")
    of = f"{pooled.n} replicates" if pooled.n > 1 else "one long run, from the scatter within it"
    return Share("seeds", pooled.relative, f"95 % interval of {of}")


def _fitted(parameter: Parameter) -> Share:
    relative = (parameter.high - parameter.low) / 2 / abs(parameter.value) if parameter.value else math.nan
    if not math.isfinite(relative):
        return Share("seeds", None, "the fit gives no interval")
    return Share("seeds", relative, "95 % interval of the fit")


Values = Sequence[tuple[Mapping[str, float | str], float]]
"""Pairs of swept values [SI or word] and the number measured there."""


def _numerics(result: PointResult, values: Values, calibration: Calibration | None) -> Share:
    """From the study's own sweep over numerics, else from the calibration."""
    flow = result.flow_rate
    assert flow is not None
    swept = _swept("numerics", result.at, flow.value, values)
    if swept.relative is not None:
        return swept
    point = result.point
    try:
        bias = bias_of(point.scene, point.numerics, point.fill.numerics or point.numerics, calibration)
    except OutOfRange as reason:
        return Share("numerics", None, f"{NOT_MEASURED}; beyond the calibration ({reason})")
    error = f"{percent(bias.value, '+.2f')} ± {percent(bias.half_width, '.2f')}"
    return Share("numerics", bias.bound, f"calibration: bias {error}")


def _window(result: PointResult) -> Share:
    """Half of the significant part of the drift: by so much W at either end of the window differs from its mean. Half
    of the whole drift would mostly be noise: of drifts that scatter by 15 % about zero it is 2.7 % of W on average with
    5 replicates.
    """
    drift = result.pooled.get(DRIFT)
    if drift is None:
        return Share("window", None, NOT_MEASURED)
    if not math.isfinite(drift.half_width):
        return Share("window", None, f"{NOT_MEASURED}: drift {percent(drift.value, '+.1f')} of one replicate")
    beside = f"drift {percent(drift.value, '+.1f')} ± {percent(drift.half_width, '.1f')}"
    return Share("window", drift.significant / 2, f"half of the significant part of the {beside}", beside)


def _opening(results: StudyResults, series: Series, law: str, name: str) -> Share:
    """By as much as a parameter moves between sensible starts of the window."""
    change = window_share(results, series, law, name)
    return Share("window", None, NOT_MEASURED) if change is None else Share("window", *change)


def _swept(source: Source, at: Mapping[str, float | str], value: float, values: Values) -> Share:
    """The largest difference to numbers of the study where nothing differs but keys of this source."""
    fixed = _without(at, source)
    if len(fixed) == len(at):
        return Share(source, None, NOT_MEASURED)
    alike = [other for there, other in values if there is not at and _without(there, source) == fixed]
    if not alike or not value:
        return Share(source, None, NOT_MEASURED)
    relative = max(abs(another / value - 1) for another in alike)
    return Share(source, relative, f"largest difference to {len(alike)} other settings of this study")


def _without(at: Mapping[str, float | str], source: Source) -> dict[str, float | str]:
    return {key: value for key, value in at.items() if not key.startswith(_SWEPT[source])}


def summed_up(budget_list: Sequence[Budget], quantity: str = FLOW_RATE) -> str:
    """The budget of a quantity in a sentence: that of its only point, or the largest part of every source and where."""
    budget_list = [budget for budget in budget_list if budget.quantity == quantity]
    if len(budget_list) == 1:
        return f"{budget_list[0].line}."
    parts = []
    for source in SOURCES:
        of_source = [
            (share.relative, budget) for budget in budget_list for share in budget.shares if share.source == source
        ]
        largest = max(
            ((relative, budget) for relative, budget in of_source if relative is not None),
            key=lambda pair: pair[0],
            default=None,
        )
        if largest is not None:
            relative, of = largest[0], largest[1].of.label
            parts.append(
                f"{source} up to {percent(relative, '.2g')} ({of})" if relative else f"{source} 0 % everywhere"
            )
    lacking = [source for source in SOURCES if any(s.source == source for budget in budget_list for s in budget.shares)]
    lacking = [source for source in lacking if all(source in budget.unmeasured for budget in budget_list)]
    text = "; ".join([*parts, *([f"{NOT_MEASURED}: {', '.join(lacking)}"] if lacking else [])])
    return f"Of {budget_list[0].name}: {text}." if text else ""
