import math

import numpy as np
import pytest
from scipy import stats

from labbook.stats import Decision, StoppingRule, pool


def run_to_the_end(rule, values):
    n = 0
    while True:
        decision = rule.decide(values[:n])
        if decision.additional == 0:
            return n, decision
        assert decision.ended is None
        n += decision.additional


def test_runs_the_minimum_and_stops_when_precise():
    n, decision = run_to_the_end(StoppingRule(0.1, 3, 10), [1.0, 1.001, 0.999, 1.0, 1.001] + [5.0] * 5)
    assert (n, decision.ended) == (5, "tolerance")
    assert decision.pooled is not None
    assert decision.pooled.relative <= 0.1


def test_stops_at_the_cap_and_says_so():
    n, decision = run_to_the_end(StoppingRule(0.001, 3, 6), [1.0, 1.5, 0.7, 1.2, 0.8, 1.1, 1.0])
    assert (n, decision.ended) == (6, "cap")
    assert decision.pooled is not None
    assert decision.pooled.relative > 0.001


def test_without_a_tolerance_the_minimum_is_run():
    n, decision = run_to_the_end(StoppingRule(None, 2, 10), [1.0, 3.0, 9.0])
    assert (n, decision.ended) == (2, None)
    assert decision.pooled == pool([1.0, 3.0])


def test_replicates_without_any_value_are_given_up():
    rule = StoppingRule(0.05, 2, 100)
    assert rule.decide([]) == Decision(None, 5, None)
    assert rule.decide([], without=5) == Decision(None, 1, None)
    assert rule.decide([], without=6) == Decision(None, 0, "nothing")
    assert rule.decide([1.0], without=9).additional == 4
    assert StoppingRule(0.05, 2, 4).decide([], without=4) == Decision(None, 0, "cap")
    assert StoppingRule(0.05, 2, 10).decide([1.0, 2.0], without=8).ended == "cap"


def test_fewer_than_five_replicates_are_too_few_to_judge_by():
    assert StoppingRule(0.5, 2, 10).decide([1.0, 1.0]).additional == 3
    assert StoppingRule(0.5, 4, 10).decide([1.0, 1.0, 1.0, 1.0]).additional == 1
    assert StoppingRule(0.5, 2, 4).decide([1.0, 1.0]).additional == 2, "as many as the cap allows"
    assert StoppingRule(0.5, 2, 2).decide([1.0, 1.0]).ended == "tolerance"


def test_a_cap_at_the_minimum_leaves_nothing_to_decide():
    assert not StoppingRule(0.01, 3, 5).sequential
    rule = StoppingRule(0.01, 3, 3)
    assert not rule.sequential
    assert rule.pool([1.0, 1.1, 1.3]) == pool([1.0, 1.1, 1.3])


def test_the_interval_is_wider_than_a_fixed_samples():
    values = [1.0, 1.1, 1.3, 1.2]
    assert StoppingRule(0.01, 3, 9).pool(values).half_width == pytest.approx(pool(values).half_width * (1 + 1.25 / 4))


def test_few_replicates_are_ordered_at_a_time():
    rng = np.random.default_rng(0)
    rule = StoppingRule(1e-4, 3, 50)
    for n in range(5, 50):
        assert 1 <= rule.decide(rng.normal(1, 0.5, n)).additional <= max(1, n // 3)


@pytest.mark.parametrize(
    ("tolerance", "minimum", "cap"),
    [(0, 3, 5), (-1, 3, 5), (math.nan, 3, 5), (math.inf, 3, 5), (0.1, 0, 5), (0.1, 6, 5)],
)
def test_impossible_rules_are_refused(tolerance, minimum, cap):
    with pytest.raises(ValueError):
        StoppingRule(tolerance, minimum, cap)


def test_the_forecast_is_the_number_at_which_an_interval_of_that_scatter_meets_the_tolerance():
    rule = StoppingRule(tolerance=0.01, minimum=3, cap=200)
    n = rule.forecast(0.02)

    def width(n):
        return stats.t.ppf(0.975, n - 1) * 0.02 / np.sqrt(n) * (1 + 1.25 / n)

    assert width(n) <= 0.01 < width(n - 1)
    assert StoppingRule(tolerance=0.001, minimum=3, cap=50).forecast(0.02) == 50
    assert StoppingRule(tolerance=None, minimum=3, cap=3).forecast(0.02) == 3
