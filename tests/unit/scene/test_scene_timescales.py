"""Time scales against published values and an independent integration."""

import math
from typing import ClassVar

import pytest
from pydantic import ValidationError
from scipy.integrate import solve_ivp

from labbook.scene import HertzMindlin, LinearSpringDashpot, Scene, Spheres, SurfaceChange, WedgeHopper
from labbook.scene.contact import ContactLaw
from labbook.scene.timescales import collision, largest_stable_step, rayleigh

GRAINS = Spheres(diameter=0.003, density=2500.0, count=3000)
HOPPER = WedgeHopper(width=0.1, height=0.4, thickness=0.00303, orifice=0.03)
FAN = Scene(grains=GRAINS, contact=HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25), container=HOPPER)


def test_rayleigh_time_of_fan():
    """Fan et al. 2023, eq 9, with the parameters of Table 1: 2.57e-5 s."""
    assert rayleigh(FAN) == pytest.approx(2.57e-5, rel=2e-3)


def test_hertz_collision_against_integration():
    mass, radius = GRAINS.mass / 2, GRAINS.radius / 2
    young = 2 * 1e8 * 1.25
    modulus = young / (2 * (1 - 0.25**2))
    speed = math.sqrt(9.81 * 0.003)

    def separated(_, y):
        return y[0]

    separated.terminal, separated.direction = True, -1  # pyright: ignore[reportFunctionMemberAccess]
    stiffness = 4 / 3 * modulus * math.sqrt(radius)
    motion = solve_ivp(
        lambda _, y: (y[1], -stiffness * max(y[0], 0.0) ** 1.5 / mass),
        (0, 1e-3),
        (0.0, speed),
        events=separated,
        rtol=1e-10,
        atol=1e-18,
    )
    assert collision(FAN) == pytest.approx(motion.t_events[0][-1], rel=1e-6)


def test_linear_collision():
    stiffness = 1e4
    scene = Scene(grains=GRAINS, contact=LinearSpringDashpot(normal_stiffness=stiffness), container=HOPPER)
    assert collision(scene) == pytest.approx(math.pi * math.sqrt(GRAINS.mass / 2 / stiffness))
    with pytest.raises(ValueError, match="laws by Hertz"):
        rayleigh(scene)


class Adhesive(ContactLaw):
    """A law that does not say up to which step a bed comes to rest."""

    honours: ClassVar[frozenset[str]] = frozenset({"restitution"})
    law: str = "adhesive"

    def stiffened(self, factor):
        return self

    def damping_ratio(self, restitution):
        return 1 - restitution

    def collision_time(self, mass, radius, speed):
        return 0.25


class Measured(Adhesive):
    """The same, which says so; it has no friction."""

    def stability(self, rods):
        return 4.0, 0.0


def test_a_law_refuses_the_common_keys_that_it_has_no_use_for():
    for values in ({"friction": 0.5}, {"damping": "textbook"}, {"rolling": "rolling"}):
        (key,) = values
        with pytest.raises(ValidationError, match=f"the law adhesive has no use for {key}"):
            Measured.model_validate(values)
    law = Measured(restitution=0.5)
    assert Measured.model_validate(law.model_dump()) == law, "records state all keys, with their defaults"
    with pytest.raises(ValidationError, match="no use for damping"):
        Measured.model_validate({"restitution": 0.5, "damping": "clamped"}, context={"units": "required"})
    rough = FAN.model_copy(update={"contact": law, "walls": {"front": SurfaceChange(friction=0.1, restitution=0.5)}})
    assert [fault.key for fault in rough.faults_of_law(law)] == ["walls.front.friction"]
    assert LinearSpringDashpot.ignored() == HertzMindlin.ignored() == ()


def test_another_law_is_not_taken_for_one_of_these():
    with pytest.raises(TypeError, match="stability"):
        Adhesive()  # pyright: ignore[reportAbstractUsage]

    scene = FAN.model_copy(update={"contact": Measured(restitution=0.5)})
    assert collision(scene) == 0.25
    assert largest_stable_step(scene) == pytest.approx(0.25 / (2 * math.pi))
    with pytest.raises(ValueError, match="laws by Hertz"):
        rayleigh(scene)
