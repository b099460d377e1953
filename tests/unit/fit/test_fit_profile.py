import math

import numpy as np
import pytest
from scipy import stats

from labbook.fit.profile import interval, minimise

X = np.arange(8.0)


def linear(y, sigma=1.0):
    return lambda free: (y - free[0] - free[1] * X) / sigma


def test_a_linear_fit_is_least_squares():
    y = 2 + 0.5 * X + np.random.default_rng(0).standard_normal(8)
    found = minimise(linear(y), np.zeros(2))
    slope, intercept = np.polyfit(X, y, 1)
    np.testing.assert_allclose(found.best, [intercept, slope], rtol=1e-8)
    design = np.column_stack([np.ones(8), X])
    np.testing.assert_allclose(found.covariance, np.linalg.inv(design.T @ design), rtol=1e-6)


def test_linear_intervals_are_the_exact_ones():
    y = 2 + 0.5 * X + np.random.default_rng(1).standard_normal(8)
    found = minimise(linear(y), np.zeros(2))
    for i in range(2):
        error = math.sqrt(found.covariance[i, i])
        expected = (found.best[i] - 2.1 * error, found.best[i] + 2.1 * error)
        assert interval(linear(y), found, i, 2.1**2) == pytest.approx(expected, rel=1e-5)


def test_the_interval_of_a_ratio_is_fiellers():
    """The zero of a straight line, -a/b: exact limits by Fieller's theorem."""
    y = -3 + 1.0 * X + 0.8 * np.random.default_rng(2).standard_normal(8)

    def by_zero(free):
        return (y - free[0] * (X - free[1])) / 0.8

    found = minimise(by_zero, np.array([1.0, 3.0]))
    low, high = interval(by_zero, found, 1, 1.96**2)
    line = minimise(linear(y, 0.8), np.zeros(2))
    (a, b), cov = line.best, line.covariance

    def distance(zero):
        spread = cov[0, 0] + 2 * zero * cov[0, 1] + zero**2 * cov[1, 1]
        return (a + b * zero) ** 2 / spread

    assert distance(low) == pytest.approx(1.96**2, rel=1e-3)
    assert distance(high) == pytest.approx(1.96**2, rel=1e-3)
    assert low < found.best[1] < high
    assert high - found.best[1] != pytest.approx(found.best[1] - low, rel=1e-3)  # and they are not symmetric


def test_what_the_data_do_not_limit_has_no_end():
    y = np.exp(-X / 0.05) + 1e-3 * np.random.default_rng(3).standard_normal(8)  # dies before the second point

    def decay(free):
        return (y - free[0] * np.exp(-X / np.exp(np.clip(free[1], -5, 5)))) / 1e-3

    found = minimise(decay, np.array([1.0, -2.0]))
    low, high = interval(decay, found, 1, 4.0)
    assert low == -math.inf
    assert high < 0


def test_no_minimum_is_an_error():
    with pytest.raises(RuntimeError, match="converge"):
        minimise(lambda free: np.full(3, np.nan) * free[0], np.zeros(1))


def test_profile_intervals_cover():
    rng = np.random.default_rng(4)
    t, hits = float(stats.norm.ppf(0.975)), []
    for _ in range(300):
        y = 3 * np.exp(-X / 2.5) + 0.1 * rng.standard_normal(8)

        def decay(free, y=y):
            return (y - free[0] * np.exp(-X / free[1])) / 0.1

        low, high = interval(decay, minimise(decay, np.array([2.0, 2.0])), 1, t**2)
        hits.append(low <= 2.5 <= high)
    assert np.mean(hits) == pytest.approx(0.95, abs=0.035)
