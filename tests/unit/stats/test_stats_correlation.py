import math

import numpy as np
import pytest
from scipy import signal

from labbook.stats.correlation import autocorrelation, block_mean, correlated_mean


def ar1(rng, coefficient, shape):
    """Stationary AR(1) of unit variance along the last axis."""
    noise = rng.standard_normal((*shape[:-1], shape[-1] + 200)) * math.sqrt(1 - coefficient**2)
    return np.asarray(signal.lfilter([1], [1, -coefficient], noise))[..., 200:]


def test_autocorrelation_is_that_of_the_direct_sum():
    x = np.random.default_rng(0).normal(size=300).cumsum()
    y = x - x.mean()
    direct = [np.sum(y[: len(y) - k] * y[k:]) / np.sum(y**2) for k in range(20)]
    np.testing.assert_allclose(autocorrelation(x)[:20], direct, atol=1e-12)


def test_a_constant_series_has_no_autocorrelation():
    with pytest.raises(ValueError, match="constant"):
        autocorrelation(np.ones(10))


@pytest.mark.parametrize("coefficient", [0.0, 0.5, 0.8, -0.5, -0.8])
def test_inefficiency_of_ar1_is_found(coefficient):
    series = ar1(np.random.default_rng(1), coefficient, (200, 4000))
    found = np.mean([correlated_mean(x).inefficiency for x in series])
    assert found == pytest.approx((1 + coefficient) / (1 - coefficient), rel=0.1)


def test_regular_events_with_jitter_are_more_precise_than_their_scatter():
    # Waits of a clock with jitter e_i: T + e_{i+1} - e_i. Their sum telescopes.
    rng = np.random.default_rng(2)
    n, jitter = 1000, 0.3
    errors, means = [], []
    for _ in range(300):
        result = correlated_mean(1 + np.diff(jitter * rng.standard_normal(n + 1)))
        errors.append(result.error)
        means.append(result.mean)
        assert result.inefficiency < 0.2
    naive = jitter * math.sqrt(2 / n)
    assert np.std(means) < 0.05 * naive  # what an inefficiency >= 1 would miss
    assert np.median(errors) < 0.35 * naive


def test_the_bound_is_the_scatter_at_the_ends():
    series = np.tile([0.0, 2.0], 500)
    result = correlated_mean(series)
    assert result.inefficiency == pytest.approx(1 / 1000)


def test_a_constant_series_is_exact():
    result = correlated_mean(np.full(50, 3.0))
    assert (result.mean, result.error) == (3, 0)


@pytest.mark.parametrize("coefficient", [0.0, 0.6, -0.6])
def test_block_errors_are_the_true_ones(coefficient):
    series = ar1(np.random.default_rng(3), coefficient, (500, 2000))
    true = math.sqrt((1 + coefficient) / (1 - coefficient) / 2000)
    squared = [block_mean(x).error ** 2 for x in series]
    assert math.sqrt(np.mean(squared)) == pytest.approx(true, rel=0.1)


def test_blocks_leave_out_the_remainder_at_the_start():
    blocks = block_mean(np.array([99.0, 1, 1, 3, 3]), 2)
    np.testing.assert_array_equal(blocks.means, [1, 3])
    assert blocks.error == pytest.approx(1)


@pytest.mark.parametrize(("samples", "blocks"), [(5, 1), (5, 6), (0, 2)])
def test_impossible_blocks_are_refused(samples, blocks):
    with pytest.raises(ValueError, match="blocks"):
        block_mean(np.ones(samples), blocks)
