"""Clogging at the points of a study: probability of a stop, survival of avalanches, and its dependence on D/d."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labbook.fit import FitError
from labbook.fit.clogging import AVALANCHE_LAWS, DECADES, AvalancheFit, fit_avalanches, preferred
from labbook.measure import scales
from labbook.measure.clogging import EXCHANGE, PROBABILITY, Avalanches, Clogging, dimension, outlet_suffix, width_ratio
from labbook.results.outlets import OutletResult
from labbook.results.paper import Row
from labbook.results.points import PointResult, RunResult
from labbook.results.series import Series
from labbook.results.study import StudyResults
from labbook.stats import Pooled
from labbook.stats.rates import PooledRate, clustered
from labbook.stats.ratio import paired_ratio
from labbook.stats.survival import (
    Correlation,
    Hazard,
    PowerTail,
    Survival,
    flowing_fraction,
    hazard,
    kaplan_meier,
    lag_correlation,
    power_tail,
    rank_correlation,
    tail_goodness,
)
from labbook.warning import RenamedAttribute

CORRELATED = 0.1
"""Rank correlation within packings above which discharges of one packing are no repeats."""
_RARE = 0.01
FEW_BEDS = 32
"""Packings below which the interval over packings is too narrow."""


@dataclass(frozen=True, eq=False)
class PointClogging:
    """Clogging at a point, or at one of several outlets of it, that has avalanches.

    Attributes:
        result: The point, or its outlet.
        runs: Its runs, each with its avalanches.
    """

    result: PointResult
    runs: tuple[tuple[RunResult, Avalanches], ...]
    width = RenamedAttribute("width_ratio")
    place = RenamedAttribute("outlet_index")

    @property
    def outlet_index(self) -> int | None:
        """Index of one of several outlets; None of a point with one."""
        return self.result.outlet_index if isinstance(self.result, OutletResult) else None

    @property
    def suffix(self) -> str:
        """Suffix of its quantities: empty of a point with one outlet."""
        return outlet_suffix(self.result.outlet) if isinstance(self.result, OutletResult) else ""

    @property
    def width_ratio(self) -> float:
        """D/d, with the diameter of spheres of the grains' volume."""
        return width_ratio(self.result.point.scene, self.outlet_index or 0)

    @property
    def probability(self) -> PooledRate | None:
        """Probability per grain that the flow stops; None where no grain left beyond a transient."""
        pooled = self.result.pooled.get(PROBABILITY + self.suffix)
        return pooled if isinstance(pooled, PooledRate) else None

    @cached_property
    def over_beds(self) -> tuple[float, float]:
        """Interval of the probability from a bootstrap over packings; NaN of one packing."""
        return clustered(*self._of_beds(lambda own: (own.stops, own.counted.sum())))

    @property
    def mean_avalanche(self) -> tuple[float, float, float]:
        """Mean avalanche, 1/q [grains], and the ends of its interval; infinite without stops."""
        q = self.probability
        if q is None:
            return math.nan, math.nan, math.nan
        return tuple(1 / end if end else math.inf for end in (q.value, q.high, q.low))  # pyright: ignore[reportReturnType]

    @cached_property
    def sizes(self) -> tuple[np.ndarray, np.ndarray]:
        """Grains of every avalanche beyond its transient, and whether a stop ended it; without those that ended within
        the transient."""
        sizes = np.concatenate([own.counted for _, own in self.runs])
        stopped = np.concatenate([own.stopped for _, own in self.runs])
        return sizes[sizes > 0], stopped[sizes > 0]

    @property
    def within_transient(self) -> int:
        """Avalanches that ended within the transient."""
        return sum(int((own.stopped & (own.counted == 0)).sum()) for _, own in self.runs)

    @cached_property
    def hazard(self) -> Hazard | None:
        """Stops per grain against the grains that have left; None where no grain counts."""
        return hazard(*self.sizes) if len(self.sizes[0]) else None

    @cached_property
    def survival(self) -> Survival | None:
        """Part of the avalanches that are longer, by Kaplan and Meier; None where no grain counts."""
        return kaplan_meier(*self.sizes) if len(self.sizes[0]) else None

    @cached_property
    def consecutive(self) -> Correlation:
        """Correlation of consecutive avalanches of a silo; of silos with restarts only."""
        return lag_correlation([own.grains[own.stopped] for _, own in self.runs])

    @cached_property
    def within_beds(self) -> Correlation:
        """Rank correlation of the first avalanches of discharges of one packing."""
        beds: dict[int, list[float]] = {}
        for run, own in self.runs:
            beds.setdefault(run.seed, []).append(float(own.grains[0]))
        return rank_correlation([np.array(sizes) for sizes in beds.values()])

    @cached_property
    def flowing(self) -> Pooled | None:
        """Mass flow rate [kg/s] while flowing, of all runs, whether they clogged or not: mass over time of all
        avalanches beyond their transients, with the error of a ratio over beds. Runs that clog early count with the
        time in which they flowed, so that it is not biased to those that did not clog."""
        mass, time = self._of_beds(lambda own: (own.mass.sum(), own.time.sum()))
        return paired_ratio(mass, time) if time.sum() > 0 else None

    @cached_property
    def times(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Times between grains [s] of an agitated silo, and if a grain ended each; None of others, and of one of
        several outlets."""
        if self.outlet_index is not None:
            return None
        of_runs = [waits for run, _ in self.runs if (waits := run.waits) is not None]
        if not of_runs:
            return None
        between, ended = (np.concatenate(parts) for parts in zip(*of_runs, strict=True))
        return between, ended

    @cached_property
    def tail(self) -> PowerTail | str:
        """Power-law tail of the times between grains of an agitated silo; else the reason for none."""
        if self.times is None:
            return "no wall moves, so that a stop never ends"
        try:
            return power_tail(*self.times)
        except ValueError as few:
            return str(few)

    @cached_property
    def tail_goodness(self) -> float:
        """Probability that a power law gives a tail farther from its fit; NaN without a tail."""
        if self.times is None or isinstance(self.tail, str):
            return math.nan
        return tail_goodness(*self.times, self.tail)

    @property
    def flowing_fraction(self) -> float:
        """Part of the time of an agitated silo without gaps (`window.gap`); NaN of others."""
        if self.times is None:
            return math.nan
        longest = scales.gap(self.result.point.scene, self.result.runs[0].window)
        gaps = self.times[0] > longest
        return flowing_fraction(float(self.times[0][~gaps].sum()), float(self.times[0][gaps].sum()))

    @property
    def row(self) -> Row:
        """Numbers by the names of columns: stops, probability with both intervals, flow while flowing and, of agitated
        silos, the tail of the times between grains."""
        q, (low, high), flowing = self.probability, self.over_beds, self.flowing
        row: Row = {"outlet": self.result.outlet.name} if isinstance(self.result, OutletResult) else {}
        row |= {"width_ratio": self.width_ratio, "stops": q.events if q else 0, "grains": q.exposure if q else 0.0}
        if q is not None:
            row |= {"probability": q.value, "low": q.low, "high": q.high, "low_over_beds": low, "high_over_beds": high}
        row["hazard_p"] = self.hazard.p if self.hazard is not None else math.nan
        if flowing is not None:
            row |= {"flow_while_flowing": flowing.value, "error": flowing.error}
        if self.times is not None:
            row["flowing_fraction"] = self.flowing_fraction
        if isinstance(tail := self.tail, PowerTail):
            row |= {"alpha": tail.alpha, "alpha_low": tail.low, "alpha_high": tail.high, "t_min": tail.t_min}
            row |= {"times": tail.n, "censored": tail.censored, "probability_of_divergence": tail.clogs}
            row |= {"over_exponential": tail.exponential, "over_stretched": tail.stretched}
            row |= {"goodness": self.tail_goodness, "verdict": tail.verdict}
        return row

    def _of_beds(self, pair: Callable[[Avalanches], tuple[float, float]]) -> np.ndarray:
        """Sums over the runs of each bed of two numbers of a run, shape [2, beds]."""
        beds: dict[int, np.ndarray] = {}
        for run, own in self.runs:
            beds[run.seed] = beds.get(run.seed, np.zeros(2)) + np.array(pair(own), float)
        return np.array(list(beds.values())).T

    @property
    def preceding(self) -> float:
        """Part of the states of flow that precede a stop, F = 1 / (1 + ⟨s⟩/s_m); NaN where it is not known."""
        q, exchange = self.probability, self.result.pooled.get(EXCHANGE + self.suffix)
        if q is None or exchange is None or q.bound:
            return math.nan
        return 1 / (1 + 1 / (q.value * exchange.value))


@dataclass(frozen=True, eq=False)
class SeriesClogging:
    """Clogging at the points of a series, in the order of D/d, with the laws fitted to them.

    Attributes:
        series: The points.
        points: Those of them with avalanches.
        fits: The laws.
        problems: Why a law was not fitted.
    """

    series: Series
    points: tuple[PointClogging, ...]
    fits: tuple[AvalancheFit, ...]
    problems: tuple[str, ...]

    @property
    def law_rows(self) -> Iterator[Row]:
        """A row for each parameter of each fitted law."""
        for fit in self.fits:
            goodness = {"deviance": fit.deviance, "p": fit.p_value, "aicc": fit.aicc, "outlets": len(fit.x)}
            for name, parameter in fit.parameters.items():
                head = {"law": fit.law.name, "formula": fit.law.formula, "parameter": name}
                yield {**head, **vars(parameter), **goodness}

    @property
    def decades(self) -> float:
        """Decades of the mean avalanche between the outlets with stops."""
        means = [result.mean_avalanche[0] for result in self.points]
        finite = [mean for mean in means if math.isfinite(mean)]
        return math.log10(max(finite) / min(finite)) if finite else 0.0

    @property
    def doubts(self) -> list[str]:
        """Sentences on points whose avalanches have a memory, or depend on their packing."""
        sentences = []
        for point in self.points:
            label = point.result.label or "the only point"
            p = point.hazard.p if point.hazard is not None else math.nan
            if p < _RARE:
                sentences.append(
                    f"The hazard is not constant at {label} (p = {p:.1g}), so that q depends on the transient left out."
                )
            if point.within_beds.value > CORRELATED and point.within_beds.low > 0:
                sentences.append(
                    f"First avalanches of one packing are correlated at {label} (rank correlation "
                    f"{point.within_beds.value:.2f}): use more replicates instead of discharges_per_bed."
                )
        return sentences

    @property
    def verdict(self) -> str:
        """Preferred law, in a sentence; empty with fewer than two fits."""
        if len(self.fits) < 2:
            return ""
        left = preferred(self.fits)
        names = [fit.law.name for fit in self.fits]
        if len(left) == 1:
            beaten = " and ".join(name for name in names if name not in left)
            return f"The stops prefer the law “{left[0]}” to “{beaten}” (AICc)."
        text = (
            f"Undecided between {' and '.join(f'“{name}”' for name in left)}: none is better by 4 both in AICc and in "
        )
        text += "-2 ln of the likelihood"
        text += " (AICc needs more outlets)" if any(math.isnan(fit.aicc) for fit in self.fits) else ""
        short = (
            f" The mean avalanche covers {self.decades:.1f} decades; {DECADES:g} are needed to distinguish the laws."
        )
        return f"{text}.{short if self.decades < DECADES else ''}"


def clogging_of(result: PointResult) -> PointClogging | None:
    """Clogging at a point, or at one of several outlets of it; None where it was not measured, or no run counts."""
    outlet_index = result.outlet_index if isinstance(result, OutletResult) else None
    runs = tuple((run, own) for run in result.runs if (own := run.avalanches_of(outlet_index)) is not None)
    return PointClogging(result, runs) if runs else None


def clogging(results: StudyResults) -> tuple[SeriesClogging, ...]:
    """Clogging in every series of a study that measures it."""
    if Clogging.name not in results.study.measure:
        return ()
    every = []
    for series in results.series:
        points = tuple(of_point for result in series.points if (of_point := clogging_of(result)) is not None)
        if points:
            every.append(SeriesClogging(series, points, *_fits(points)))
    return tuple(every)


def _fits(points: Sequence[PointClogging]) -> tuple[tuple[AvalancheFit, ...], tuple[str, ...]]:
    counts = [(result.width_ratio, q.events, q.exposure) for result in points if (q := result.probability) is not None]
    if len({width for width, *_ in counts}) < 2:
        return (), ()
    widths, stops, grains = (list(column) for column in zip(*counts, strict=True))
    fits, problems, of = [], [], dimension(points[0].result.point.scene, points[0].outlet_index or 0)
    for law in AVALANCHE_LAWS:
        try:
            fits.append(fit_avalanches(law, widths, stops, grains, of))
        except FitError as failure:
            problems.append(str(failure))
    return tuple(fits), tuple(problems)
