import math

import numpy as np
import pytest

from labbook.fit import LAWS, Context

FAN = Context(d=3e-3, rho_p=2500, rho_b=0.59 * 2500, Z=3.03e-3, g=9.81)
D = np.array([18, 21, 24, 30, 36, 45, 52.5, 60]) * 1e-3


def test_beverloo_gives_the_flow_rates_of_fan():
    """C = 0.58, k = 1.55: 21/56/112/179 g/s with rho_p, 12.5/33/66/106 g/s with 0.59 rho_p."""
    law = LAWS["beverloo"]
    orifices = np.array([18, 30, 45, 60]) * 1e-3
    by_particle = law.flow(orifices, np.array([math.log(0.58), 1.55]), FAN)
    np.testing.assert_allclose(by_particle * 1e3, [21, 56, 112, 179], rtol=0.012)
    by_bulk = law.flow(orifices, np.array([math.log(0.58 * 0.59), 1.55]), FAN)
    np.testing.assert_allclose(by_bulk * 1e3, [12.5, 33, 66, 106], rtol=0.012)


def test_beverloo_is_its_formula():
    c, k = 0.61, 1.4
    formula = c * FAN.rho_p * math.sqrt(FAN.g) * (D - k * FAN.d) ** 1.5 * FAN.Z
    np.testing.assert_allclose(LAWS["beverloo"].flow(D, np.array([math.log(c), k]), FAN), formula, rtol=1e-13)


def test_beverloo_reports_both_normalisations_and_the_slope():
    reported = {r.name: r.of(math.log(0.58)) for r in LAWS["beverloo"].reported(FAN) if r.free == 0}
    assert reported["C_particle"] == pytest.approx(0.58)
    assert reported["C"] == pytest.approx(0.58 / 0.59)
    flow = LAWS["beverloo"].flow(D, np.array([math.log(0.58), 1.55]), FAN)
    assert reported["slope"] == pytest.approx(np.polyfit(D, flow ** (2 / 3), 1)[0], rel=1e-12)


def test_without_a_bulk_density_c_is_left_out():
    context = Context(d=3e-3, rho_p=2500, rho_b=None, Z=3.03e-3, g=9.81)
    assert {r.name for r in LAWS["beverloo"].reported(context)} == {"C_particle", "k", "slope"}


def test_janda_is_its_formula_times_the_mass_of_a_grain():
    law = LAWS["janda"]
    free = np.array([0.1, 0.5, math.log(6)])
    reported = {r.name: r.of(free[r.free]) for r in law.reported(FAN)}
    Q = reported["C_prime"] * (1 - reported["alpha1"] * np.exp(-D / reported["alpha2"])) * D**1.5
    np.testing.assert_allclose(law.flow(D, free, FAN), FAN.grain_mass * Q, rtol=1e-13)
    assert reported["alpha2"] == pytest.approx(18e-3)
    assert reported["alpha2_over_d"] == pytest.approx(6)


def test_janda_with_a_far_alpha2_is_its_formula_close_to_its_zero():
    """alpha_1 = e^{D_0/alpha_2}: the bracket is 1 - e^{-(D - D_0)/alpha_2}, here 2e-4 to 2e-3."""
    law, ratio = LAWS["janda_3d"], np.array([4.1, 4.5, 5.0])
    free = np.array([8.0, math.exp(4 / 500), math.log(500)])
    expected = FAN.unit_flow * math.exp(8) * -np.expm1(-(ratio - 4) / 500) * ratio**2.5
    np.testing.assert_allclose(law.flow(ratio * FAN.d, free, FAN), expected, rtol=1e-10)


@pytest.mark.parametrize("law", LAWS.values(), ids=lambda law: law.name)
def test_the_start_is_near_for_exact_data(law):
    free = {2: np.array([-0.5, 1.5]), 3: np.array([0.0, 0.5, math.log(6)])}[len(law.free)]
    start = law.start(D, law.flow(D, free, FAN), FAN)
    np.testing.assert_allclose(law.flow(D, start, FAN), law.flow(D, free, FAN), rtol=0.02)


@pytest.mark.parametrize("law", LAWS.values(), ids=lambda law: law.name)
def test_small_orifices_lie_outside(law):
    edge = law.least_ratio * FAN.d
    assert law.outside(np.array([edge, 2 * edge + 1e-3]), FAN).tolist() == [False, False]
    if law.least_ratio:
        assert law.outside(np.array([0.5, 0.99]) * edge, FAN).tolist() == [True, True]


def test_laws_of_a_hole_are_their_formulas():
    """Beverloo's numbers for sand through a hole: C = 0.58, k = 1.4."""
    flow = LAWS["beverloo_3d"].flow(D, np.array([math.log(0.58 * 0.59), 1.4]), FAN)
    np.testing.assert_allclose(flow, 0.58 * 0.59 * FAN.rho_p * math.sqrt(FAN.g) * (D - 1.4 * FAN.d) ** 2.5, rtol=1e-13)
    slope = {r.name: r.of(math.log(0.58)) for r in LAWS["beverloo_3d"].reported(FAN)}["slope"]
    flow = LAWS["beverloo_3d"].flow(D, np.array([math.log(0.58), 1.4]), FAN)
    assert slope == pytest.approx(np.polyfit(D, flow**0.4, 1)[0], rel=1e-12)
    free = np.array([0.1, 0.5, math.log(6)])
    found = {r.name: r.of(free[r.free]) for r in LAWS["janda_3d"].reported(FAN)}
    Q = found["C_prime"] * (1 - found["alpha1"] * np.exp(-D / found["alpha2"])) * D**2.5
    np.testing.assert_allclose(LAWS["janda_3d"].flow(D, free, FAN), FAN.grain_mass * Q, rtol=1e-13)


def test_power_and_exponential_are_their_formulas():
    found = {r.name: r.of([0.3, 1.7][r.free]) for r in LAWS["power"].reported(FAN)}
    flow = LAWS["power"].flow(D, np.array([0.3, 1.7]), FAN)
    np.testing.assert_allclose(flow, found["W_d"] * (D / FAN.d) ** found["n"], rtol=1e-13)
    found = {r.name: r.of([0.3, 0.25][r.free]) for r in LAWS["exponential"].reported(FAN)}
    flow = LAWS["exponential"].flow(D, np.array([0.3, 0.25]), FAN)
    np.testing.assert_allclose(flow, found["W_0"] * np.exp(found["kappa"] * D), rtol=1e-13)


def test_beverloo_looks_exponential_near_pongo_s_outlets():
    """d ln Q/dD = 2.5/(D - k d) is about 0.08/mm near 45 mm: kappa = 0.084/mm by itself tells nothing apart."""
    rods = Context(d=9.9e-3, rho_p=620, rho_b=None, Z=math.nan, g=9.8)
    near = np.array([44.99e-3, 45.01e-3])
    slope = np.diff(LAWS["beverloo_3d"].log_flow(near, np.array([0.0, 1.5]), rods))[0] / 2e-5
    assert slope * 1e-3 == pytest.approx(0.083, abs=0.001)


def test_wide_outlets_of_beverloo_are_a_power_law():
    wide = np.array([1.0, 1.01])
    slope = np.diff(LAWS["beverloo"].log_flow(wide, np.array([0.0, 1.5]), FAN))[0] / math.log(1.01)
    assert slope == pytest.approx(1.5, rel=0.01)


@pytest.mark.parametrize("law", LAWS.values(), ids=lambda law: law.name)
def test_every_law_says_what_it_is(law):
    assert law.version >= 1
    assert law.formula
    assert law.source
    assert {r.free for r in law.reported(FAN)} == set(range(len(law.free)))
