"""Slopes of planes: exact on planes, honest intervals about them."""

import math

import numpy as np
import pytest

from labbook.stats.linear import slopes


def test_points_on_a_plane_give_its_slopes_without_error():
    x = [[2.5, 0.048], [3.3, 0.054], [4.0, 0.06], [2.5, 0.066], [4.0, 0.048]]
    by_length, by_width = slopes(x, [7 - 2 * a + 30 * b for a, b in x])
    assert (by_length.value, by_width.value) == (pytest.approx(-2), pytest.approx(30))
    assert max(by_length.error, by_width.error) < 1e-11
    assert by_length.n == 5


def test_intervals_cover_the_slope():
    """2000 planes through 8 points with normal scatter, 90 %: 0.9 within three standard errors of a share."""
    rng, inside, draws = np.random.default_rng(3), 0, 2000
    x = [[a, b] for a in (1.0, 2.5, 4.0, 5.0) for b in (48.0, 60.0)]
    truth = np.array([0.3, -0.02])
    for _ in range(draws):
        first, second = slopes(x, (np.asarray(x) @ truth + 0.1 * rng.standard_normal(8)).tolist(), 0.9)
        inside += int(first.low <= truth[0] <= first.high) + int(second.low <= truth[1] <= second.high)
    assert inside / (2 * draws) == pytest.approx(0.9, abs=3 * math.sqrt(0.09 / draws))


def test_a_plane_through_as_many_points_as_it_has_numbers_has_no_interval():
    (slope,) = slopes([[1.0], [2.0]], [1.0, 3.0])
    assert slope.value == pytest.approx(2)
    assert math.isnan(slope.error)
    assert slope.half_width == math.inf


@pytest.mark.parametrize("x", [[[1.0, 2.0], [2.0, 4.0], [3.0, 6.0]], [[1.0], [1.0]], [[1.0]]])
def test_factors_that_do_not_vary_apart_are_refused(x):
    with pytest.raises(ValueError, match="do not determine"):
        slopes(x, [1.0] * len(x))
