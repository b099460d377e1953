"""Rates of stops and survival of avalanches: coverage on data made from the law, with censoring; and closed forms."""

import math

import numpy as np
import pytest

from labbook.stats.rates import clustered, events_needed, rate
from labbook.stats.survival import (
    FEWEST_TIMES,
    flowing_fraction,
    hazard,
    kaplan_meier,
    lag_correlation,
    power_tail,
    rank_correlation,
    tail_goodness,
)

REPEATS = 500
NEAR = 3.3 * math.sqrt(0.95 * 0.05 / REPEATS)
"""A coverage of 95 % is measured this well, but for one time in a thousand."""


def avalanches(rng, mean, silos, limit):
    """Sizes of `silos` first avalanches with a stop after each grain with probability 1 / mean, cut at `limit`."""
    sizes = rng.geometric(1 / mean, silos)
    return np.minimum(sizes, limit), sizes <= limit


@pytest.mark.parametrize("mean", [300, 3000])
def test_the_interval_of_a_rate_covers_with_censoring(mean):
    """The Garwood interval is exact or wider; at 25 stops it covers 96.5 % at most."""
    rng, held = np.random.default_rng(mean), 0
    for _ in range(REPEATS):
        sizes, ended = avalanches(rng, mean, 64, 1500)
        found = rate(int(ended.sum()), float(sizes.sum()))
        held += found.low <= 1 / mean <= found.high
    assert 0.95 - NEAR < held / REPEATS < 0.97 + NEAR


def test_ends_of_an_interval_are_those_of_published_tables():
    """Garwood's limits of a Poisson count: 0 gives 0 to 3.69, 1 gives 0.025 to 5.57, 10 gives 4.80 to 18.39."""
    for count, low, high in ((0, 0.0, 3.689), (1, 0.0253, 5.572), (10, 4.795, 18.390)):
        found = rate(count, 1.0)
        assert (found.low, found.high) == (pytest.approx(low, abs=5e-4), pytest.approx(high, abs=5e-4))
        assert found.bound == (count == 0)
    assert rate(10, 100.0).value == 0.1
    with pytest.raises(ValueError, match="exposure above 0"):
        rate(0, 0.0)


def test_stops_that_an_error_needs():
    """(1.96 / 0.2)^2 = 96.04."""
    assert events_needed(0.2) == 97
    assert events_needed(0.1) == 385


def test_a_bootstrap_over_packings_sees_what_they_have_in_common():
    """Packings with hazards of their own: the exact interval, which takes grains as independent, is too narrow."""
    rng, held, exact = np.random.default_rng(5), 0, 0
    for _ in range(100):
        hazards = 1e-2 * rng.choice([0.4, 1.6], 40)
        stops = rng.poisson(hazards * 2000)
        low, high = clustered(stops, np.full(40, 2000.0))
        held += low <= 1e-2 <= high
        plain = rate(int(stops.sum()), 80_000.0)
        exact += plain.low <= 1e-2 <= plain.high
    assert held / 100 > 0.86, "percentiles of 40 clusters are a little too narrow"
    assert exact / 100 < 0.6
    assert all(map(math.isnan, clustered([3], [100.0])))


def test_the_hazard_of_a_flow_without_memory_is_constant_and_a_growing_one_is_seen():
    rng = np.random.default_rng(8)
    p = [hazard(*avalanches(rng, 100, 200, 400)).p for _ in range(300)]
    assert 0.01 < np.mean(np.array(p) < 0.05) < 0.10
    aging = np.ceil(100 * rng.weibull(2.0, 200))
    found = hazard(aging, np.ones(200, bool))
    assert found.p < 1e-6
    assert found.rates[0].value < found.rates[-1].value
    assert sum(one.events for one in found.rates) == 200
    assert sum(one.exposure for one in found.rates) == pytest.approx(aging.sum())
    assert math.isnan(hazard(np.array([5.0]), np.array([False])).p)


def test_survival_of_censored_values_is_that_of_the_law():
    """At half of the mean, far from the limit; four standard errors."""
    rng = np.random.default_rng(3)
    sizes, ended = avalanches(rng, 200, 2000, 300)
    found = kaplan_meier(sizes, ended)
    at = np.searchsorted(found.x, 100, "right") - 1
    true = (1 - 1 / 200) ** 100
    assert found.p[at] == pytest.approx(true, abs=4 * math.sqrt(true * (1 - true) / 2000))
    assert found.low[at] < true < found.high[at]
    assert found.p.min() > 0, "those that are censored have survived"


@pytest.mark.parametrize("alpha", [1.6, 2.0, 2.5])
def test_the_exponent_of_censored_times_is_covered(alpha):
    rng, held, dropped = np.random.default_rng(11), 0, []
    for _ in range(REPEATS):
        times = rng.random(200) ** (-1 / (alpha - 1))
        limit = 0.12 ** (-1 / (alpha - 1))
        found = power_tail(np.minimum(times, limit), times <= limit, 1.0)
        held += found.low <= alpha <= found.high
        kept = times[times <= limit]
        dropped.append(power_tail(kept, np.ones(len(kept), bool), 1.0).alpha)
    assert 0.92 < held / REPEATS < 0.98
    assert np.mean(dropped) > alpha + 0.1, "without its longest times a tail looks steeper"


def test_the_tail_is_found_and_the_transition_is_undecided_near_two():
    rng = np.random.default_rng(2)

    def times(alpha):
        return np.concatenate([rng.uniform(0, 1, 300), rng.random(400) ** (-1 / (alpha - 1))])

    verdicts = {}
    for alpha in (1.5, 2.02, 3.0):
        found = power_tail(times(alpha), np.ones(700, bool))
        assert 0.5 < found.t_min < 2.5
        assert found.alpha == pytest.approx(alpha, abs=4 * (alpha - 1) / math.sqrt(found.n))
        verdicts[alpha] = found.verdict
    assert verdicts == {1.5: "clogs", 2.02: "undecided", 3.0: "flows"}
    assert power_tail(times(1.5), np.ones(700, bool)).exponential > 10
    assert power_tail(1 + rng.exponential(size=400), np.ones(400, bool), 1.0).exponential < -10
    with pytest.raises(ValueError, match=f"needs {FEWEST_TIMES}"):
        power_tail(np.arange(1.0, 40.0), np.ones(39, bool))


def test_a_stretched_exponential_tail_is_told_from_a_power_law():
    """Of a power law twice the ratio follows half of chi-square with one degree of freedom, as at any boundary; 10 is
    beyond it once in a thousand."""
    rng = np.random.default_rng(11)
    power = power_tail(rng.random(1000) ** -1.0, np.ones(1000, bool), 1.0)
    assert -5 < power.stretched <= 0
    b, rate = 0.5, 2.0
    times = (1 + rng.exponential(size=1000) / rate) ** (1 / b)
    stretched = power_tail(times, np.ones(1000, bool), 1.0)
    assert stretched.stretched < -10
    plain = 1 + rng.exponential(size=400)
    found = power_tail(plain, np.ones(400, bool), 1.0)
    assert found.stretched <= found.exponential, "an exponential is one of them"
    length = float((plain - 1).sum())
    log_power = 400 * math.log(found.alpha - 1) - found.alpha * float(np.log(plain).sum())
    assert found.exponential == pytest.approx(log_power - (400 * math.log(400 / length) - 400))


def test_gaps_that_are_too_long_for_the_power_law_leave_it_undecided():
    """The probability of the longest time is uniform for power laws: 15 of 300 below 0.05, give or take 3.8. Two gaps
    of 2000 t_min among 600 times with alpha = 2.8, of which 2000^-1.8 = 10^-6 are as long, change alpha little; the
    distance of Kolmogorov and Smirnov does not see them."""
    rng = np.random.default_rng(5)
    drawn = [rng.random(100) ** -1.0 for _ in range(300)]
    longest = np.array([power_tail(times, np.ones(100, bool), 1.0).longest for times in drawn])
    assert np.mean(longest < 0.05) == pytest.approx(0.05, abs=0.04)
    assert np.mean(longest) == pytest.approx(0.5, abs=0.06)
    times = rng.random(600) ** (-1 / 1.8)
    ended = np.ones(602, bool)
    assert power_tail(times, ended[:600], 1.0).verdict == "flows"
    gaps = np.append(times, [2000.0, 2000.0])
    found = power_tail(gaps, ended, 1.0)
    assert found.alpha > 2.6
    assert tail_goodness(gaps, ended, found, 100) > 0.1
    assert found.longest < 0.01
    assert found.verdict == "undecided"


@pytest.mark.slow
def test_the_goodness_of_a_tail_is_uniform_for_power_laws_and_small_for_others():
    """The mean of 60 uniform numbers is 0.5 +- 0.037; one time of sixty is censored."""
    rng, found = np.random.default_rng(8), []
    for _ in range(60):
        times = rng.random(150) ** (-1 / 1.2)
        ended = times < 30
        times = np.minimum(times, 30.0)
        found.append(tail_goodness(times, ended, power_tail(times, ended, 1.0), 60))
    assert np.mean(found) == pytest.approx(0.5, abs=0.12)
    assert 0.02 < np.mean(np.array(found) < 0.1) < 0.22
    exponential, ended = 1 + rng.exponential(size=400), np.ones(400, bool)
    assert tail_goodness(exponential, ended, power_tail(exponential, ended, 1.0), 100) < 0.05


def test_correlations_of_avalanches():
    rng = np.random.default_rng(4)
    alone = lag_correlation([rng.geometric(0.01, 30) for _ in range(10)])
    assert alone.low < 0 < alone.high
    assert alone.n == 290
    walks = [np.exp(np.cumsum(rng.normal(size=30))) for _ in range(10)]
    assert lag_correlation(walks).low > 0.5
    assert rank_correlation([rng.geometric(0.01, 4) for _ in range(32)]).value == pytest.approx(0, abs=0.25)
    common = [rng.exponential(100) * rng.uniform(0.9, 1.1, 4) for _ in range(32)]
    assert rank_correlation(common).value > 0.8
    assert math.isnan(rank_correlation([np.array([3.0])]).value)
    assert flowing_fraction(3.0, 1.0) == 0.75
