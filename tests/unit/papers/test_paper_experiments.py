"""How benchmarks/paper_experiments.py evaluates profiles, outflows and accelerations of known shape."""

import numpy as np
import paper_experiments as experiments
import pytest

from labbook.measure.outlet import ProfileAcross
from labbook.papers.fan2023.laws import dome

A, B = 0.35, 0.39


def outlets(bins: int) -> list[ProfileAcross]:
    """Profiles of the paper's outlets whose phi has the exponent B, and v the exponent A."""
    edges, widths = np.linspace(-1, 1, bins + 1), (0.009, 0.015, 0.0225, 0.03)
    middles = [0.8 * (1 - 0.6 * np.exp(-2 * 85 * R)) for R in widths]
    phi, v = dome(edges, B), dome(edges, A)
    return [
        ProfileAcross(R, edges, c * phi, c * phi * v, 1 - 1.5e-3 / R, 1.0) for R, c in zip(widths, middles, strict=True)
    ]


@pytest.mark.parametrize("bins", experiments.BINS)
def test_exponents_and_eq_12_of_known_profiles_do_not_depend_on_the_bins(bins: int):
    found = experiments.numbers_of_seed(outlets(bins), d=3e-3)
    for name, expected in (("a", A), ("a_collapsed", A), ("b", B), ("b_collapsed", B), ("b_collapsed_whole", B)):
        assert found[name] == pytest.approx(expected, abs=0.004), name
    assert found["tau2_per_mm_dome"] == pytest.approx(0.085, rel=0.01)
    assert found["tau1_dome"] == pytest.approx(0.6, rel=0.02)


def test_rates_are_slopes_of_the_number_inside():
    """20 grains/ms during the first second, 10 afterwards."""
    left = np.concatenate([np.arange(0, 1, 5e-5), np.arange(1, 3, 1e-4)])
    found = experiments.rates_between(left, 50_000, duration=3.0)
    assert found[0.0, 1.0] == pytest.approx(20_000, rel=1e-3)
    assert found[1.0, 3.0] == pytest.approx(10_000, rel=1e-3)
    assert 10_000 < found[0.5, 2.0] < 20_000
    assert max(end for _, end in found) == 3.0


def test_where_an_acceleration_falls_to_a_level_is_interpolated():
    z, a = np.array([0.0, 0.2, 0.4, 0.6]), np.array([0.9, 0.8, 0.4, 0.1])
    assert experiments.falls_to(z, a, 0.6) == pytest.approx(0.3)
    assert np.isnan(experiments.falls_to(z, a, 0.05))


@pytest.mark.slow
@pytest.mark.parametrize("name", experiments.EXPERIMENTS)
def test_every_experiment_has_studies_that_can_be_read_small_ones_too(name: str):
    for study in experiments.EXPERIMENTS[name].studies():
        few = experiments.small(study)
        assert len(few.points) == len(study.points)
        assert max(point.scene.grains.count for point in few.points) <= 2000
