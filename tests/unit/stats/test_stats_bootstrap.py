import numpy as np
import pytest

from labbook.stats import pool
from labbook.stats.bootstrap import bootstrap_all


def bootstrap(points, statistic, **how):
    """Of one number."""
    (one,) = bootstrap_all(points, lambda drawn: (statistic(drawn),), **how)
    return one


def mean_of_first(points):
    return float(np.mean(points[0]))


def test_error_of_a_mean_is_the_formulas():
    values = np.random.default_rng(0).normal(5, 1, 6)
    found, exact = bootstrap([list(values)], mean_of_first, draws=4000), pool(values)
    assert found.value == exact.value
    assert found.error == pytest.approx(exact.error, rel=0.05)
    assert found.half_width == pytest.approx(exact.half_width, rel=0.05)


def test_slope_over_points_covers():
    x = np.arange(8.0)
    weights = (x - x.mean()) / np.sum((x - x.mean()) ** 2)  # least-squares slope

    def slope(points):
        return float(weights @ [sum(p) / len(p) for p in points])

    rng = np.random.default_rng(1)
    hits = []
    for trial in range(150):
        points = [list(2 * xi + rng.standard_normal(3)) for xi in x]
        found = bootstrap(points, slope, draws=120, seed=trial)
        hits.append(found.low <= 2 <= found.high)
    assert 0.89 <= np.mean(hits) <= 0.995  # 150 trials: 95 % +- 1.8 %


def test_whole_replicates_are_drawn():
    series = [np.array([1.0, 1.0]), np.array([2.0, 2.0])]
    seen = set()

    def note(points):
        seen.update(tuple(replicate) for replicate in points[0])
        return float(np.mean(points[0]))

    bootstrap([series], note, draws=50)
    assert seen == {(1.0, 1.0), (2.0, 2.0)}


def test_the_same_seed_gives_the_same_draws():
    values = [1.0, 2.0, 4.0]
    assert bootstrap([values], mean_of_first, seed=5) == bootstrap([values], mean_of_first, seed=5)
    assert bootstrap([values], mean_of_first, seed=5) != bootstrap([values], mean_of_first, seed=6)


@pytest.mark.parametrize("points", [[], [[1.0]], [[1.0, 2.0], [3.0]]])
def test_single_replicates_are_refused(points):
    with pytest.raises(ValueError, match="at least 2 replicates"):
        bootstrap(points, mean_of_first)
