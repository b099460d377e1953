"""A measured quantity over all swept keys at once: values, the inverse, what matters, and what to run next.

The surface is a polynomial in the scaled keys (`labbook.stats.polynomial`), of the logarithm of a quantity above 0.
From a flow rate against the outlet Beverloo's dependence is taken off before, as in `labbook.fit.interpolation`. The
surface is known between its points only. Of a single key the value and the inverse are those of
`labbook.results.surface`, which uses the law of the study.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from labbook.fit.interpolation import OutletTrend, trend_of_outlets
from labbook.results import display
from labbook.results.points import FLOW_RATE, PointResult, by_seed, names_scene
from labbook.results.selection import has, key_named, value_of_key
from labbook.results.study import StudyResults
from labbook.results.surface import (
    DesignValue,
    NoSurface,
    ResponseSurface,
    is_clogged,
    is_length,
    remark_on,
    surface,
)
from labbook.scene.quantities import parse
from labbook.stats.inverse import NoSetting, setting_for
from labbook.stats.polynomial import Polynomial, legendre
from labbook.study import Point
from labbook.study.proposed import study_at

PROPOSALS = 3
"""Designs that are proposed to run next."""
_TREND = 12
"""Degree of the expansion of the outlet's trend."""
_CANDIDATES = 2000
"""Designs that are compared for what to run next, at most."""
_PLACES = 257
"""Places of a curve that a page shows."""
_LISTED = 5
"""Points that a message names one by one."""
_WORTH = 0.02
"""Part of the mean variance that a proposal has to remove."""


@dataclass(frozen=True)
class Factor:
    """A swept key, scaled from -1 to 1 over its range.

    Attributes:
        key: The key.
        low: Smallest value [SI].
        high: Largest value [SI].
        logarithmic: True if its logarithm is scaled: of lengths, and of values whose ratios are more even than their
            differences.
    """

    key: str
    low: float
    high: float
    logarithmic: bool

    @classmethod
    def of(cls, key: str, values: Sequence[float]) -> "Factor":
        """Scale a key by its values."""
        x = np.unique(np.asarray(values, float))
        even = bool((x > 0).all()) and (is_length(key) or (len(x) > 2 and _uneven(np.log(x)) < _uneven(x)))
        return cls(key, float(x[0]), float(x[-1]), even)

    def scaled(self, values: Any) -> np.ndarray:
        """Scale values of the key [SI]."""
        x, low, high = (self._coordinate(end) for end in (values, self.low, self.high))
        return 2 * (x - low) / (high - low) - 1

    def value(self, scaled: Any) -> np.ndarray:
        """Give the values [SI] of scaled ones."""
        low, high = self._coordinate(self.low), self._coordinate(self.high)
        x = low + (np.asarray(scaled, float) + 1) / 2 * (high - low)
        return np.exp(x) if self.logarithmic else x

    def _coordinate(self, values: Any) -> np.ndarray:
        if not self.logarithmic:
            return np.asarray(values, float)
        with np.errstate(divide="ignore", invalid="ignore"):  # of points that are left out, such as a width of 0
            return np.log(values)


@dataclass(frozen=True)
class Influence:
    """The influence of a key on a quantity within the swept range.

    Attributes:
        key: The key; empty for the part of the variance that keys explain only together.
        share: Part of the variance of the quantity (of its logarithm if it is above 0) over the range.
        low: Lower end of its 95 % interval.
        high: Upper end.
        change: Relative change of the quantity from the smallest to the largest value of the key, averaged over the
            other keys; the difference [SI] of a quantity that is not above 0. NaN for keys together.
        change_low: Lower end of its 95 % interval.
        change_high: Upper end.
    """

    key: str
    share: float
    low: float
    high: float
    change: float
    change_low: float
    change_high: float


@dataclass(frozen=True)
class NextRuns:
    """A design to run next.

    Attributes:
        at: Values of the keys [SI].
        point: Number of the point of the study that it is, from 1; None for a new design.
        beds: Beds that it then has.
        runs: Runs to make.
        seconds: Run time [s] of discharges and fillings, from those of stored runs; NaN if none is known.
        gain: Part of the mean variance of the surface now that they remove, with the proposals before in place.
        half_width: Relative half width of the 95 % interval of the surface at this design now; absolute [SI] for a
            quantity that is not above 0.
        half_width_then: The same after these runs.
    """

    at: Mapping[str, float]
    point: int | None
    beds: int
    runs: int
    seconds: float
    gain: float
    half_width: float
    half_width_then: float

    @property
    def per_second(self) -> float:
        """Part of the mean variance that is removed for each second of run time."""
        return self.gain / self.seconds if self.seconds else math.nan


@dataclass(frozen=True, eq=False)
class DesignSurface:
    """A quantity over all swept keys of numbers, between the points of a study.

    Attributes:
        quantity: The quantity.
        unit: Its SI unit.
        at: Values of the other keys: those that take words, and those of numerics.
        factors: The keys.
        points: Points that it rests on.
        left_out: Points that it does not rest on.
        method: Surface, points and lack of fit.
        notes: Points that were left out, and why; clogged runs of others.
        curve: Of a single key: the law or interpolation that answers instead.
    """

    results: StudyResults
    quantity: str
    unit: str
    at: Mapping[str, float | str]
    factors: tuple[Factor, ...]
    points: tuple[PointResult, ...]
    left_out: tuple[PointResult, ...]
    notes: tuple[str, ...]
    curve: ResponseSurface | None
    logarithmic: bool
    trend: OutletTrend | None
    """Taken off the logarithm before."""
    trend_of: int
    """Number of the factor that the trend is of."""
    fit: Polynomial

    @cached_property
    def method(self) -> str:
        """Basis of the answers."""
        if self.curve is not None:
            return self.curve.method
        name = display.quantity(self.quantity, self.unit).name
        scales = [f"ln {display.key(factor.key).name}" if factor.logarithmic else display.key(factor.key).name
                  for factor in self.factors]  # fmt: skip
        beds = sum(len(by_seed(result, self.quantity)) for result in self.points)
        lack = "" if math.isnan(self.fit.lack_of_fit) else f", lack of fit p = {self.fit.lack_of_fit:.2g}"
        misses = ": it misses the points by more than their errors" if self.fit.lack_of_fit < 0.05 else ""
        return (
            f"smooth surface of {'ln ' if self.logarithmic else ''}{name} over {', '.join(scales)} through "
            f"{len(self.points)} points, with {beds} beds as weights{lack}{misses}"
        )

    def predict(self, at: Mapping[str, Any]) -> tuple[float, float, float]:
        """Compute the quantity at a design, and the ends of its 95 % interval [SI].

        Args:
            at: A value for each key, by the key or its last part: text with a unit, or a number in SI.

        Raises:
            LookupError: A key is missing or unknown.
            NoSurface: The design is not between the points.
        """
        values = self._design(at)
        if self.curve is not None:
            value, low, high = self.curve.predict(values[0])
            return float(value[0]), float(low[0]), float(high[0])
        u = self.scaled(values[None])
        if not self.fit.inside(u)[0]:
            raise NoSurface(f"{self._label(values)} is not between the points at which {self.quantity} is known")
        value, low, high = self.band(u)
        return float(value[0]), float(low[0]), float(high[0])

    def inverse(self, target: str | float, over: str, at: Mapping[str, Any] | None = None) -> DesignValue:
        """Find the value of a key that gives the quantity.

        Args:
            target: Text with a unit (`"50 g/s"`), or a number in SI.
            over: The key, or its last part.
            at: A value for each of the other keys.

        Raises:
            LookupError: A key is missing or unknown.
            NoSurface: The quantity is not reached between the points, or at several values of the key.
            ValueError: The text is no such quantity.
        """
        if self.curve is not None:
            return self.curve.inverse(target)
        key = key_named(over, self.keys)
        number = parse(target, self.unit) if isinstance(target, str) else float(target)
        index = self.keys.index(key)
        values = self._design({**(at or {}), key: self.factors[index].low})
        fixed = self.scaled(values[None])[0]
        ends = self.fit.line(index, fixed)
        unit, factor = display.quantity(self.quantity, self.unit), self.factors[index]
        wish = f"{self.quantity} = {display.number(number, None, unit.scale)} {unit.unit}".rstrip()
        fixed_values = {k: v for k, v in zip(self.keys, values, strict=True) if k != key}
        where = f" at {display.label(fixed_values)}" if fixed_values else ""
        if ends is None:
            raise NoSurface(f"no point is near{where}")

        def along(u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            line = np.repeat(fixed[None], len(u), axis=0)
            line[:, index] = u
            return self.band(line)

        try:
            setting = setting_for(along, *ends, number)
        except NoSetting as reason:
            reached = f"{self.quantity} is {_range(reason.smallest, reason.largest, unit)}{where}"
            remedy = f"{reason} of {display.key(key).name}" if reason.several else f"not reached: {reached}"
            raise NoSurface(f"{wish} is {remedy}") from None
        value, low, high = (float(factor.value(x)) if math.isfinite(x) else x
                            for x in (setting.value, setting.low, setting.high))  # fmt: skip
        method = f"{self.method}{f'; {display.label(fixed_values)}' if fixed_values else ''}"
        return DesignValue(key, value, low, high, self.quantity, number, method, self.notes)

    @cached_property
    def influences(self) -> tuple[Influence, ...]:
        """The influence of each key, and of all together."""
        trends = {}
        if self.trend is not None:
            factor, trend = self.factors[self.trend_of], self.trend
            trends[self.trend_of] = legendre(lambda u: trend(factor.value(u)), _TREND)
        shares = np.array(self.fit.shares(trends)).T
        rows = []
        for index, factor in enumerate(self.factors):
            change, half = self.fit.change(index)
            if self.trend is not None and index == self.trend_of:
                ends = self.trend(np.array([factor.low, factor.high]))
                change += float(ends[1] - ends[0])
            values = np.array([change, change - half, change + half])
            values = np.expm1(values) if self.logarithmic else values
            rows.append(Influence(factor.key, *shares[index].tolist(), *values.tolist()))
        together = [Influence("", *shares[-1].tolist(), *[math.nan] * 3)] if len(self.factors) > 1 else []
        return tuple(rows + together)

    @property
    def verdict(self) -> str:
        """The key that matters most, if the intervals tell it."""
        if len(self.factors) < 2:
            return ""
        first, second = sorted(
            (influence for influence in self.influences if influence.key), key=lambda influence: -influence.share
        )[:2]
        if first.low > second.high:
            name = display.spoken(first.key)
            return f"{name[:1].upper()}{name[1:]} matters most."
        return "The intervals of the largest shares overlap: it is not decided which key matters most."

    @cached_property
    def next_runs(self) -> tuple[NextRuns, ...]:
        """Designs at which more beds narrow the surface most for each second of run time, the best first.

        Each is chosen with the ones before it in place. A design gets as many beds in all as `beds_then`. Candidates
        are the points, and designs halfway between swept values. Clogged points are left out.
        """
        beds_at = self._beds()
        excluded = {self._position(result) for result in self.left_out if all(key in result.at for key in self.keys)}
        designs = np.array([candidate for candidate in self._candidates() if tuple(candidate.round(9)) not in excluded])
        before = np.array([beds_at.get(tuple(design.round(9)), (0, None))[0] for design in designs])
        seconds = self._seconds(designs)
        current, proposals = self.fit, list[NextRuns]()
        for _ in range(PROPOSALS):
            gains = current.removed(designs, before, self.beds_then) / self.fit.mean_variance
            cost = np.where(np.isfinite(seconds), seconds, 1.0) * np.maximum(self.beds_then - before, 0)
            worth = np.where((gains > _WORTH) & (cost > 0), gains / np.maximum(cost, 1e-12), 0.0)
            best = int(np.argmax(worth))
            if not worth[best] > 0:
                break
            u, beds = designs[best], int(self.beds_then - before[best])
            _, point = beds_at.get(tuple(u.round(9)), (0, None))
            at = {
                factor.key: _shown_value(float(factor.value(x)), factor)
                if point is None
                else float(point.at[factor.key])
                for factor, x in zip(self.factors, u, strict=True)
            }
            then = current.with_beds(u, int(before[best]), self.beds_then)
            halves = [float(fit.at(u[None])[1][0]) for fit in (current, then)]
            halves = [math.expm1(half) if self.logarithmic else half for half in halves]
            number = None if point is None else point.point.index + 1
            runs, time = round(beds * self._runs_per_bed), float(seconds[best] * beds)
            proposals.append(NextRuns(at, number, self.beds_then, runs, time, float(gains[best]), *halves))
            current, before[best] = then, self.beds_then
        return tuple(proposals)

    @property
    def beds_then(self) -> int:
        """Beds of each design that is run next: twice those of the study."""
        return 2 * max(2, self.results.study.replicates)

    @cached_property
    def next_study(self) -> str:
        """The study of the next runs as YAML; empty if none is worth its time."""
        if not self.next_runs:
            return ""
        points = [{**self.at, **proposal.at} for proposal in self.next_runs]
        name = f"{self.results.study.name}-next"
        return "".join(study_at(self.results.study, points, name, self.beds_then))

    def numbers(self) -> dict[str, Any]:
        """The surface as numbers, for a page that evaluates it without Python (`surface.js` of the web app): of a law
        or an interpolation its values and ends at places of the key, else the coefficients with their covariance."""
        if self.curve is not None:
            x = np.linspace(self.curve.low, self.curve.high, _PLACES)
            return {
                "kind": "curve",
                **dict(zip(("x", "value", "low", "high"), (x, *self.curve.predict(x)), strict=True)),
            }
        fit, trend = self.fit, self.trend
        return {
            "kind": "polynomial",
            "degrees": fit.degrees,
            "coefficients": fit.coefficients,
            "covariance": fit.covariance,
            "misfit": fit.misfit,
            "student": fit.student,
            "hull": fit.hull,
            "logarithmic": self.logarithmic,
            "trend": trend and {"factor": self.trend_of, "power": trend.power, "offset": trend.offset},
        }

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys."""
        return tuple(factor.key for factor in self.factors)

    def scaled(self, values: np.ndarray) -> np.ndarray:
        """Scale m designs [SI], shape [m, k]."""
        return np.stack([factor.scaled(values[:, index]) for index, factor in enumerate(self.factors)], axis=1)

    def band(self, scaled: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Compute the polynomial surface [SI] at m scaled designs, and the ends of its 95 % interval."""
        mean, half = self.fit.at(scaled)
        if self.trend is not None:
            mean = mean + self.trend(self.factors[self.trend_of].value(scaled[:, self.trend_of]))
        back = np.exp if self.logarithmic else np.asarray
        return back(mean), back(mean - half), back(mean + half)

    def _design(self, at: Mapping[str, Any]) -> np.ndarray:
        by_key = {key_named(str(name), self.keys): value for name, value in at.items()}
        if missing := [key for key in self.keys if key not in by_key]:
            raise LookupError(f"at: give a value of {' and '.join(missing)}")
        return np.array([float(value_of_key(key, by_key[key], self.points[0].point)) for key in self.keys])

    def _label(self, values: np.ndarray) -> str:
        return display.label(dict(zip(self.keys, values.tolist(), strict=True)))

    def _position(self, point: PointResult) -> tuple[float, ...]:
        values = np.array([[float(point.at[key]) for key in self.keys]])
        return tuple(self.scaled(values)[0].round(9))

    def _beds(self) -> dict[tuple[float, ...], tuple[int, PointResult]]:
        """Number of beds of each point, by its scaled place."""
        return {self._position(result): (len(by_seed(result, self.quantity)), result) for result in self.points}

    def _candidates(self) -> np.ndarray:
        """Designs within the hull: swept values and those halfway between; of many keys fewer of these."""
        positions = [np.unique(column) for column in np.array([*self._beds()]).T]
        finer = [np.unique([*column, *(column[1:] + column[:-1]) / 2]) for column in positions]
        for index in range(len(positions)):
            several = [*finer[: len(positions) - index], *positions[len(positions) - index :]]
            if math.prod(map(len, several)) <= _CANDIDATES:
                grid = np.array(list(product(*several)))
                return grid[self.fit.inside(grid)]
        return np.array([*self._beds()])

    @property
    def _runs_per_bed(self) -> float:
        return sum(len(result.runs) for result in self.points) / max(1, sum(len(result.beds) for result in self.points))

    def _seconds(self, designs: np.ndarray) -> np.ndarray:
        """Device time [s] of a bed at each design: of stored runs, log-linear in the scaled keys."""
        costs = [(self._position(result), run.cost) for result in self.points for run in result.runs if run.cost > 0]
        if not costs:
            return np.full(len(designs), math.nan)
        positions, seconds = (np.array(column) for column in zip(*costs, strict=True))
        terms = np.column_stack([np.ones(len(positions)), positions])
        plane = np.linalg.lstsq(terms, np.log(seconds), rcond=None)[0]
        return np.exp(np.column_stack([np.ones(len(designs)), designs]) @ plane) * self._runs_per_bed

    def __repr__(self) -> str:
        return f"<DesignSurface of {self.quantity} over {', '.join(self.keys)}: {self.method}>"


def explore(results: StudyResults, quantity: str = FLOW_RATE, at: Mapping[str, Any] | None = None) -> DesignSurface:
    """Make the surface of a quantity over all swept keys of numbers.

    Args:
        results: Of a study.
        quantity: A measured quantity.
        at: Values of swept keys that take words or belong to numerics, by key or its last part.

    Raises:
        LookupError: No key of numbers is swept, or a value of another key is missing.
        NoSurface: The points do not determine a surface.
    """
    keys, choices = swept_keys(results.points)
    if not keys:
        raise LookupError("no key of numbers is swept")
    fixed = {
        name: value_of_key(name, value, results.points[0].point)
        for name, value in ((key_named(str(name), choices), value) for name, value in (at or {}).items())
    }
    there = [result for result in results.points if has(result.at, fixed)]
    if several := [name for name in choices if len({result.at.get(name) for result in there}) > 1]:
        raise LookupError(f"at: give a value of {' and '.join(several)}")
    complete = [result for result in there if all(key in result.at for key in keys)]
    usable = [result for result in complete if result.pooled.get(quantity) is not None and not is_clogged(result)]
    left_out = tuple(result for result in there if result not in usable)
    notes = tuple(filter(None, (remark_on(result, quantity, result in usable) for result in there)))
    varied = [key for key in keys if len({result.at[key] for result in usable}) > 1]
    if len(varied) < len(keys) or len(usable) < 2:
        lacking = " and ".join(key for key in keys if key not in varied) or "no key"
        raise NoSurface(f"{quantity} is known at fewer than two values of {lacking}{_because(notes)}")
    factors = tuple(Factor.of(key, [float(result.at[key]) for result in usable]) for key in keys)
    unit = next(run.measured[quantity].unit for run in usable[0].runs if quantity in run.measured)
    runs = [(result, value, seed) for result in usable for seed, value in by_seed(result, quantity).items()]
    values = np.array([[float(result.at[key]) for key in keys] for result, _, _ in runs])
    y, seeds = np.array([value for _, value, _ in runs]), [seed for _, _, seed in runs]
    logarithmic = bool((y > 0).all())
    trends = [(index, trend) for index, factor in enumerate(factors) if logarithmic
              and (trend := _trend(quantity, factor, usable)) is not None]  # fmt: skip
    index, trend = trends[0] if trends else (-1, None)
    y = np.log(y) if logarithmic else y
    try:
        u = np.stack([factor.scaled(values[:, k]) for k, factor in enumerate(factors)], axis=1)
        fit = Polynomial.of(u, y - trend(values[:, index]) if trend is not None else y, seeds)
    except ValueError as problem:
        raise NoSurface(f"{quantity}: {problem}{_because(notes)}") from None
    curve = surface(results, quantity, keys[0], fixed) if len(keys) == 1 else None
    return DesignSurface(results, quantity, unit, fixed, factors, tuple(usable), left_out, notes, curve, logarithmic,
                         trend, index, fit)  # fmt: skip


def inverse(
    results: StudyResults, quantity: str, value: str | float, over: str | None, at: Mapping[str, Any] | None
) -> DesignValue:
    """Find the value of a swept key that gives a wanted value of a quantity: by the points that have the values `at`,
    or by the surface over all keys if none has.

    Args:
        results: Of a study.
        quantity: A measured quantity.
        value: Text with a unit, or a number in SI.
        over: The key that varies, or its last part; None: the only swept key that takes numbers.
        at: Values of the other swept keys.

    Raises:
        LookupError, NoSurface, ValueError: As for `surface` and its `inverse`.
    """
    keys, choices = swept_keys(results.points)
    if over is not None and at and len(keys) > 1:
        key = key_named(over, (*keys, *choices))
        by_key = {key_named(str(name), (*keys, *choices)): setting for name, setting in at.items()}
        like = results.points[0].point
        fixed = {name: value_of_key(name, setting, like) for name, setting in by_key.items()}
        if key in keys and {*keys} <= {key, *fixed} and not any(has(result.at, fixed) for result in results.points):
            design = explore(results, quantity, {name: x for name, x in fixed.items() if name in choices})
            return design.inverse(value, key, {name: x for name, x in fixed.items() if name in keys})
    return surface(results, quantity, over, at).inverse(value)


def swept_keys(points: Sequence[PointResult | Point]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Find the swept keys that a surface is over: those of the scene that take numbers; and the other swept keys."""
    values: dict[str, set[float | str]] = {}
    for result in points:
        for name, value in result.at.items():
            values.setdefault(name, set()).add(value)
    several = {name: of for name, of in values.items() if len(of) > 1}
    keys = tuple(
        name for name, of in several.items() if names_scene(name) and not any(isinstance(entry, str) for entry in of)
    )
    return keys, tuple(name for name in values if name not in keys)


def _trend(quantity: str, factor: Factor, points: Sequence[PointResult]) -> OutletTrend | None:
    found = {trend_of_outlets(quantity, factor.key, result.point.scene, factor.low) for result in points}
    return found.pop() if len(found) == 1 else None


def _uneven(values: np.ndarray) -> float:
    """Spread of the steps between sorted values, over their mean."""
    steps = np.diff(values)
    return float(steps.std() / steps.mean())


def _shown_value(value: float, factor: Factor) -> float:
    """A value to three digits, if it stays within the range."""
    scale = display.key(factor.key).scale
    rounded = float(f"{float(f'{value * scale:.3g}') / scale:.12g}")
    limit = next((end for end in (factor.low, factor.high) if math.isclose(end, value, rel_tol=1e-9)), None)
    return limit if limit is not None else min(max(rounded, factor.low), factor.high)


def _because(notes: Sequence[str]) -> str:
    more = f"; and {len(notes) - _LISTED} more" if len(notes) > _LISTED else ""
    return f" ({'; '.join(notes[:_LISTED])}{more})" if notes else ""


def _range(low: float, high: float, unit: display.Notation) -> str:
    ends = (display.number(x, None, unit.scale) for x in (low, high))
    return f"{' to '.join(ends)} {unit.unit}".rstrip()
