"""The ratio of two means, of the same replicates and of independent ones."""

import numpy as np
import pytest

from labbook.stats import pool
from labbook.stats.ratio import independent_ratio, paired_ratio


def test_what_a_seed_does_to_both_divides_out():
    below = np.array([10.0, 12.0, 8.0])
    found = paired_ratio(0.5 * below, below)
    assert found.value == pytest.approx(0.5)
    assert found.error == pytest.approx(0, abs=1e-15)


def test_it_is_the_ratio_of_means_and_one_replicate_has_no_error():
    assert paired_ratio([1.0, 3.0], [1.0, 1.5]).value == pytest.approx(4 / 2.5)
    single = paired_ratio([1.0], [2.0])
    assert single.value == 0.5
    assert np.isnan(single.error)
    assert single.half_width == np.inf
    with pytest.raises(ValueError, match="equally many"):
        paired_ratio([1.0], [2.0, 3.0])
    with pytest.raises(ValueError, match="zero"):
        paired_ratio([1.0, 2.0], [0.0, 0.0])


def test_ninety_percent_intervals_hold_the_ratio_in_ninety_percent():
    """Normal pairs with a common part of 10 % and own parts of 3 %; 3000 draws: 0.9 +- 0.0055 at one standard error."""
    rng, held, draws = np.random.default_rng(3), 0, 3000
    for _ in range(draws):
        common = 1 + 0.1 * rng.standard_normal(8)
        below, above = (common * part * (1 + 0.03 * rng.standard_normal(8)) for part in (1.0, 0.6))
        found = paired_ratio(above, below, 0.9)
        held += found.low <= 0.6 <= found.high
    assert 0.88 < held / draws < 0.92


def test_independent_samples_of_one_size_have_welchs_interval():
    """Over a denominator that is known exactly the ratio is a mean with Student's own interval."""
    above = np.array([2.0, 2.2, 2.4, 2.1])
    found = independent_ratio(pool(above), pool([2.0, 2.0, 2.0]))
    alone = pool(above / 2)
    assert found.value == pytest.approx(alone.value)
    assert found.error == pytest.approx(alone.error)
    assert found.half_width == pytest.approx(alone.half_width)


def test_an_independent_ratio_says_what_it_cannot_know():
    single = independent_ratio(pool([1.0]), pool([2.0, 2.1]))
    assert single.value == pytest.approx(1 / 2.05)
    assert np.isnan(single.error)
    assert single.half_width == np.inf
    with pytest.raises(ValueError, match="zero"):
        independent_ratio(pool([1.0, 2.0]), pool([1.0, -1.0]))
