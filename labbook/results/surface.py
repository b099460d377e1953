"""A measured quantity between the swept values of a key, and the key's value that gives a wanted quantity.

The law of the study is used if the points allow it. If not, the quantity is interpolated (`labbook.fit.interpolation`).
Neither goes beyond the swept range. Points at which more than a fifth of the runs clogged are left out: the others are
a biased sample.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from labbook.fit import FitResult
from labbook.fit.interpolation import CLOGGED, Interpolation, trend_of_outlets
from labbook.results import display
from labbook.results.points import FLOW_RATE, NUMERICS, ORIFICE, PointResult, by_seed
from labbook.results.selection import has, key_named, value_of_key
from labbook.results.series import series_of
from labbook.results.study import StudyResults
from labbook.scene.quantities import parse
from labbook.stats.inverse import NoSetting, setting_for
from labbook.stats.response import FEWEST
from labbook.study import Point
from labbook.study.keys import find

MISFIT = 0.05
"""Probability of the lack of fit below which a law is not used."""


class NoSurface(ValueError):
    """The results do not give a surface, or it does not have the wanted value; the message says why and what helps."""


@dataclass(frozen=True)
class DesignValue:
    """The value of a key that gives a wanted quantity, in SI.

    Attributes:
        key: The key.
        value: Its value.
        low: Lower end of its 95 % interval; infinite if the swept range does not bound it.
        high: Upper end.
        quantity: The quantity.
        target: Its wanted value.
        method: Basis of the answer.
        notes: Points that were left out, and why.
    """

    key: str
    value: float
    low: float
    high: float
    quantity: str
    target: float
    method: str
    notes: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """The answer with its interval."""
        of_key, unit = display.key(self.key), display.quantity(self.quantity)
        error = (self.high - self.low) / 4
        low, value, high = (display.number(x, error, of_key.scale) for x in (self.low, self.value, self.high))
        low = low if math.isfinite(self.low) else "below the swept range"
        ends = f"{low} to {high if math.isfinite(self.high) else 'beyond the swept range'}"
        wish = f"{unit.name} = {display.number(self.target, None, unit.scale)} {unit.unit}".rstrip()
        return f"{of_key.name} = {value} {of_key.unit}".rstrip() + f" (95 %: {ends}) gives {wish}"

    def __repr__(self) -> str:
        return "\n".join(
            (f"<DesignValue: {self.sentence}>", f"  {self.method}", *(f"  note: {note}" for note in self.notes))
        )


@dataclass(frozen=True, eq=False)
class ResponseSurface:
    """A quantity against one key, from the smallest to the largest value at which it is known.

    Attributes:
        quantity: The quantity.
        key: The key.
        unit: SI unit of the quantity.
        at: Values of the other swept keys.
        low: Smallest value of the key.
        high: Largest value of the key.
        points: Points that it rests on.
        method: The law, or that it is interpolated, and why.
        notes: Points that were left out, and why.
    """

    quantity: str
    key: str
    unit: str
    at: Mapping[str, float | str]
    low: float
    high: float
    points: tuple[PointResult, ...]
    method: str
    notes: tuple[str, ...]
    _basis: FitResult | Interpolation

    def predict(self, values: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Compute the quantity at m values of the key, and the ends of its pointwise 95 % interval, each of shape [m].

        Args:
            values: Text with a unit (`"21 mm"`), numbers in SI, or a list of either.

        Raises:
            NoSurface: A value is outside the range.
        """
        single = isinstance(values, str) or not np.ndim(values)
        x = np.array([value_of_key(self.key, text, self._like) for text in ([values] if single else values)], float)
        beyond = x[(x < self.low * (1 - 1e-9)) | (x > self.high * (1 + 1e-9))]
        if len(beyond):
            setting = display.setting(self.key, float(beyond[0]))
            raise NoSurface(f"{setting} is outside of the range in which {self.quantity} is known, {self._range}")
        return self._basis.band(np.clip(x, self.low, self.high))

    def inverse(self, target: str | float) -> DesignValue:
        """Find the value of the key that gives the quantity.

        Args:
            target: Text with a unit (`"50 g/s"`), or a number in SI.

        Raises:
            NoSurface: The quantity is not reached within the swept range, or at several values of the key.
            ValueError: The text is no such quantity.
        """
        number = parse(target, self.unit) if isinstance(target, str) else float(target)
        try:
            setting = setting_for(self._basis.band, self.low, self.high, number)
        except NoSetting as reason:
            raise NoSurface(self._not_reached(number, reason)) from None
        return DesignValue(
            self.key, setting.value, setting.low, setting.high, self.quantity, number, self.method, self.notes
        )

    @property
    def _like(self) -> Point:
        return self.points[0].point

    @property
    def _range(self) -> str:
        """The range of the key."""
        key = display.key(self.key)
        low, high = (display.amount(self.key, end) for end in (self.low, self.high))
        return f"{key.name} = {low} to {high} {key.unit}".rstrip()

    def _not_reached(self, target: float, reason: NoSetting) -> str:
        unit = display.quantity(self.quantity, self.unit)
        low, high, value = (display.number(x, None, unit.scale) for x in (reason.smallest, reason.largest, target))
        reached = f"{self.quantity} is {low} to {high} {unit.unit}".rstrip() + f" at {self._range}"
        if reason.smallest <= target <= reason.largest:
            return f"{self.quantity} = {value} {unit.unit}: {reason} at {self._range}; sweep a part of that range"
        return f"{self.quantity} = {value} {unit.unit} is not reached: {reached}; sweep a wider range"

    def __repr__(self) -> str:
        return f"<ResponseSurface of {self.quantity} at {self._range}: {self.method}>"


def surface(
    results: StudyResults, quantity: str = FLOW_RATE, over: str | None = None, at: Mapping[str, Any] | None = None
) -> ResponseSurface:
    """Make the surface of a quantity along one swept key.

    Args:
        results: Of a study.
        quantity: A measured quantity.
        over: The key, or its last part; None: the only swept key that takes numbers.
        at: Values of the other swept keys, by key or its last part.

    Raises:
        LookupError: There is no such key, or it is not clear which is meant, or no point has the values.
        NoSurface: Too few points have the quantity.
    """
    key = _key(results.points, over)
    fixed = _fixed(results.points, key, at or {})
    there = [result for result in results.points if has(result.at, fixed) and key in result.at]
    usable = [result for result in there if result.pooled.get(quantity) is not None and not is_clogged(result)]
    notes = tuple(filter(None, (remark_on(result, quantity, result in usable) for result in there)))
    values = sorted({float(result.at[key]) for result in usable})
    if len(values) < 2:
        why = f" ({'; '.join(notes)})" if notes else ""
        raise NoSurface(f"{quantity} is known at {len(values)} values of {key}, and a surface needs {FEWEST}{why}")
    unit = next(run.measured[quantity].unit for run in usable[0].runs if quantity in run.measured)
    law, rejected = _law(results, usable, key, quantity)
    head = (quantity, key, unit, fixed, values[0], values[-1], tuple(usable))
    if law is not None:
        p = "" if math.isnan(law.p_value) else f", lack of fit p = {law.p_value:.2g}"
        method = f"{display.law(law.law.name)} fitted to {len(law.D)} points{p}"
        return ResponseSurface(*head, method, notes, law)
    runs = [
        (float(result.at[key]), value, seed) for result in usable for seed, value in by_seed(result, quantity).items()
    ]
    x, y, seeds = (np.array(column) for column in zip(*runs, strict=True))
    if len({*seeds.tolist()}) < 2:
        raise NoSurface(
            f"all values of {quantity} are of one bed, whose scatter is not known; use replicates: 2 or more"
        )
    trend = trend_of_outlets(quantity, key, usable[0].point.scene, values[0])
    try:
        fitted = Interpolation.of(x, y, seeds.tolist(), of_length=is_length(key), trend=trend)
    except ValueError as problem:
        raise NoSurface(f"{quantity} against {key}: {problem}{'; ' if rejected else ''}{rejected}") from None
    method = f"interpolated between {len(values)} values, with {len(runs)} beds{f' ({rejected})' if rejected else ''}"
    return ResponseSurface(*head, method, notes, fitted)


def is_length(key: str) -> bool:
    """Decide if a key is a length: responses are interpolated against its logarithm."""
    return any(known.unit == "m" for known in find(key))


def _law(results: StudyResults, usable: Sequence[PointResult], key: str, quantity: str) -> tuple[FitResult | None, str]:
    """The law that the points allow, of several the one with the least AICc; else why none is used."""
    if key != ORIFICE or quantity != FLOW_RATE or not results.study.fit:
        return None, ""
    (series,) = series_of(usable, results.study.fit)
    allowed = [fit for fit in series.fits.values() if not fit.p_value < MISFIT]
    if allowed:
        return min(allowed, key=lambda fit: math.inf if math.isnan(fit.aicc) else fit.aicc), ""
    misses = (f"{display.law(law)} misses the points, p = {fit.p_value:.2g}" for law, fit in series.fits.items())
    return None, "; ".join((*misses, *series.problems))


def _key(points: Sequence[PointResult], over: str | None) -> str:
    values: dict[str, set[float | str]] = {}
    for result in points:
        for name, value in result.at.items():
            values.setdefault(name, set()).add(value)
    keys = [name for name, of in values.items() if len(of) > 1 and not any(isinstance(entry, str) for entry in of)]
    if over is not None:
        return key_named(over, keys)
    physical = [name for name in keys if not name.startswith(NUMERICS)]
    if len(physical) != 1:
        there = f"the study sweeps {', '.join(physical)}: say which one" if physical else "no key of numbers is swept"
        raise LookupError(f"over: {there}")
    return physical[0]


def _fixed(points: Sequence[PointResult], key: str, at: Mapping[str, Any]) -> dict[str, float | str]:
    """Values of the keys beside `key`, all of which have to be known."""
    neighbours = list(dict.fromkeys(name for result in points for name in result.at if name != key))
    fixed = {name: value_of_key(name, value, points[0].point) for name, value in
             ((key_named(str(name), neighbours), value) for name, value in at.items())}  # fmt: skip
    there = [result for result in points if has(result.at, fixed)]
    several = [name for name in neighbours if len({result.at.get(name) for result in there}) > 1]
    if several or not there:
        lacking = f"give a value of {' and '.join(several)}" if several else "no point has these values"
        raise LookupError(f"at: {lacking}")
    return fixed


def is_clogged(point: PointResult) -> bool:
    """Decide if so many runs of a point clogged that the others are a biased sample."""
    return point.outcomes["clogged"] > CLOGGED * len(point.runs)


def remark_on(point: PointResult, quantity: str, used: bool) -> str:
    """Reason for leaving a point out, or a warning about one that is used; empty if there is neither."""
    clogged = f"{point.outcomes['clogged']} of {len(point.runs)} runs clogged"
    if used:
        return f"{point.label}: {clogged}, and the others are biased to fast flow" if point.outcomes["clogged"] else ""
    return f"{point.label} is left out: {clogged if is_clogged(point) else point.lacking or f'no {quantity}'}"
