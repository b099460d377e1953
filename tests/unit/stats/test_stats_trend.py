import math

import numpy as np
import pytest
from scipy import stats

from labbook.stats.trend import trend


def test_drift_is_that_of_a_straight_line():
    y = np.array([9.0, 10.5, 9.5, 11.0, 10.0, 12.0, 11.5])
    x = np.arange(7) / 7
    slope, _, _, _, error = stats.linregress(x, y)
    found = trend(y)
    assert found.drift == pytest.approx(slope / y.mean(), rel=1e-12)
    assert found.drift_error == pytest.approx(error / y.mean(), rel=1e-12)


def test_steady_noise_is_rarely_called_trending():
    rng = np.random.default_rng(0)
    probabilities = np.array([trend(1 + 0.03 * rng.standard_normal(12)).p for _ in range(2000)])
    assert (probabilities < 0.01).mean() == pytest.approx(0.01, abs=0.008)
    assert stats.kstest(probabilities, "uniform").pvalue > 1e-3


def test_a_drift_is_seen():
    rng = np.random.default_rng(1)
    x = np.linspace(-0.5, 0.5, 12)
    found = [trend(1 + 0.25 * x + 0.03 * rng.standard_normal(12)).trending for _ in range(300)]
    assert np.mean(found) > 0.95


def test_a_rise_and_fall_without_drift_is_seen():
    x = np.linspace(-0.5, 0.5, 12)
    noise = 0.02 * np.random.default_rng(2).standard_normal(12)
    found = trend(1.2 - 1.5 * x**2 + noise)
    assert abs(found.drift) < 3 * found.drift_error
    assert found.trending


def test_a_significant_but_tiny_drift_is_no_trend():
    found = trend(1 + 0.01 * np.linspace(-0.5, 0.5, 12) + 1e-5 * np.random.default_rng(3).standard_normal(12))
    assert found.p < 1e-6
    assert not found.trending


def test_exact_lines_and_constants():
    assert trend(np.full(6, 3.0)).p == 1
    line = trend(np.arange(1.0, 7))
    assert line.p == 0
    assert line.trending
    assert math.isclose(line.drift, 6 / 3.5)


@pytest.mark.parametrize("values", [np.ones(4), np.array([-1.0, 1, -1, 1, 0])])
def test_too_little_to_judge_is_refused(values):
    with pytest.raises(ValueError):
        trend(values)
