"""Survival of avalanches and of times between grains, with censored values whose end was not observed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from labbook.stats.rates import PooledRate, rate

FEWEST_TIMES = 50
"""Fewest times above `t_min` for a power law (Clauset, Shalizi & Newman, SIAM Rev. 51 (2009) 661)."""
_DECIDED = 0.05
_CUTS = 100
"""Largest number of trial values of t_min."""
_LARGEST_STRETCH = 5.0
"""Largest exponent of a stretched exponential."""

Verdict = Literal["clogs", "flows", "undecided"]


@dataclass(frozen=True, eq=False)
class Survival:
    """Kaplan-Meier estimate of the probability that a value is larger than `x`, with its 95 % interval; shape [n]."""

    x: np.ndarray
    p: np.ndarray
    low: np.ndarray
    high: np.ndarray


def kaplan_meier(values: np.ndarray, ended: np.ndarray) -> Survival:
    """Estimate the survival function of values, some of which are censored from the right.

    Args:
        values: Sizes or times, shape [n].
        ended: True where the value is complete, false where it is censored, shape [n].

    Returns:
        The estimate at every distinct value (Kaplan & Meier, J. Am. Stat. Assoc. 53 (1958) 457), with the interval of
        Greenwood in log-log scale.

    Raises:
        ValueError: There is no value.
    """
    import warnings

    values, ended = np.asarray(values, float), np.asarray(ended, bool)
    if not len(values):
        raise ValueError("a survival function needs at least one value")
    function = _survival_function(values, ended)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)  # Greenwood's variance is undefined at a survival of 0 or 1
        interval = function.confidence_interval(method="log-log")
    low, high = (np.asarray(end.probabilities, float) for end in (interval.low, interval.high))
    return Survival(np.asarray(function.quantiles, float), np.asarray(function.probabilities, float), low, high)


def _survival_function(values: np.ndarray, ended: np.ndarray) -> Any:
    """Kaplan-Meier estimate of SciPy."""
    from scipy import stats

    return stats.ecdf(stats.CensoredData(values[ended], right=values[~ended])).sf


@dataclass(frozen=True, eq=False)
class Hazard:
    """Hazard within bins of size: rate of ends.

    Attributes:
        edges: Edges of the bins, shape [n + 1].
        rates: Ends in each bin over the exposure in it.
        p: Probability of rates that differ by more, if the hazard is constant; NaN for a single bin.
    """

    edges: np.ndarray
    rates: tuple[PooledRate, ...]
    p: float


def hazard(values: np.ndarray, ended: np.ndarray, bins: int = 6) -> Hazard:
    """Compute the hazard per unit of size, in bins with about equally many ends, and test its constancy.

    The hazard of a process without memory is constant. The test is that of homogeneity of Poisson counts with known
    exposures, by the likelihood ratio, whose deviance follows chi-square with bins - 1 degrees of freedom.

    Args:
        values: Sizes, such as the grains of each avalanche, shape [n].
        ended: True where the value is complete, false where it is censored, shape [n].
        bins: Largest number of bins; each has five ends or more.

    Returns:
        The rates in all bins, with the p-value of the test.

    Raises:
        ValueError: There is no value above 0.
    """
    from scipy.special import chdtrc, xlogy

    values, ended = np.asarray(values, float), np.asarray(ended, bool)
    if not (len(values) and values.max() > 0):
        raise ValueError("a hazard needs values above 0")
    ends = values[ended]
    number = max(1, min(bins, len(ends) // 5))  # chi-square needs some five expected counts in each bin
    inner = np.quantile(ends, np.arange(1, number) / number) if number > 1 else np.array([])
    edges = np.unique([0.0, *inner, values.max()])
    # exposure of a bin: each value counts by the part of it that lies in the bin
    passed = np.diff(np.minimum(values[:, None], edges[None, :]), axis=1).sum(axis=0)
    bin_index = np.clip(np.searchsorted(edges, ends, "left") - 1, 0, len(edges) - 2)
    counts = np.bincount(bin_index, minlength=len(edges) - 1)
    rates = tuple(rate(int(k), float(g)) for k, g in zip(counts, passed, strict=True))
    if len(rates) < 2:
        return Hazard(edges, rates, math.nan)
    expected = passed * counts.sum() / passed.sum()
    deviance = 2 * float(np.sum(xlogy(counts, counts / expected) - counts + expected))
    return Hazard(edges, rates, float(chdtrc(len(rates) - 1, max(deviance, 0.0))))


@dataclass(frozen=True)
class Correlation:
    """Correlation of `n` pairs with its 95 % interval by Fisher's z; NaN for fewer than four pairs."""

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
    """Compute the correlation of ln s between consecutive avalanches of one silo, over all silos.

    Args:
        series: Sizes of the complete avalanches of each silo, in the order of time; sizes of 0 count as 1/2.
    """
    logs = [np.log(np.maximum(np.asarray(sizes, float), 0.5)) for sizes in series]
    pairs = [(sizes[:-1], sizes[1:]) for sizes in logs if len(sizes) > 1]
    if not pairs:
        return Correlation(math.nan, math.nan, math.nan, 0)
    return _correlation(np.concatenate([a for a, _ in pairs]), np.concatenate([b for _, b in pairs]))


def rank_correlation(groups: Sequence[np.ndarray]) -> Correlation:
    """Compute the rank correlation within groups: the intraclass correlation of the ranks of values among all.

    All ordered pairs within a group count, and each value has the same weight in groups of any size (Fisher's symmetric
    form). `n` is the number of values in groups of two or more; the interval based on it is approximate.

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
    """Power-law tail of times between grains: P(t >= T) = (T / t_min)^-(alpha - 1) above `t_min`.

    Attributes:
        alpha: Exponent of the probability density.
        low: Lower end of its interval.
        high: Upper end of its interval.
        t_min: Start of the tail [s].
        n: Observed times in the tail.
        censored: Censored times in the tail.
        clogs: Probability of alpha <= 2, for which the mean time diverges.
        exponential: ln of the likelihood ratio to an exponential tail; positive if the power law is better.
        stretched: The same to a stretched exponential, exp(-l (t^b - t_min^b)), whose limit of small b is the power
            law. It is never positive; below -2 the stretched one is better in spite of its further parameter.
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
        """State of the agitated silo; `undecided` if P(alpha <= 2) is between 0.05 and 0.95."""
        if self.clogs > 1 - _DECIDED:
            return "clogs"
        return "flows" if self.clogs < _DECIDED else "undecided"


def power_tail(times: np.ndarray, ended: np.ndarray, t_min: float | None = None, confidence: float = 0.95) -> PowerTail:
    """Fit the power-law tail of times between grains of an agitated silo, some of which are censored.

    With n observed times, and all times, censored or not, in the sum, alpha = 1 + n / sum ln(t / t_min), and
    2 (alpha - 1) sum ln(t / t_min) follows chi-square with 2n degrees of freedom. Without the censored times alpha
    would be too large. `t_min` minimises the Kolmogorov-Smirnov distance (Clauset, Shalizi & Newman, SIAM Rev. 51
    (2009) 661), here to the Kaplan-Meier estimate.

    Args:
        times: Times between grains [s], shape [n].
        ended: True where a grain ended the time, false where it is censored, shape [n].
        t_min: Start of the tail [s]; None: as above.
        confidence: Confidence of the interval of alpha.

    Returns:
        The tail.

    Raises:
        ValueError: There are fewer than FEWEST_TIMES observed times in the tail.
    """
    from scipy.special import chdtr, chdtri

    times, ended = np.asarray(times, float), np.asarray(ended, bool)
    if t_min is None:
        t_min = _best_cut(times, ended)
    tail = times >= t_min
    # censored times add to the sum of logarithms and not to n: leaving them out would make alpha too large
    n, logs = int(ended[tail].sum()), np.log(times[tail] / t_min)
    total = float(logs.sum())
    if n < FEWEST_TIMES or not total > 0:
        raise ValueError(f"{n} times lie in the tail, and a power law needs {FEWEST_TIMES}; use longer or more runs")
    a = (1 - confidence) / 2
    alpha = 1 + n / total
    low, high = 1 + float(chdtri(2 * n, 1 - a)) / (2 * total), 1 + float(chdtri(2 * n + 2, a)) / (2 * total)
    power = n * math.log((alpha - 1) / t_min) - alpha * float(logs[ended[tail]].sum())
    power -= (alpha - 1) * float(logs[~ended[tail]].sum())
    # both likelihoods are those of t; `_stretched` is that of t/t_min, hence the Jacobian n ln(t_min)
    exponential, stretched = (
        power - _stretched(logs, ended[tail], b) + n * math.log(t_min) for b in (1.0, _best_stretch(logs, ended[tail]))
    )
    clogs = float(chdtr(2 * n, 2 * total))
    return PowerTail(alpha, low, high, t_min, n, int((~ended[tail]).sum()), clogs, exponential, min(stretched, 0.0))


def tail_goodness(times: np.ndarray, ended: np.ndarray, tail: PowerTail, draws: int = 200, seed: int = 0) -> float:
    """Compute the goodness of fit of a power-law tail by parametric bootstrap.

    The statistic is the Kolmogorov-Smirnov distance between the Kaplan-Meier estimate and the fit. In each draw the
    observed times above `t_min` come from the fitted law; censored times and `t_min` stay. If `t_min` was chosen for
    the smallest distance, the probability is too large: a small one rules out the power law, a large one proves nothing
    (Clauset, Shalizi & Newman, SIAM Rev. 51 (2009) 661).

    Args:
        times: Times between grains [s], shape [n], as given to `power_tail`.
        ended: True where a grain ended the time, shape [n].
        tail: Fit of the tail.
        draws: Number of samples.
        seed: Seed of the samples.

    Returns:
        Probability of a tail farther from its fit than this one, if the power law holds.
    """
    inside = np.asarray(times, float) >= tail.t_min
    above, stopped = np.asarray(times, float)[inside], np.asarray(ended, bool)[inside]

    def distance(sample: np.ndarray) -> float:
        function = _survival_function(sample, stopped)
        return _distance(sample, stopped, tail.t_min, function.quantiles, function.probabilities)

    own, rng, farther = distance(above), np.random.default_rng(seed), 0
    for _ in range(draws):
        sample = above.copy()
        sample[stopped] = tail.t_min * rng.random(tail.n) ** (-1 / (tail.alpha - 1))
        farther += distance(sample) >= own
    return farther / draws


def _stretched(logs: np.ndarray, ended: np.ndarray, b: float) -> float:
    """ln of the largest likelihood of a stretched exponential tail of t/t_min, with the exponent b.

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

    highest = min(_LARGEST_STRETCH, 500 / float(logs.max()))  # (t/t_min)^b must not overflow
    lowest = minimize_scalar(lambda b: -_stretched(logs, ended, b), bounds=(1e-4, highest), method="bounded")
    return float(lowest.x)  # pyright: ignore[reportAttributeAccessIssue]


def _best_cut(times: np.ndarray, ended: np.ndarray) -> float:
    """t_min [s] with the smallest distance between the tail and its power law."""
    observed = np.sort(times[ended & (times > 0)])
    candidates = np.unique(observed)
    long_enough = candidates[len(observed) - np.searchsorted(observed, candidates) >= FEWEST_TIMES]
    if not len(long_enough):
        few = len(observed)
        raise ValueError(f"{few} times were observed, and a power law needs {FEWEST_TIMES}; use longer or more runs")
    # by rank, not by time: the tail is sparse, and times of a power law span decades
    cuts = long_enough[
        np.unique(np.linspace(0, len(long_enough) - 1, min(_CUTS, len(long_enough))).round().astype(int))
    ]
    function = _survival_function(times, ended)

    def distance(cut: float) -> float:
        above, first = times >= cut, int(np.searchsorted(function.quantiles, cut))
        before = function.probabilities[first - 1] if first else 1.0  # the tail has the estimate of all, over that
        return _distance(
            times[above], ended[above], cut, function.quantiles[first:], function.probabilities[first:] / before
        )

    return float(min(cuts, key=distance))


def _distance(times: np.ndarray, ended: np.ndarray, cut: float, x: np.ndarray, p: np.ndarray) -> float:
    """Largest distance between a survival estimate and the power law fitted to the times.

    Args:
        times: Times above the cut [s].
        ended: True where a grain ended the time.
        cut: Start of the tail [s].
        x: Times of the steps of the estimate [s].
        p: Survival after each step.
    """
    total = float(np.log(times / cut).sum())
    if not total > 0:
        return math.inf
    # a step function is farthest from a smooth one at its steps: before and after each
    law, before = (x / cut) ** -(ended.sum() / total), np.concatenate([[1.0], p[:-1]])
    return float(max(np.abs(law - p).max(), np.abs(law - before).max()))


def flowing_fraction(flowing: float, stopped: float) -> float:
    """Part of the time in which grains leave: <t_f> / (<t_f> + <t_c>), of the times of all flows and all stops."""
    return flowing / (flowing + stopped)
