"""The time step that a study asks for."""

import pytest

from labbook.scene import HertzMindlin, LinearSpringDashpot, Scene, Spheres, WedgeHopper
from labbook.scene.timescales import collision, rayleigh
from labbook.study.timestep import TimeStepError, resolve

GRAINS = Spheres(diameter=0.003, density=2500.0, count=3000)
HOPPER = WedgeHopper(width=0.1, height=0.4, thickness=0.00303, orifice=0.03)
HERTZ = Scene(grains=GRAINS, contact=HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25), container=HOPPER)
LINEAR = Scene(grains=GRAINS, contact=LinearSpringDashpot(normal_stiffness=1e4), container=HOPPER)


@pytest.mark.parametrize(
    ("stated", "scene", "step"),
    [
        ("2.5 us", HERTZ, 2.5e-6),
        ("0.1 rayleigh", HERTZ, 0.1 * rayleigh(HERTZ)),
        ("0.1*rayleigh", HERTZ, 0.1 * rayleigh(HERTZ)),
        ("1/50 collision", HERTZ, 0.02 * collision(HERTZ)),
        ("2 % collision", LINEAR, 0.02 * collision(LINEAR)),
        (None, HERTZ, 0.1 * rayleigh(HERTZ)),
        (None, LINEAR, 0.02 * collision(LINEAR)),
    ],
)
def test_steps(stated, scene, step):
    assert resolve(stated, scene, 1.0) == pytest.approx(step, rel=1e-5)


def test_parts_of_a_time_scale_have_six_digits():
    step = resolve("0.1 rayleigh", HERTZ, 1.0)
    assert step == float(f"{step:.6g}")


def test_softer_grains_take_longer_steps():
    assert resolve(None, HERTZ, 0.01) == pytest.approx(10 * resolve(None, HERTZ, 1.0), rel=1e-5)
    assert resolve(None, LINEAR, 0.25) == pytest.approx(2 * resolve(None, LINEAR, 1.0), rel=1e-5)


@pytest.mark.parametrize(
    ("stated", "scene", "reason"),
    [
        ("0.1 raleigh", HERTZ, "no time scale is called raleigh"),
        ("0.1 rayleigh", LINEAR, "hertz-mindlin"),
        ("0.1 mm", HERTZ, "a quantity in s"),
        ("x collision", HERTZ, "not a quantity"),
        ("1 collision", HERTZ, "a fifth of a collision"),
        ("1 s", HERTZ, "a fifth of a collision"),
        ("-1 us", HERTZ, "not between 0"),
        ("0 collision", HERTZ, "not between 0"),
        (2.5e-6, HERTZ, "unit is missing"),
        (True, HERTZ, "a time is needed"),
    ],
)
def test_refused_steps(stated, scene, reason):
    with pytest.raises(TimeStepError, match=reason) as caught:
        resolve(stated, scene, 1.0)
    assert caught.value.remedy
