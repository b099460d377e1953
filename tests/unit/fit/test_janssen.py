"""Janssen's law fitted to profiles made from its three models."""

import math

import numpy as np
import pytest

from labbook.fit import FitError
from labbook.fit.janssen import WallProfile, fit_janssen, preferred, vertical_stress

WEIGHT, SECTION, LENGTH, RATIO = 15e3, 0.01, 0.05, 0.55
"""rho_b g [N/m^3], A/P [m], lambda [m] and K of the profiles."""
DEPTH = np.linspace(0.01, 0.3, 24)
LAYERS = {"J1": 0.0, "J2": 0.012, "J3": 0.03}
"""Shift of the surface, or thickness of the hydrostatic layer [m]."""


def profile(model: str, rng: np.random.Generator | None = None, noise: float = 0.07) -> WallProfile:
    """Stresses by a model: shear by the balance of thin slices, not by the derivative that is fitted."""
    h = 1e-6
    above, at, below = (vertical_stress(model, DEPTH + shift, LENGTH, LAYERS[model]) for shift in (-h, 0.0, h))
    normal, shear = RATIO * WEIGHT * at, SECTION * WEIGHT * (1 - (below - above) / (2 * h))
    errors = noise * np.maximum(normal, 30), noise * np.maximum(shear, 15)
    if rng is not None:
        normal, shear = normal + errors[0] * rng.normal(size=24), shear + errors[1] * rng.normal(size=24)
    return WallProfile(DEPTH, normal, shear, *errors, WEIGHT, SECTION)


@pytest.mark.parametrize("model", LAYERS)
def test_exact_profiles_give_their_parameters(model):
    fit = fit_janssen(profile(model))[model]
    assert fit.parameters["length"].value == pytest.approx(LENGTH, rel=1e-3)
    assert fit.parameters["ratio"].value == pytest.approx(RATIO, rel=1e-3)
    if model != "J1":
        assert fit.parameters["layer"].value == pytest.approx(LAYERS[model], rel=5e-3)
    assert fit.friction == pytest.approx(SECTION / (RATIO * LENGTH), rel=2e-3)
    assert np.allclose(fit.curves(DEPTH)[0], profile(model).normal, rtol=5e-3)


def test_far_below_the_surface_the_stress_is_rho_g_lambda_and_near_it_that_of_a_liquid():
    for model in LAYERS:
        assert vertical_stress(model, np.array([50.0]), LENGTH, 0.0) == pytest.approx([LENGTH])
    assert vertical_stress("J1", np.array([1e-6]), LENGTH) == pytest.approx([1e-6], rel=1e-4)
    layer = vertical_stress("J3", np.array([0.01, 0.03]), LENGTH, 0.03)
    assert layer == pytest.approx([0.01, 0.03])


@pytest.mark.slow
@pytest.mark.parametrize("model", [*(pytest.param(one, marks=pytest.mark.ring) for one in ("J1", "J2")), "J3"])
def test_intervals_hold_the_parameters_of_noisy_profiles(model):
    """In 92 to 98 % of 300 profiles: 2.4 standard errors of a share of 95 %."""
    rng, held = np.random.default_rng(1), {"length": 0, "ratio": 0, "layer": 0}
    right = 0
    for _ in range(300):
        fits = fit_janssen(profile(model, rng))
        for name, parameter in fits[model].parameters.items():
            true = {"length": LENGTH, "ratio": RATIO, "layer": LAYERS[model]}[name]
            held[name] += parameter.low <= true <= parameter.high
        right += model in preferred(fits)
    for name in ("length", "ratio") if model == "J1" else held:
        assert 0.92 <= held[name] / 300 <= 0.98, name
    assert right > 280


def test_a_model_that_is_worse_by_four_is_not_preferred():
    fits = fit_janssen(profile("J3", np.random.default_rng(2)))
    assert preferred(fits) == ("J3",)
    assert fits["J1"].aicc - fits["J3"].aicc > 4
    undecided = fit_janssen(profile("J1", np.random.default_rng(2), noise=0.3))
    assert len(preferred(undecided)) == 3


def test_too_few_bins_are_refused():
    few = profile("J1")
    short = WallProfile(few.depth[:3], few.normal[:3], few.shear[:3], np.ones(3), np.ones(3), WEIGHT, SECTION)
    with pytest.raises(FitError, match="3 bins, fewer than 4"):
        fit_janssen(short)
    assert math.isfinite(fit_janssen(few)["J1"].aicc)
