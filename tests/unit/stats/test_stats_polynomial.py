"""Surfaces over several keys: known answers, coverage, shares of the variance, the hull, and the worth of more runs."""

import math
from itertools import product

import numpy as np
import pytest

from labbook.stats.polynomial import Polynomial, _normal, legendre

FOUR = np.linspace(-1, 1, 4)


def runs(truth, grids, beds: int, rng, scatter: float = 0.03, of_bed: float = 0.01):
    """Settings, values and beds of a full grid: noise of each run, and what its bed adds at all designs."""
    designs = np.array(list(product(*grids)))
    u, seeds = np.repeat(designs, beds, axis=0), np.tile(np.arange(beds), len(designs))
    noise = scatter * rng.standard_normal(len(u)) + (of_bed * rng.standard_normal(beds))[seeds]
    return u, truth(u) + noise, seeds


def bilinear(u):
    return 1 + 0.3 * u[:, 0] - 0.2 * u[:, 1] + 0.1 * u[:, 0] * u[:, 1]


def test_a_plane_with_little_noise_is_found():
    rng = np.random.default_rng(1)
    plane = np.array([0.3, -0.2])
    fitted = Polynomial.of(*runs(lambda u: 1 + u @ plane, [FOUR, FOUR], 2, rng, 1e-6, 0.0))
    places = rng.uniform(-1, 1, (50, 2))
    value, half = fitted.at(places)
    assert value == pytest.approx(1 + places @ plane, abs=1e-5)
    assert half.max() < 1e-4
    change, _ = fitted.change(0)
    assert change == pytest.approx(0.6, abs=1e-5)


@pytest.mark.parametrize(
    "truth",
    [
        bilinear,
        lambda u: 0.4 * np.tanh(1.5 * u[:, 0]) - 0.3 * np.exp(-1.5 * (1 + u[:, 1])),
        lambda u: 0.4 * np.sin(3 * u[:, 0]) - 0.3 * u[:, 1],
    ],
    ids=["bilinear", "bent", "wavy"],
)
def test_intervals_hold_the_truth_between_the_points(truth):
    """A third of a wave between two points is near the limit of what four or five values can show: 90 % there."""
    rng = np.random.default_rng(3)
    places = rng.uniform(-1, 1, (200, 2))
    held = []
    for _ in range(15):
        value, half = Polynomial.of(*runs(truth, [np.linspace(-1, 1, 5), FOUR], 3, rng)).at(places)
        held.append(np.mean(np.abs(value - truth(places)) <= half))
    assert np.mean(held) > 0.9  # 15 repeats, whose parts differ by 0.05


def test_shares_are_those_of_known_variances():
    """u, v² and u v have the variances 1/3, 4/45 and 1/9 over the square, and are orthogonal."""
    rng = np.random.default_rng(4)

    def truth(u):
        return 0.5 * u[:, 0] + 0.6 * u[:, 1] ** 2 + 0.4 * u[:, 0] * u[:, 1]

    parts = np.array([0.25 / 3, 0.36 * 4 / 45, 0.16 / 9])
    parts /= parts.sum()
    held = []
    for _ in range(12):
        value, low, high = Polynomial.of(*runs(truth, [np.linspace(-1, 1, 5)] * 2, 3, rng)).shares({})
        assert value == pytest.approx(parts, abs=0.1)
        held.append((low <= parts) & (parts <= high))
    assert np.mean(held) > 0.85


def test_a_key_without_effect_has_a_share_from_zero():
    rng = np.random.default_rng(5)
    fitted = Polynomial.of(*runs(lambda u: 0.3 * u[:, 0], [FOUR, FOUR], 3, rng))
    value, low, _ = fitted.shares({})
    assert low[1] == 0
    assert value[1] < 0.02
    change, half = fitted.change(1)
    assert abs(change) < half


def test_a_known_trend_counts_in_the_share_of_its_key():
    """The trend 3 u² in place of the same data: shares stay."""
    rng = np.random.default_rng(6)
    u, y, seeds = runs(lambda u: 0.5 * u[:, 1], [FOUR, FOUR], 3, rng)
    trend = legendre(lambda x: 0.9 * x**2, 6)
    assert trend[1] == pytest.approx(0.9 * 2 / 3 / math.sqrt(5), rel=1e-12)  # x² is 1/3 + 2/3 P_2
    value, _, _ = Polynomial.of(u, y, seeds).shares({0: trend})
    parts = np.array([0.81 * 4 / 45, 0.25 / 3])
    assert value[:2] == pytest.approx(parts / parts.sum(), abs=0.05)


def test_the_lack_of_fit_is_seen_where_the_points_miss_the_surface():
    rng = np.random.default_rng(7)
    steps = [np.linspace(-1, 1, 6)] * 2
    smooth = [Polynomial.of(*runs(bilinear, steps, 3, rng)).lack_of_fit for _ in range(10)]
    assert sum(p < 0.05 for p in smooth) <= 2
    designs = np.array(list(product(*steps)))
    rough = dict(zip(map(tuple, designs), 0.2 * rng.standard_normal(len(designs)), strict=True))
    fitted = Polynomial.of(*runs(lambda u: np.array([rough[tuple(one)] for one in u]), steps, 3, rng))
    assert fitted.lack_of_fit < 1e-3
    assert fitted.misfit > 0.03


def test_nothing_is_known_outside_of_the_hull():
    rng = np.random.default_rng(8)
    u, y, seeds = runs(bilinear, [FOUR, FOUR], 2, rng)
    there = u.sum(axis=1) < 1.2  # without the corner
    fitted = Polynomial.of(u[there], y[there], seeds[there])
    assert fitted.inside(np.array([[0.9, -0.9], [0.9, 0.9], [0, 0]])).tolist() == [True, False, True]
    with pytest.raises(ValueError, match="between its points"):
        fitted.at(np.array([[0.95, 0.95]]))
    low, high = fitted.line(0, np.array([math.nan, 0.5])) or (math.nan, math.nan)
    along = np.stack([np.linspace(-1, 1, 2001), np.full(2001, 0.5)], axis=1)
    held = along[fitted.inside(along), 0]
    assert (low, high) == pytest.approx((held[0], held[-1]), abs=2e-3)
    assert fitted.line(0, np.array([0.0, 1.5])) is None


def test_the_worth_of_beds_is_the_variance_that_they_remove():
    """The mean variance over the range, by a fine grid in place of the trace."""
    fitted = Polynomial.of(*runs(bilinear, [FOUR, FOUR], 2, np.random.default_rng(9)))
    place = np.array([0.3, -0.7])
    more = fitted.with_beds(place, 0, 4)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    terms = fitted.basis(np.array(list(product(nodes, nodes))))
    both = np.outer(weights, weights).ravel() / 4
    before, after = (both @ ((terms @ one.covariance) * terms).sum(axis=1) for one in (fitted, more))
    assert fitted.mean_variance == pytest.approx(before, rel=1e-9)
    assert fitted.removed(place[None], np.array([0]), 4) == pytest.approx(before - after, rel=1e-9)
    assert fitted.removed(place[None], np.array([4]), 4) == 0
    # one more measurement with the variance of its mean: Bayes' theorem at that place
    (row,) = fitted.basis(place)
    noise, own = fitted.misfit**2 + fitted.scatter**2 / 4, row @ fitted.covariance @ row
    assert row @ more.covariance @ row == pytest.approx(1 / (1 / own + 1 / noise), rel=1e-9)


@pytest.mark.parametrize(
    ("designs", "beds", "says"),
    [
        ([[-1, -1], [-1, 1], [1, -1], [1, 1]], 1, "one bed"),
        ([[-1, -1], [1, 1], [1, -1]], 2, "3 designs are too few"),
        ([[-1, -1], [0, 0], [1, 1], [0.5, 0.5]], 2, "on a line"),
    ],
)
def test_too_little_is_refused(designs, beds, says):
    u, seeds = np.repeat(np.array(designs, float), beds, axis=0), np.tile(np.arange(beds), len(designs))
    with pytest.raises(ValueError, match=says):
        Polynomial.of(u, np.random.default_rng(1).standard_normal(len(u)), seeds)


@pytest.mark.parametrize("misfit", [0.0, 0.7, 2.0])
def test_weights_are_those_of_the_whole_covariance(misfit):
    """Beds and misfit are eliminated without the matrix of all runs: here that is inverted."""
    rng, share = np.random.default_rng(10), 0.3
    x, y = rng.standard_normal((24, 4)), rng.standard_normal(24)
    beds = (np.tile([0, 1, 2], 8)[:, None] == np.arange(3)).astype(float)
    points = (np.repeat(np.arange(8), 3)[:, None] == np.arange(8)).astype(float)
    covariance = (1 - share) * np.eye(24) + share * beds @ beds.T + misfit**2 * points @ points.T
    both = np.column_stack([x, y])
    normal, determinant = _normal(x, y, beds, points, share, misfit)
    assert normal == pytest.approx(both.T @ np.linalg.solve(covariance, both), rel=1e-9, abs=1e-9)
    assert determinant == pytest.approx(np.linalg.slogdet(covariance)[1], abs=1e-9)
