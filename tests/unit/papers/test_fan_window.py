"""The ranking of contact laws by benchmarks/fan_window.py: its fits, its chi2 and its criterion."""

import importlib.util
import math
import sys
from pathlib import Path

import numpy as np
import pytest

from labbook.fit import LAWS, fit

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"


@pytest.fixture(scope="module")
def ranking():
    sys.path.insert(0, str(BENCHMARKS))
    try:
        spec = importlib.util.spec_from_file_location("fan_window", BENCHMARKS / "fan_window.py")
        assert spec is not None
        assert spec.loader is not None
        module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(BENCHMARKS))
    return module


@pytest.fixture
def line(ranking):
    D = np.array([0.018, 0.03, 0.045, 0.06])
    W = 0.58 * 2500 * math.sqrt(9.81) * (D - 1.55 * 3e-3) ** 1.5 * 3.03e-3
    return ranking.Line(D, W, 0.02 * W)


def test_every_reading_finds_the_law_that_made_the_rates(ranking, line):
    for reading in (ranking.weighted, ranking.straight):
        assert reading(line, line.W) == pytest.approx((0.58, 1.55), rel=1e-6)
    through = 0.6 * 2500 * math.sqrt(9.81) * line.D**1.5 * 3.03e-3
    assert ranking.origin(line, through) == pytest.approx((0.6, 0.0), rel=1e-9)


def test_the_weighted_reading_is_that_of_reports(ranking, line):
    W = line.W * np.array([1.03, 0.98, 1.01, 0.99])
    expected = fit(LAWS["beverloo"], line.D, W, 0.02 * W, ranking.ABOUT).parameters
    assert ranking.weighted(line, W) == pytest.approx((expected["C_particle"].value, expected["k"].value), rel=1e-6)


def test_equations_14_and_18_are_those_of_the_paper(ranking):
    """Eq 14 with Table 2 at 90 deg, by hand: 2/3 d rho 0.78 sqrt(2 g 1.66 R) R beta(1/2, 1.78)."""
    beta = math.gamma(0.5) * math.gamma(1.78) / math.gamma(2.28)
    for D in (18, 30, 45, 60):
        R = D / 2e3
        W = 2 / 3 * 3e-3 * 2500 * 0.78 * math.sqrt(2 * 9.81 * 1.66 * R) * R * beta
        assert ranking.printed(ranking.ANGLE, 90, R) == f"{1e3 * W:.1f} (eq 14)"
    # far from the wall the tilt hardly counts, and eq 18 is eq 14 with epsilon^2 = 1.69 and nearly its exponents
    (rate, _) = ranking.printed(ranking.POSITION, 30, 0.03).split(" ", 1)
    assert float(rate) == pytest.approx(164.7, rel=0.03)


def test_chi2_without_common_part_is_the_sum_of_squared_pulls(ranking):
    ours, own = 1.1 * ranking.PAPER, np.diag((0.02 * ranking.PAPER) ** 2)
    pulls = 0.1 * ranking.PAPER / np.hypot(0.02 * ranking.PAPER, ranking.PART * ranking.PAPER)
    assert ranking.chi2(ours, own, 0.0, range(15)) == pytest.approx(float(pulls @ pulls))
    assert ranking.chi2(ours, own, 0.0, [0, 3]) == pytest.approx(float(pulls[0] ** 2 + pulls[3] ** 2))


def test_what_a_group_has_in_common_counts_once(ranking):
    """Five numbers that are all high by the same part, wholly common but for 1 %: as one number."""
    ours = ranking.PAPER.copy()
    ours[5:10] *= 1.1
    own = np.zeros((15, 15))
    assert ranking.chi2(ours, own, 0.99, range(15)) == pytest.approx((0.1 / 0.05) ** 2, rel=0.01)
    assert ranking.chi2(ours, own, 0.0, range(15)) == pytest.approx(5 * (0.1 / 0.05) ** 2)


def test_a_choice_is_out_only_if_it_is_behind_in_every_variant(ranking):
    first = {("a", "full", 0.0, "line"): 10.0, ("b", "full", 0.1, "line"): 15.9, ("c", "full", 0.1, "line"): 16.0}
    second = {("a", "full", 0.0, "line"): 10.0, ("b", "full", 0.1, "line"): 30.0, ("c", "full", 0.1, "line"): 17.0}
    assert ranking.open_choices([first, second], 0, 1) == [("a", "full"), ("b", "full")]
    assert ranking.open_choices([second], 0, 1) == [("a", "full")]
