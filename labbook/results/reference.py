"""Ours beside the paper's: every number of a study's reference, and how far ours lies from it."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labbook.fit import LAWS, FitError, FitResult, fit
from labbook.results import display
from labbook.results.points import FLOW_RATE, ORIFICE, PointResult
from labbook.results.series import Series, context
from labbook.scene.quantities import percent
from labbook.study import Point, Reference
from labbook.study.paper import of_fit

NORMAL = 1.96
"""Half of a 95 % interval in standard errors that are known."""
_NO_POINT = "no finished point has these values"
NEAR = 0.1
"""Relative difference within which numbers that do not agree are said to be near."""


@dataclass(frozen=True)
class Comparison:
    """A number of the reference and ours, in SI. `ours` is None where we have none; `why` then says so. `points`: those
    that ours rests on; `says`: the place of the number in the paper; `measured`: whether it is from a file of
    measurements, or fitted to them."""

    quantity: str
    at: Mapping[str, float | str]
    label: str
    reference: float
    reference_error: float | None
    ours: float | None
    error: float = math.nan
    low: float = math.nan
    high: float = math.nan
    unit: str = ""
    why: str = ""
    points: tuple[PointResult, ...] = ()
    says: str = ""
    measured: bool = False

    @property
    def relative(self) -> float:
        """(ours - reference) / reference; NaN where ours is missing or the reference is zero."""
        if self.ours is None or self.reference == 0:
            return math.nan
        return self.ours / self.reference - 1

    @property
    def inside(self) -> bool | None:
        """True if the reference lies inside our 95 % interval, widened by that of the reference if it states an error.

        The interval is Student's: two or three seeds estimate their standard error too badly for a normal interval.
        None if we have no number or no interval.
        """
        if self.ours is None or not (math.isfinite(self.low) or math.isfinite(self.high)):
            return None
        half = self.ours - self.low if self.reference < self.ours else self.high - self.ours
        return abs(self.ours - self.reference) <= math.hypot(half, NORMAL * (self.reference_error or 0.0))

    @property
    def n(self) -> int | None:
        """Number of beds in our mean; None for a fitted number."""
        pooled = self.points[0].pooled.get(self.quantity) if len(self.points) == 1 else None
        return None if pooled is None else pooled.n

    @property
    def in_errors(self) -> float:
        """(ours - reference) over the standard error of the difference; NaN where it is not known."""
        if self.ours is None:
            return math.nan
        error = math.hypot(self.error, self.reference_error or 0.0)
        return (self.ours - self.reference) / error if error > 0 else math.nan


Own = Callable[[str, Mapping[str, float | str]], Sequence[Comparison] | None]
"""Function of a quantity and values of keys: our numbers by the analysis of a paper, with NaN as the reference; None if
no paper has the quantity."""


def compare(
    reference: Reference | None, points: Sequence[PointResult], series: Sequence[Series], own: Own = lambda *_: None
) -> tuple[Comparison, ...]:
    """One Comparison for each entry of the reference and each series (`law.parameter`) or point that it speaks of."""
    if reference is None:
        return ()
    published = (
        replace(
            comparison, reference=entry.value, reference_error=entry.error, says=entry.says, measured=entry.measured
        )
        for entry in reference.entries
        for comparison in entry_of(entry.quantity, entry.at, points, series, own)
    )
    return (
        *published,
        *(comparison for one_series in series for comparison in _of_measured_fits(reference, one_series)),
    )


def measured_fit(reference: Reference, law: str, series: Series) -> FitResult | None:
    """Fit a law to the measured flow rates that belong to a series, whether they are simulated or not.

    Grains, packing fraction and outlet are those of the series. The stated errors count as known; if any is missing,
    the errors are taken from the scatter about the law.

    Args:
        reference: Has entries from a file of measurements, or none.
        law: Name of the law.
        series: Has the points that are simulated.

    Returns:
        The fit; None where too few values are measured, or they do not determine the law.
    """
    mine = [entry for entry in reference.entries if entry.measured and entry.quantity.rpartition(".")[2] == FLOW_RATE]
    mine = [entry for entry in mine if ORIFICE in entry.at and belongs(entry.at, series)]
    D, W = (np.array(values, float) for values in ([e.at[ORIFICE] for e in mine], [e.value for e in mine]))
    error = np.array([math.nan if entry.error is None else entry.error for entry in mine])
    has_errors = bool((error > 0).all())
    try:
        with LAWS.calling(law, FitError):
            return fit(LAWS[law], D, W, error, context(series.points), None if has_errors else np.ones(len(D), int))
    except FitError:
        return None


def _of_measured_fits(reference: Reference, series: Series) -> Iterator[Comparison]:
    """Parameters of laws that are fitted to the measured flow rates of a series, beside ours."""
    for law in series.fits:
        if (theirs := measured_fit(reference, law, series)) is None:
            continue
        for name, parameter in theirs.parameters.items():
            base = replace(sought(f"{law}.{name}", series.at), label=series.label, points=series.points)
            ours = _of_fit(base, law, name, series)
            says = f"fitted to {len(theirs.D)} measured values"
            yield replace(ours, reference=parameter.value, reference_error=parameter.error, says=says, measured=True)


def belongs(at: Mapping[str, float | str], series: Series) -> bool:
    """Decide if values of keys are those of a series, whatever the orifice."""
    return matches({name: value for name, value in at.items() if name != ORIFICE}, series.points[0].point)


def at_series(comparisons: Sequence[Comparison], law: str, series: Series) -> dict[str, Comparison]:
    """The comparisons of parameters of `law` (or a further fit) at a series, by the name of the parameter; of several
    numbers for one parameter, the first."""
    mine = [c for c in comparisons if c.quantity.startswith(f"{law}.")][::-1]
    return {c.quantity.partition(".")[2]: c for c in mine if not series.at or dict(c.at) == dict(series.at)}


def of_reference(comparisons: Sequence[Comparison], law: str, series: Series) -> dict[str, float]:
    """Parameters of `law` (or a further fit) that the reference states for a series, by name, in SI."""
    return {name: comparison.reference for name, comparison in at_series(comparisons, law, series).items()}


def agreement(comparisons: Sequence[Comparison], source: str) -> str:
    """A plain sentence on how ours agree with the source."""
    with_interval = [c for c in comparisons if c.inside is not None]
    if not with_interval:
        return f"No numbers to compare with {source} yet."
    apart = [c for c in with_interval if not c.inside]
    near = sum(abs(c.relative) <= NEAR for c in apart)
    near_text = f", and {near} more lie within {percent(NEAR)}" if near else ""
    inside = len(with_interval) - len(apart)
    text = f"Of {len(with_interval)} numbers of {source}, {inside} lie inside our 95 % intervals{near_text}."
    sized = [c for c in apart or with_interval if math.isfinite(c.relative)]
    if not sized:
        return text
    farthest = max(sized, key=lambda c: abs(c.relative))
    name = display.quantity(farthest.quantity).name
    where = f" at {farthest.label}" if farthest.label else ""
    runs = "" if farthest.n is None else f" (n = {farthest.n})"
    side = "inside" if farthest.inside else "outside"
    difference = percent(farthest.relative, "+.1f").replace("-", "−")
    return f"{text} The largest difference is in {name}{where}: {difference}, {side} the 95 % interval{runs}."


def sought(quantity: str, at: Mapping[str, float | str]) -> Comparison:
    """A comparison without numbers, of a quantity at swept values."""
    return Comparison(quantity, at, display.label(at), math.nan, None, None)


def entry_of(
    name: str,
    conditions: Mapping[str, float | str],
    points: Sequence[PointResult],
    series: Sequence[Series],
    own: Own = lambda *_: None,
) -> Iterator[Comparison]:
    """Compare a quantity of the reference with ours at each series (`law.parameter`) or point.

    Args:
        name: Name of the quantity.
        conditions: Values of keys [SI or word] that a point must have.
        points: Points of the study with finished runs.
        series: Series of the study.
        own: Numbers of papers.

    Yields:
        A comparison for each point or series; its reference is NaN.
    """
    head, _, tail = name.partition(".")
    of_papers = own(name, conditions)
    base = sought(name if of_papers is not None or of_fit(name) else tail or head, conditions)
    comparisons: list[Comparison] = []
    if of_papers is not None:
        comparisons += of_papers
    elif of_fit(name):
        at = {name: value for name, value in conditions.items() if name != ORIFICE}
        for fitted_series in (each_series for each_series in series if matches(at, each_series.points[0].point)):
            there = replace(
                base, at=fitted_series.at or at, label=fitted_series.label or base.label, points=fitted_series.points
            )
            comparisons.append(_of_fit(there, head, tail, fitted_series))
    else:
        for result in (result for result in points if matches(conditions, result.point)):
            comparisons.append(_of_point(replace(base, at=result.at, label=result.label, points=(result,)), result))
    yield from _merged(comparisons, len(points)) or [replace(base, why=_NO_POINT)]


def _merged(comparisons: Sequence[Comparison], points: int) -> list[Comparison]:
    """Merge comparisons of points that share the compared number, as those with a common packing do."""
    groups: dict[tuple, list[Comparison]] = {}
    for comparison in comparisons:
        groups.setdefault((comparison.ours, comparison.why), []).append(comparison)
    merged = []
    for group in groups.values():
        first = group[0]
        if len(group) > 1:
            common = {name: value for name, value in first.at.items() if all(c.at.get(name) == value for c in group)}
            condition = f" at {display.label(common)}" if common else ""
            label = "all points" if len(group) == points else f"{len(group)} points{condition}"
            first = replace(first, at=common, label=label, points=tuple(result for c in group for result in c.points))
        merged.append(first)
    return merged


def _of_fit(base: Comparison, law: str, parameter: str, series: Series) -> Comparison:
    fitted = series.parameters(law)
    if not fitted:
        return replace(base, why="; ".join(series.problems) or f"the study does not fit {law}")
    ours = fitted.get(parameter)
    if ours is None:
        return replace(base, why=f"{law} has no {parameter} here; it has {', '.join(fitted)}")
    return replace(base, ours=ours.value, error=ours.error, low=ours.low, high=ours.high, unit=ours.unit)


def _of_point(base: Comparison, result: PointResult) -> Comparison:
    pooled = result.pooled.get(base.quantity)
    if pooled is None:
        measured = ", ".join(result.pooled) or "nothing"
        return replace(base, why=f"{base.quantity} was not measured here; measured: {measured}")
    unit = next(run.measured[base.quantity].unit for run in result.runs if base.quantity in run.measured)
    return replace(base, ours=pooled.value, error=pooled.error, low=pooled.low, high=pooled.high, unit=unit)


def matches(conditions: Mapping[str, float | str], point: Point) -> bool:
    """True if a point has all these values of keys, whether they are swept or the same for all points."""
    for name, value in conditions.items():
        ours = point.value(name)
        if isinstance(value, str) or not isinstance(ours, float):
            if ours != value:
                return False
        elif not math.isclose(ours, value, rel_tol=1e-9, abs_tol=1e-12):
            return False
    return True
