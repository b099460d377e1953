"""Survival of avalanches and of times between grains, of which some are censored: their end was not observed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from labbook.stats.rates import PooledRate, rate

FEWEST_TIMES = 50
"""Times above `t_min` below which no power law is fitted (Clauset, Shalizi & Newman, SIAM Rev. 51 (2009) 661)."""
_DECIDED = 0.05
_CUTS = 100
"""Values of t_min that are tried, at most."""
_LARGEST_STRETCH = 5.0
"""Exponent of a stretched exponential, at most."""

Verdict = Literal["clogs", "flows", "undecided"]


@dataclass(frozen=True, eq=False)
class Survival:
    """Kaplan-Meier estimate of the probability that a value is larger than `x`, with its 95 % interval; shape [n]."""

    x: np.ndarray
    p: np.ndarray
    low: np.ndarray
    high: np.ndarray


def kaplan_meier(values: np.ndarray, ended: np.ndarray) -> Survival:
    """Survival function of values, of which some are censored from the right.

    Args:
        values: Sizes or times, shape [n].
        ended: True where the value is the whole, false where it is censored, shape [n].

    Returns:
        The estimate at every distinct value (Kaplan & Meier, J. Am. Stat. Assoc. 53 (1958) 457), with the interval of
        Greenwood in log-log scale.

    Raises:
        ValueError: No value.
    """
    import warnings

    values, ended = np.asarray(values, float), np.asarray(ended, bool)
    if not len(values):
        raise ValueError("a survival function needs at least one value")
    function = _survival_function(values, ended)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)  # of an interval that the data do not determine
        interval = function.confidence_interval(method="log-log")
    low, high = (np.asarray(end.probabilities, float) for end in (interval.low, interval.high))
    return Survival(np.asarray(function.quantiles, float), np.asarray(function.probabilities, float), low, high)


def _survival_function(values: np.ndarray, ended: np.ndarray) -> Any:
    """Kaplan-Meier estimate, as SciPy has it."""
    from scipy import stats

    return stats.ecdf(stats.CensoredData(values[ended], right=values[~ended])).sf


@dataclass(frozen=True, eq=False)
class Hazard:
    """Rate of ends within bins of size.

    Attributes:
        edges: Of the bins, shape [n + 1].
        rates: Ends in each bin over what passed in it.
        p: Probability of rates that differ by more, if the hazard is constant; NaN of a single bin.
    """

    edges: np.ndarray
    rates: tuple[PooledRate, ...]
    p: float


def hazard(values: np.ndarray, ended: np.ndarray, bins: int = 6) -> Hazard:
    """Hazard per unit of size, in bins with about equally many ends, and a test of its constancy.

    In a process without memory the hazard is constant. The test is that of homogeneity of Poisson counts with known
    exposures, by the likelihood ratio, whose deviance follows chi-square with bins - 1 degrees of freedom.

    Args:
        values: Sizes, such as the grains of each avalanche, shape [n].
        ended: True where the value is the whole, false where it is censored, shape [n].
        bins: Number of bins, at most; each has five ends or more.

    Returns:
        The rates in all bins.

    Raises:
        ValueError: No value above 0.
    """
    from scipy.special import chdtrc, xlogy

    values, ended = np.asarray(values, float), np.asarray(ended, bool)
    if not (len(values) and values.max() > 0):
        raise ValueError("a hazard needs values above 0")
    ends = values[ended]
    number = max(1, min(bins, len(ends) // 5))
    inner = np.quantile(ends, np.arange(1, number) / number) if number > 1 else np.array([])
    edges = np.unique([0.0, *inner, values.max()])
    passed = np.diff(np.minimum(values[:, None], edges[None, :]), axis=1).sum(axis=0)
    place = np.clip(np.searchsorted(edges, ends, "left") - 1, 0, len(edges) - 2)
    counts = np.bincount(place, minlength=len(edges) - 1)
    rates = tuple(rate(int(k), float(g)) for k, g in zip(counts, passed, strict=True))
    if len(rates) < 2:
        return Hazard(edges, rates, math.nan)
    expected = passed * counts.sum() / passed.sum()
    deviance = 2 * float(np.sum(xlogy(counts, counts / expected) - counts + expected))
    return Hazard(edges, rates, float(chdtrc(len(rates) - 1, max(deviance, 0.0))))


@dataclass(frozen=True)
class Correlation:
    """A correlation of `n` pairs with its 95 % interval by Fisher's z; NaN of fewer than four pairs."""

    value: float
    low: float
    high: float
    n: int


def _correlation(x: np.ndarray, y: np.ndarray) -> Correlation:
    n = len(x)
    if n < 4 or not (np.ptp(x) and np.ptp(y)):
        return Correlation(math.nan, math.nan, math.nan, n)
    r = float(np.corrcoef(x, y)[0, 1])
    z, reach = math.atanh(max(-1 + 1e-12, min(1 - 1e-12, r))), 1.96 / math.sqrt(n - 3)
    return Correlation(r, math.tanh(z - reach), math.tanh(z + reach), n)


def lag_correlation(series: Sequence[np.ndarray]) -> Correlation:
    """Correlation of ln s between consecutive avalanches of one silo, over all silos.

    Args:
        series: Sizes of the avalanches that ended, of each silo in the order of time; sizes of 0 count as 1/2.
    """
    logs = [np.log(np.maximum(np.asarray(sizes, float), 0.5)) for sizes in series]
    pairs = [(one[:-1], one[1:]) for one in logs if len(one) > 1]
    if not pairs:
        return Correlation(math.nan, math.nan, math.nan, 0)
    return _correlation(np.concatenate([a for a, _ in pairs]), np.concatenate([b for _, b in pairs]))


def rank_correlation(groups: Sequence[np.ndarray]) -> Correlation:
    """Rank correlation of values within groups: the intraclass correlation of their ranks among all.

    All ordered pairs within a group count, each value as often in groups of any size (Fisher's symmetric form); `n` is
    the number of values in groups of two or more, by which the interval is approximate.

    Args:
        groups: Values of each group, such as the first avalanches of all discharges of a packing.
    """
    from scipy.stats import rankdata

    sizes = [len(group) for group in groups]
    if sum(sizes) < 2:
        return Correlation(math.nan, math.nan, math.nan, 0)
    ranks = np.split(rankdata(np.concatenate([np.asarray(group, float) for group in groups])), np.cumsum(sizes)[:-1])
    several = [own for own in ranks if len(own) > 1]
    n = sum(map(len, several))
    if n < 4:
        return Correlation(math.nan, math.nan, math.nan, n)
    every = np.concatenate(several)
    middle, spread = every.mean(), every.var()
    if spread == 0:
        return Correlation(math.nan, math.nan, math.nan, n)
    products, pairs = 0.0, 0.0
    for own in several:
        apart = own - middle
        products += (apart.sum() ** 2 - (apart**2).sum()) / (len(own) - 1)
        pairs += len(own)
    r = float(products / pairs / spread)
    z, reach = math.atanh(max(-1 + 1e-12, min(1 - 1e-12, r))), 1.96 / math.sqrt(max(1, n / 2 - 1))
    return Correlation(r, math.tanh(z - reach), math.tanh(z + reach), n)


@dataclass(frozen=True)
class PowerTail:
    """Tail of times between grains: P(t >= T) = (T / t_min)^-(alpha - 1) above `t_min`.

    Attributes:
        alpha: Exponent of the probability density.
        low: Lower end of its interval.
        high: Upper end of its interval.
        t_min: Where the tail begins [s].
        n: Times above it whose end was observed.
        censored: Times above it that are censored.
        clogs: Probability of alpha <= 2, for which the mean time diverges.
        exponential: ln of the likelihood ratio to an exponential tail; above 0 the power law describes it better.
        stretched: The same to a stretched exponential, exp(-l (t^b - t_min^b)), whose limit of small b is the power
            law: never above 0, and below -2 a better description in spite of its further parameter.
    """

    alpha: float
    low: float
    high: float
    t_min: float
    n: int
    censored: int
    clogs: float
    exponential: float
    stretched: float

    @property
    def verdict(self) -> Verdict:
        """The state of the agitated silo: `undecided` where P(alpha <= 2) is between 0.05 and 0.95."""
        if self.clogs > 1 - _DECIDED:
            return "clogs"
        return "flows" if self.clogs < _DECIDED else "undecided"


def power_tail(times: np.ndarray, ended: np.ndarray, t_min: float | None = None, confidence: float = 0.95) -> PowerTail:
    """Power-law tail of times between grains of an agitated silo, of which some are censored.

    With n times observed and all of them, censored or not, in the sum, alpha = 1 + n / sum ln(t / t_min), and
    2 (alpha - 1) sum ln(t / t_min) follows chi-square with 2n degrees of freedom. Leaving out censored times would make
    alpha too large. `t_min` is that of the smallest Kolmogorov-Smirnov distance (Clauset, Shalizi & Newman, SIAM Rev.
    51 (2009) 661), here to the Kaplan-Meier estimate.

    Args:
        times: Between grains [s], shape [n].
        ended: True where a grain ended the time, false where it is censored, shape [n].
        t_min: Where the tail begins [s]; None: as above.
        confidence: Of the interval of alpha.

    Returns:
        The tail.

    Raises:
        ValueError: Fewer than FEWEST_TIMES observed times in the tail.
    """
    from scipy.special import chdtr, chdtri

    times, ended = np.asarray(times, float), np.asarray(ended, bool)
    if t_min is None:
        t_min = _best_cut(times, ended)
    tail = times >= t_min
    n, logs = int(ended[tail].sum()), np.log(times[tail] / t_min)
    total = float(logs.sum())
    if n < FEWEST_TIMES or not total > 0:
        raise ValueError(f"{n} times lie in the tail, and a power law needs {FEWEST_TIMES}; use longer or more runs")
    a = (1 - confidence) / 2
    alpha = 1 + n / total
    low, high = 1 + float(chdtri(2 * n, 1 - a)) / (2 * total), 1 + float(chdtri(2 * n + 2, a)) / (2 * total)
    power = n * math.log((alpha - 1) / t_min) - alpha * float(logs[ended[tail]].sum())
    power -= (alpha - 1) * float(logs[~ended[tail]].sum())
    exponential, stretched = (
        power - _stretched(logs, ended[tail], b) + n * math.log(t_min) for b in (1.0, _best_stretch(logs, ended[tail]))
    )
    clogs = float(chdtr(2 * n, 2 * total))
    return PowerTail(alpha, low, high, t_min, n, int((~ended[tail]).sum()), clogs, exponential, min(stretched, 0.0))


def tail_goodness(times: np.ndarray, ended: np.ndarray, tail: PowerTail, draws: int = 200, seed: int = 0) -> float:
    """Probability that a power law gives a tail farther from its fit than this one, by parametric bootstrap.

    The distance is that of Kolmogorov and Smirnov between the Kaplan-Meier estimate and the fit. In each draw the
    observed times above `t_min` come from the fitted law; those that are censored stay. `t_min` stays too. Where it was
    chosen for the smallest distance, the probability is too large: a small one rules out the power law, a large one
    proves nothing (Clauset, Shalizi & Newman, SIAM Rev. 51 (2009) 661).

    Args:
        times: Between grains [s], shape [n], as given to `power_tail`.
        ended: True where a grain ended the time, shape [n].
        tail: Its fit.
        draws: Number of samples.
        seed: Of the samples.
    """
    inside = np.asarray(times, float) >= tail.t_min
    above, over = np.asarray(times, float)[inside], np.asarray(ended, bool)[inside]

    def distance(sample: np.ndarray) -> float:
        function = _survival_function(sample, over)
        return _distance(sample, over, tail.t_min, function.quantiles, function.probabilities)

    own, rng, farther = distance(above), np.random.default_rng(seed), 0
    for _ in range(draws):
        sample = above.copy()
        sample[over] = tail.t_min * rng.random(tail.n) ** (-1 / (tail.alpha - 1))
        farther += distance(sample) >= own
    return farther / draws


def _stretched(logs: np.ndarray, ended: np.ndarray, b: float) -> float:
    """ln of the largest likelihood of a stretched exponential tail with the exponent b, of t/t_min.

    Args:
        logs: ln(t/t_min), shape [n].
        ended: False where the time is censored, shape [n].
        b: Exponent; the rate l is the best one.
    """
    n = int(ended.sum())
    return n * math.log(n * b / float(np.expm1(b * logs).sum())) + (b - 1) * float(logs[ended].sum()) - n


def _best_stretch(logs: np.ndarray, ended: np.ndarray) -> float:
    """Exponent of the stretched exponential tail with the largest likelihood."""
    from scipy.optimize import minimize_scalar

    highest = min(_LARGEST_STRETCH, 500 / float(logs.max()))
    lowest = minimize_scalar(lambda b: -_stretched(logs, ended, b), bounds=(1e-4, highest), method="bounded")
    return float(lowest.x)  # pyright: ignore[reportAttributeAccessIssue]


def _best_cut(times: np.ndarray, ended: np.ndarray) -> float:
    """t_min [s] with the smallest distance between the tail and its power law."""
    observed = np.sort(times[ended & (times > 0)])
    candidates = np.unique(observed)
    enough = candidates[len(observed) - np.searchsorted(observed, candidates) >= FEWEST_TIMES]
    if not len(enough):
        few = len(observed)
        raise ValueError(f"{few} times were observed, and a power law needs {FEWEST_TIMES}; use longer or more runs")
    cuts = enough[np.unique(np.linspace(0, len(enough) - 1, min(_CUTS, len(enough))).round().astype(int))]
    function = _survival_function(times, ended)

    def distance(cut: float) -> float:
        above, first = times >= cut, int(np.searchsorted(function.quantiles, cut))
        before = function.probabilities[first - 1] if first else 1.0  # the tail has the estimate of all, over that
        return _distance(
            times[above], ended[above], cut, function.quantiles[first:], function.probabilities[first:] / before
        )

    return float(min(cuts, key=distance))


def _distance(times: np.ndarray, ended: np.ndarray, cut: float, x: np.ndarray, p: np.ndarray) -> float:
    """Largest distance between the estimate p of the survival at x of times above a cut [s], and the power law fitted
    to these times."""
    total = float(np.log(times / cut).sum())
    if not total > 0:
        return math.inf
    law, before = (x / cut) ** -(ended.sum() / total), np.concatenate([[1.0], p[:-1]])
    return float(max(np.abs(law - p).max(), np.abs(law - before).max()))


def flowing_fraction(flowing: float, stopped: float) -> float:
    """Part of the time in which grains leave: <t_f> / (<t_f> + <t_c>), of the times of all flows and of all stops."""
    return flowing / (flowing + stopped)
