import math

import numpy as np
import pytest
from scipy import stats

from labbook.stats import Measured, pool


def test_interval_is_scipys_student_interval():
    values = np.random.default_rng(3).normal(5, 2, 7)
    pooled = pool(values)
    low, high = stats.t.interval(0.95, 6, loc=values.mean(), scale=stats.sem(values))
    assert (pooled.low, pooled.high) == pytest.approx((low, high), rel=1e-12)
    assert pooled.error == pytest.approx(stats.sem(values), rel=1e-12)
    assert pooled.n == 7


def test_two_replicates_have_a_wide_interval():
    assert pool([1.0, 1.2]).half_width == pytest.approx(12.706205 * 0.1, rel=1e-6)


def test_one_replicate_has_no_error():
    pooled = pool([2.0])
    assert pooled.value == 2
    assert math.isnan(pooled.error)
    assert pooled.half_width == pooled.relative == math.inf


def test_relative_half_width_of_a_zero_mean_is_infinite():
    assert pool([-1.0, 1.0]).relative == math.inf


@pytest.mark.parametrize("values", [[], [1.0, math.nan], [1.0, math.inf], [[1.0, 2.0]]])
def test_unusable_values_are_refused(values):
    with pytest.raises(ValueError, match="pooling needs"):
        pool(values)


@pytest.mark.parametrize("confidence", [0, 1, -0.5, 95])
def test_a_confidence_is_a_probability(confidence):
    with pytest.raises(ValueError, match="confidence"):
        pool([1.0, 2.0], confidence)


def test_notes_of_a_measured_number_are_separate():
    measured = Measured("flow_rate", 1, 0.1, 10, "w", "m", "kg/s", "trending; 2 gaps without flow left out")
    assert measured.notes == ("trending", "2 gaps without flow left out")
    assert Measured("flow_rate", 1, 0.1, 10, "w", "m", "kg/s").notes == ()
