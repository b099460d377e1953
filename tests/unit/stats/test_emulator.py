"""Emulators and posteriors: closed forms, the noise of beds, choice of runs, a grid beside samples."""

import numpy as np
import pytest

from labbook.stats.emulator import Emulator, best_settings
from labbook.stats.posterior import posterior

pytest.importorskip("sklearn")
RNG = np.random.default_rng(1)


def plane(U):
    return 1.5 + 0.4 * U[:, 0] - 0.3 * U[:, 1]


def test_a_plane_has_the_error_of_least_squares():
    """Where the response is a plane, the error is at least that of linear regression (to 2 %, for the weak prior of the
    plane), and at most three times as large, as the deviation from the plane is not known to be 0."""
    U = RNG.uniform(size=(100, 2))
    y = plane(U) + 0.02 * RNG.normal(size=100)
    emulator = Emulator.of(U, y, 0.02**2, np.arange(1, 101))
    places = RNG.uniform(0.2, 0.8, size=(50, 2))
    mean, error = emulator.at(places)
    X, x = (np.column_stack([np.ones(len(one)), one]) for one in (U, places))
    regression = 0.02 * np.sqrt(np.einsum("ij,jk,ik->i", x, np.linalg.inv(X.T @ X), x))
    assert (error > 0.98 * regression).all()
    assert (error < 3 * regression).all()
    assert np.sqrt(np.mean((mean - plane(places)) ** 2)) < 3 * error.mean()


def test_all_ways_to_the_covariance_agree():
    """`joint`, `covariance` and scikit-learn's own prediction."""
    U = RNG.uniform(size=(40, 3))
    emulator = Emulator.of(U, np.sin(3 * U[:, 0]) + 0.02 * RNG.normal(size=40), 0.02**2, np.arange(1, 41))
    places = RNG.uniform(size=(5, 3))
    mean, joint = emulator.joint(places[None])
    assert joint[0] == pytest.approx(emulator.covariance(places), abs=1e-12)
    assert emulator.at(places)[1] == pytest.approx(np.sqrt(np.diag(joint[0])), rel=1e-9)
    rows = np.column_stack([2 * places - 1, np.full(5, -1e-6)])
    own, covariance = emulator._process.predict(rows, return_cov=True)
    of_beds = 1e-12 * emulator._scale**2
    assert mean[0] == pytest.approx(own * emulator._scale + emulator._mean, rel=1e-9)
    assert joint[0] == pytest.approx(covariance * emulator._scale**2 - of_beds, abs=1e-9)


def test_what_beds_have_in_common_stays_in_the_error():
    """Runs of one bed alone tell the response no better than the scatter of beds, however many there are; with 16 beds
    the error of the mean is a quarter of that."""
    U = RNG.uniform(size=(160, 1))
    for beds, expected in ((np.ones(160), 0.02), (np.arange(160) % 16 + 1, 0.02 / 4)):
        y = 1 + U[:, 0] + 0.02 * np.random.default_rng(3).normal(size=17)[beds.astype(int)]
        emulator = Emulator.of(U, y, 1e-6, beds, of_beds=0.02**2)
        assert emulator.at(np.array([[0.5]]))[1][0] == pytest.approx(expected, rel=0.15)


def test_runs_go_where_they_lower_the_error():
    """Of two groups of candidates the uncertain one is chosen, one run for each half of it."""
    covariance = np.zeros((6, 6))
    covariance[:2, :2] = covariance[2:4, 2:4] = 1.0
    covariance[4:, 4:] = 0.01
    chosen = best_settings([covariance], [0.1], [np.ones(6)], 2)
    assert {index // 2 for index in chosen} == {0, 1}


@pytest.mark.parametrize("parameters", [1, 2, 3, 4])
def test_the_grid_follows_a_narrow_posterior(parameters):
    """Normal with a standard deviation of 0.004 at 0.3: mean, deviation and interval as in closed form, to 3 %."""

    def log_likelihood(places):
        return -0.5 * (((places - 0.3) / 0.004) ** 2).sum(axis=1)

    found = posterior(log_likelihood, parameters)
    assert found.mean == pytest.approx(np.full(parameters, 0.3), abs=1e-4)
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx(np.full(parameters, 0.004), rel=0.05)
    low, high = found.quantiles(np.array([0.025, 0.975]))
    assert (high - low) / 2 == pytest.approx(np.full(parameters, 1.96 * 0.004), rel=0.03)


@pytest.mark.ring
def test_samples_agree_with_the_closed_form():
    """Five parameters with correlation: emcee's mean and covariance, to 10 % (about 1000 independent samples)."""
    pytest.importorskip("emcee")
    covariance = 0.03**2 * (np.eye(5) + 0.5 * (np.ones((5, 5)) - np.eye(5)))
    inverse = np.linalg.inv(covariance)
    found = posterior(lambda places: -0.5 * np.einsum("ki,ij,kj->k", places - 0.5, inverse, places - 0.5), 5)
    assert found.mean == pytest.approx(np.full(5, 0.5), abs=0.005)
    assert np.diag(found.covariance) == pytest.approx(np.diag(covariance), rel=0.12)


def test_samples_are_the_same_each_time(monkeypatch):
    """A campaign that is asked again gets the same posterior."""
    pytest.importorskip("emcee")
    monkeypatch.setattr("labbook.stats.posterior._STEPS", 20)
    monkeypatch.setattr("labbook.stats.posterior._BURN", 10)
    one, other = (posterior(lambda places: -10 * ((places - 0.5) ** 2).sum(axis=1), 5) for _ in range(2))
    assert (one.parameter_sets == other.parameter_sets).all()
