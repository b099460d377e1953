"""Damping and restitution against an independent integration of the collision, and published values."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labbook_dem.describe import realised
from labbook_dem.laws import hertz_lammps, hertz_mindlin, linear
from scipy.integrate import solve_ivp

from labbook.scene import HertzLammps, HertzMindlin, LinearSpringDashpot, Surface, damping

M, R = 2e-5, 1e-3  # effective mass [kg] and radius [m]


def collide(force, speed: float, scale: float) -> float:
    """Restitution of m* x'' = -force(x, x') from x = 0, until the force would turn attractive; times in `scale` [s]."""

    def slope(_t, state):
        return [state[1], -force(max(state[0], 0.0), state[1]) / M]

    def lets_go(t, state):
        return force(max(state[0], 0.0), state[1]) if t > 1e-9 * scale else 1.0

    lets_go.terminal, lets_go.direction = True, -1  # type: ignore[attr-defined]
    end = solve_ivp(
        slope, (0, 1e4 * scale), [0.0, speed], method="Radau", rtol=1e-10, atol=1e-13 * speed * scale, events=lets_go
    )
    return -float(end.y[1, -1]) / speed


@pytest.mark.parametrize("ratio", [0.01, 0.3, 0.9, 1.0, 1.3, 5.0])
def test_linear_restitution_is_that_of_the_clamped_collision(ratio):
    k = 5e4
    gamma = 2 * ratio * math.sqrt(k * M)
    found = collide(lambda x, v: k * x + gamma * v, 0.3, math.sqrt(M / k))
    assert damping.linear_restitution(ratio) == pytest.approx(found, rel=1e-6)


@pytest.mark.parametrize("c_n", [0.02, 0.4, 0.6675, 2.0])
@pytest.mark.parametrize("speed", [0.01, 1.0])
def test_hertz_restitution_is_that_of_the_clamped_collision(c_n, speed):
    """Fan's eq 6 in physical units: C_n sqrt(8 m* E* sqrt(R* delta)) v_n; e depends on neither speed nor stiffness."""
    modulus = 1.3e8

    def force(x, v):
        return 4 / 3 * modulus * math.sqrt(R) * x**1.5 + c_n * math.sqrt(8 * M * modulus * math.sqrt(R * x)) * v

    scale = (M**2 / (R * modulus**2 * speed)) ** 0.2
    assert damping.hertz_restitution(c_n) == pytest.approx(collide(force, speed, scale), rel=1e-5)


@pytest.mark.parametrize("percent", [1, 20, 55, 90, 99])
def test_stored_damping_is_what_the_solver_gives(percent):
    assert damping.HERTZ_C_N[percent - 1] == pytest.approx(damping.solve_hertz_c_n(percent / 100), rel=1e-12)


@pytest.mark.slow
@settings(max_examples=40)
@given(e=st.floats(0.02, 1.0))
def test_damping_solved_for_e_gives_back_e(e):
    assert damping.linear_restitution(damping.linear_ratio(e)) == pytest.approx(e, abs=1e-10)
    assert damping.hertz_restitution(damping.hertz_c_n(e)) == pytest.approx(e, abs=1e-8)


def test_stored_damping_gives_back_e():
    for hundredths, c_n in enumerate(damping.HERTZ_C_N, 1):
        assert damping.hertz_restitution(c_n) == pytest.approx(hundredths / 100, abs=1e-8)
        assert damping.hertz_c_n(hundredths / 100) == c_n
    assert len(damping.HERTZ_C_N) == 99
    assert damping.solve_hertz_c_n(0.37) == pytest.approx(damping.hertz_c_n(0.37), rel=1e-9)


def test_no_damping_is_elastic():
    assert damping.linear_ratio(1) == damping.hertz_c_n(1) == 0
    assert damping.linear_restitution(0) == damping.hertz_restitution(0) == 1


@pytest.mark.parametrize(("asked", "realised"), [(0.9, 0.902), (0.2, 0.325), (0.05, 0.214)])
def test_textbook_damping_of_the_linear_law_gives_more_than_asked(asked, realised):
    ratio = damping.linear_textbook(asked)
    assert ratio == pytest.approx(1 / math.sqrt((math.pi / math.log(asked)) ** 2 + 1), rel=1e-12)
    assert damping.linear_restitution(ratio) == pytest.approx(realised, abs=5e-4)


def test_textbook_damping_of_hertz_gives_more_than_asked():
    assert damping.hertz_textbook(0.2) == pytest.approx(0.416, abs=5e-4)
    assert damping.hertz_restitution(damping.hertz_textbook(0.2)) == pytest.approx(0.325, abs=5e-4)
    assert damping.hertz_c_n(0.2) == pytest.approx(0.6675, abs=5e-5)


LAWS = [
    (hertz_mindlin, HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25)),
    (linear, LinearSpringDashpot(normal_stiffness=5e4)),
]


@pytest.mark.parametrize(("module", "law"), LAWS, ids=["hertz-mindlin", "linear"])
@pytest.mark.parametrize("e", [0.1, 0.5, 1.0])
def test_realised_restitution_comes_to_the_asked_one_as_the_step_shrinks(module, law, e):
    c = module.coefficients(law, Surface(friction=0.0, rolling_friction=0.0, restitution=e))
    scale = (M**2 / (R * 1.3e8**2 * 0.3)) ** 0.2 if module is hertz_mindlin else math.sqrt(M / 5e4)
    coarse, fine = (np.abs(realised(module.normal, c, R, M, scale * part, 0.3) - e).max() for part in (0.02, 0.005))
    assert fine < 2e-3
    assert fine < 0.5 * coarse or coarse < 1e-6


@pytest.mark.parametrize("damping", [0.9, 1.0, 2.0, 20.0])
def test_grains_that_damping_holds_together_do_not_rebound(damping):
    """Where the force may pull, a damping above the critical one brings the overlap to zero ever more slowly."""
    law = HertzLammps(shear_modulus=1e8, poisson_ratio=0.25, normal_damping=damping)
    c = hertz_lammps.coefficients(law, Surface(friction=0.0, rolling_friction=0.0, restitution=0.5))
    scale = (M**2 / (R * 1.3e8**2 * 0.3)) ** 0.2
    assert (realised(hertz_lammps.normal, c, R, M, 0.02 * scale, 0.3) == 0).all()


def test_restitution_outside_its_range_of_phases_has_a_spread():
    module, law = LAWS[0]
    c = module.coefficients(law, Surface(friction=0.0, rolling_friction=0.0, restitution=0.2))
    assert realised(module.normal, c, R, M, 2.5e-6, 0.17).shape == (10,)
    assert realised(module.normal, c, R, M, 2.5e-6, 0.17).std() > 0
