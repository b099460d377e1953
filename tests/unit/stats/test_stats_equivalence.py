import math

import numpy as np
import pytest
from scipy import stats

from labbook.stats.equivalence import replicates_needed, tost, tost_power


def test_welch_p_is_that_of_two_scipy_tests():
    rng = np.random.default_rng(0)
    a, b, margin = rng.normal(10, 0.3, 5), rng.normal(10.1, 0.6, 7), 0.8
    result = tost(a, b, margin)
    _, upper = stats.ttest_ind(b - margin, a, equal_var=False, alternative="less")
    _, lower = stats.ttest_ind(b + margin, a, equal_var=False, alternative="greater")
    assert result.p == pytest.approx(np.max([upper, lower]), rel=1e-10)


def test_paired_p_is_that_of_two_scipy_tests():
    rng = np.random.default_rng(1)
    a = rng.normal(10, 2, 6)
    b = a + rng.normal(0.02, 0.1, 6)
    result = tost(a, b, 0.15, paired=True)
    _, upper = stats.ttest_rel(b - 0.15, a, alternative="less")
    _, lower = stats.ttest_rel(b + 0.15, a, alternative="greater")
    assert result.p == pytest.approx(max(upper, lower), rel=1e-10)
    assert result.degrees_of_freedom == 5


def test_pairing_helps_where_seeds_differ():
    rng = np.random.default_rng(2)
    a = rng.normal(10, 2, 6)
    b = a + rng.normal(0, 0.05, 6)
    assert tost(a, b, 0.2, paired=True).equivalent
    assert not tost(a, b, 0.2).equivalent


def test_equivalent_exactly_if_the_interval_lies_within_the_margin():
    rng = np.random.default_rng(3)
    seen = set()
    for _ in range(300):
        result = tost(rng.normal(0, 1, 4), rng.normal(0, 1, 4), 1.8)
        inside = result.low > -1.8 and result.high < 1.8
        assert result.equivalent == inside
        seen.add(inside)
    assert seen == {True, False}


def test_false_equivalence_is_as_rare_as_asked():
    rng = np.random.default_rng(4)
    found = [tost(rng.normal(0, 1, 8), rng.normal(1.5, 1, 8), 1.5).equivalent for _ in range(4000)]
    assert np.mean(found) == pytest.approx(0.05, abs=0.015)


PAIRS, DRAWS = 6, 4000


def pairs(rng, difference, scatter):
    """Two samples that share what their seeds have in common, which is much more than they differ by."""
    seeds = rng.normal(10, 2, PAIRS)
    return seeds + rng.normal(0, scatter, PAIRS), seeds + rng.normal(difference, scatter, PAIRS)


@pytest.mark.parametrize("sign", [-1, 1])
def test_pairs_that_differ_by_the_margin_are_rarely_found_equivalent(sign):
    """The size of the test: alpha where one of its two hypotheses is true and the other far away."""
    rng, margin = np.random.default_rng(6), 0.6
    found = [tost(*pairs(rng, sign * margin, 0.1), margin, paired=True).equivalent for _ in range(DRAWS)]
    assert np.mean(found) == pytest.approx(0.05, abs=4 * math.sqrt(0.05 * 0.95 / DRAWS))


def test_the_interval_of_pairs_covers_the_true_difference_nine_times_in_ten():
    rng, covered = np.random.default_rng(7), 0
    for _ in range(DRAWS):
        result = tost(*pairs(rng, 0.2, 0.1), 0.6, paired=True)
        covered += result.low <= 0.2 <= result.high
    assert covered / DRAWS == pytest.approx(0.9, abs=4 * math.sqrt(0.9 * 0.1 / DRAWS))


@pytest.mark.parametrize("margin", [0.15, 0.2, 0.3])
def test_pairs_without_a_difference_are_found_equivalent_as_often_as_the_power_says(margin):
    rng, scatter = np.random.default_rng(8), 0.1
    found = [tost(*pairs(rng, 0.0, scatter), margin, paired=True).equivalent for _ in range(DRAWS)]
    expected = tost_power(margin / (scatter * math.sqrt(2 / PAIRS)), PAIRS - 1)
    assert 0.3 < expected < 1
    assert np.mean(found) == pytest.approx(expected, abs=4 * math.sqrt(0.25 / DRAWS))


def test_the_replicates_needed_are_the_fewest_that_give_the_power():
    rng = np.random.default_rng(9)
    a = rng.normal(10, 2, PAIRS)
    found = tost(a, a + rng.normal(0, 0.2, PAIRS), 0.15, paired=True)
    scatter = found.error * math.sqrt(PAIRS)
    needed = replicates_needed(found, PAIRS)
    assert needed is not None
    for n, enough in ((needed, True), (needed - 1, False)):
        draws = rng.normal(0, scatter, (20_000, n))
        t = stats.t.ppf(0.95, n - 1)
        shown = np.abs(draws.mean(axis=1)) + t * draws.std(axis=1, ddof=1) / math.sqrt(n) < 0.15
        assert (shown.mean() > 0.9 - 0.01) if enough else (shown.mean() < 0.9 + 0.01)


def test_replicates_beyond_reason_are_not_counted():
    assert replicates_needed(tost([1.0, 2, 3], [1.0, 3, 2], 1e-3, paired=True), 3) is None


@pytest.mark.parametrize("freedom", [2, 4, 16])
@pytest.mark.parametrize("margin", [2.0, 3.5, 6.0])
def test_power_is_that_of_a_simulation(freedom, margin):
    rng = np.random.default_rng(5)
    draws = 200_000
    z, q = rng.standard_normal(draws), np.sqrt(rng.chisquare(freedom, draws) / freedom)
    shown = np.abs(z) < margin - stats.t.ppf(0.95, freedom) * q
    assert tost_power(margin, freedom) == pytest.approx(shown.mean(), abs=0.005)


def test_power_with_known_error_is_the_normal_one():
    expected = 2 * stats.norm.cdf(3.0 - stats.norm.ppf(0.95)) - 1
    assert tost_power(3.0, 1e6) == pytest.approx(expected, abs=1e-4)


def test_power_is_the_noncentral_t_sum_where_the_two_tests_never_both_fail():
    t = stats.t.ppf(0.95, 20)
    assert tost_power(6.0, 20) == pytest.approx(2 * stats.nct.sf(t, 20, 6.0) - 1, abs=1e-6)


def test_identical_samples_are_equivalent():
    result = tost([1.0, 1.0], [1.0, 1.0], 0.1)
    assert result.equivalent
    assert result.error == 0


@pytest.mark.parametrize(
    ("a", "b", "margin", "paired"),
    [([1.0], [1.0, 2.0], 1, False), ([1.0, 2], [1.0, 2], 0, False), ([1.0, 2], [1.0, 2], math.nan, False),
     ([1.0, 2], [1.0, 2, 3], 1, True)],
)  # fmt: skip
def test_unusable_input_is_refused(a, b, margin, paired):
    with pytest.raises(ValueError):
        tost(a, b, margin, paired=paired)
