"""Laws of the mean avalanche, fitted to stops and grains made from the laws."""

import math

import numpy as np
import pytest

from labbook.fit import FitError
from labbook.fit.clogging import CriticalSize, NoCriticalSize, Outlets, fit_avalanches, preferred

X = np.array([2.0, 2.5, 3.0, 3.5, 4.0, 4.3, 4.6])
CRITICAL = 9900 / (4.94 - X) ** 6.9
ENDLESS = 5 * np.expm1(0.4 * (X**2 - 1))


def stops(rng, mean, expected=200):
    """Grains of about so many stops at each outlet."""
    grains = expected * mean
    return rng.poisson(expected, len(mean)), grains


@pytest.mark.parametrize(
    ("law", "mean", "dimension", "true"),
    [
        (CriticalSize(), CRITICAL, 3, {"R_c": 4.94, "gamma": 6.9, "A": 9900}),
        (NoCriticalSize(), ENDLESS, 2, {"s_1": 5.0, "C": 0.4}),
    ],
)
def test_intervals_cover_the_parameters(law, mean, dimension, true):
    """95 % of 30 fits, but for three standard errors."""
    rng, held = np.random.default_rng(3), dict.fromkeys(true, 0)
    for _ in range(30):
        found = fit_avalanches(law, X, *stops(rng, mean), dimension)
        for name, value in true.items():
            held[name] += found.parameters[name].low <= value <= found.parameters[name].high
    assert min(held.values()) >= 30 * 0.95 - 3 * math.sqrt(30 * 0.05 * 0.95)


def test_data_of_many_decades_choose_and_others_do_not():
    rng = np.random.default_rng(5)
    for mean, law in ((CRITICAL, "critical size"), (ENDLESS, "no critical size")):
        data = stops(rng, mean, 2000)
        both = [fit_avalanches(one, X, *data, 2) for one in (CriticalSize(), NoCriticalSize())]
        assert law in preferred(both)
        assert next(fit for fit in both if fit.law.name == law).p_value > 1e-3
    data = stops(rng, CRITICAL, 2000)
    far = [fit_avalanches(one, X, *data, 2) for one in (CriticalSize(), NoCriticalSize())]
    assert preferred(far) == ("critical size",)
    few = [fit_avalanches(one, X[:4], data[0][:4], data[1][:4], 2) for one in (CriticalSize(), NoCriticalSize())]
    assert preferred(few) == ("critical size", "no critical size"), "AICc is not known for four outlets"


def test_an_outlet_without_a_stop_counts():
    """A bound far above what the others foretell moves the critical size inwards."""
    rng = np.random.default_rng(7)
    k, grains = stops(rng, CRITICAL[:5])
    alone = fit_avalanches(CriticalSize(), X[:5], k, grains, 3)
    bound = fit_avalanches(CriticalSize(), X[:6], [*k, 0], [*grains, 100 * CRITICAL[5]], 3)
    assert bound.parameters["R_c"].high < alone.parameters["R_c"].high
    assert math.isinf(bound.mean(np.array([9.0]))[0])


def test_too_few_outlets_are_refused():
    with pytest.raises(FitError, match="2 outlets with stops; its 3 parameters need 3"):
        fit_avalanches(CriticalSize(), [2.0, 3.0, 4.0], [5, 3, 0], [100.0, 1e3, 1e4], 3)


def test_small_and_large_avalanches_keep_their_digits():
    """expm1 of 1e-6 and of 40."""
    found = NoCriticalSize().log_mean(np.array([math.sqrt(1 + 1e-6), math.sqrt(41)]), np.zeros(2), Outlets(2, 3.0))
    assert found == pytest.approx([math.log(math.expm1(1e-6)), 40.0], rel=1e-9)
