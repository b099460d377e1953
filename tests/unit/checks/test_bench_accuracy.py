"""Orders that the benchmark finds: of a rule of first order, and of impacts whose order theory gives."""

import math

import numpy as np
import pytest
from platforms import platforms

from labbook.checks.bench import contacts
from labbook.checks.bench.contacts import SITUATIONS, at_floor, errors, head_on, measure
from labbook.checks.bench.order import fit_order
from labbook.checks.verify.materials import EVERY_LAW
from labbook.checks.verify.planar import PlanarLaw
from labbook.checks.verify.platform import Platform

STEPS = (20, 40, 80, 160, 320, 640)
NUMBA = next(one for one in platforms() if one.backend.capabilities.name == "numba" and one.precision == "double")
REFERENCE = next(one for one in platforms() if one.backend.capabilities.name == "reference")


def test_order_of_a_power_is_its_exponent():
    h = 1 / np.array(STEPS)
    order = fit_order(h, 3 * h**1.7)
    assert order.value == pytest.approx(1.7, abs=1e-12)
    assert order.error == pytest.approx(0, abs=1e-12)


def test_order_is_that_of_the_finer_half_and_has_an_error():
    h = 1 / np.array(STEPS)
    order = fit_order(h, h * np.where(np.array(STEPS) <= 80, 100, 1) * [1, 1, 1, 1.1, 1.0, 1.1])
    assert abs(order.value - 1) < 3 * order.error < 1


@pytest.mark.parametrize("bad", [0.0, math.nan, math.inf])
def test_there_is_no_order_where_an_error_is_no_positive_number(bad):
    assert math.isnan(fit_order([1, 0.5, 0.25], [1, 0.5, bad]).value)


def test_a_rule_of_first_order_is_found_to_be_one():
    """Euler's explicit rule: x' = -x until t = 1."""
    h = 1 / np.array(STEPS)
    assert fit_order(h, np.abs((1 - h) ** np.array(STEPS) - math.exp(-1))).value == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize(
    ("law", "given", "expected"),
    [
        # the force has a bend at first touch, then its slope has: F ~ delta, delta^{3/2}
        ("linear", {}, 2.0),
        ("hertz-mindlin", {}, 2.5),
        # a dashpot jumps there, or rises as delta^{1/4}
        ("linear", {"restitution": 0.5}, 1.0),
        ("hertz-mindlin", {"restitution": 0.5}, 1.25),
    ],
)
def test_a_head_on_impact_has_the_order_that_its_first_touch_leaves(law, given, expected):
    """Leapfrog is of second order where forces are smooth. Where the force rises as t^p from a touch anywhere within a
    step, a step is wrong by dt^{1+p} times the force: order 1 + p, of the scatter between phases. On the slow backend,
    the finest steps are left out."""
    found = measure(REFERENCE, head_on(EVERY_LAW[law], **given), ("head-on", law), (20, 40, 80, 160))
    assert found.order_scatter.value == pytest.approx(expected, abs=0.1)


def test_the_mean_over_phases_of_damped_impacts_is_of_second_order():
    found = measure(REFERENCE, head_on(EVERY_LAW["linear"], restitution=0.5), ("head-on", "linear"), (20, 40, 80))
    assert found.order_bias.value == pytest.approx(2.0, abs=0.2)
    assert max(found.bias) < max(found.scatter)


def test_a_sliding_sphere_is_right_to_rounding_where_friction_is_constant():
    """By the law linear friction is mu m g until it rolls, which a leapfrog gets right whatever the step."""
    situation = next(one for one in SITUATIONS if one.name == "sliding to rolling")
    found = contacts.converge(REFERENCE, situation, "linear", steps=(10, 20, 40))
    assert max(found.error) < 1e-11


@pytest.mark.parametrize("law", EVERY_LAW)
def test_the_integration_agrees_with_itself_at_another_tolerance(law):
    for impact in at_floor(EVERY_LAW[law], [0.3, 2.0]):
        assert np.abs(impact.parted() - impact.parted(1e-10))[:, :2].max() < 1e-8 * impact.speed


def test_the_integration_gives_back_the_restitution_that_is_asked_for():
    for law in EVERY_LAW:
        for e in (0.2, 0.9):
            (impact,) = head_on(EVERY_LAW[law], restitution=e)
            v = impact.parted()[:, 1]
            assert v[0] - v[1] == pytest.approx(e * impact.speed, rel=1e-7)


def test_full_slip_changes_velocity_and_spin_by_friction_times_the_impulse():
    """(1 + e) m v_n of impulse; mu of it along the wall, and at the lever R turns the sphere."""
    (impact,) = at_floor(EVERY_LAW["linear"], [50.0], restitution=0.5)
    (ball,), (vx, _, spin) = impact.bodies, impact.parted()[0]
    push = 0.5 * 1.5 * impact.speed
    assert ball.velocity[0] - vx == pytest.approx(push, rel=1e-6)
    assert spin == pytest.approx(push * ball.mass * ball.radius / ball.inertia, rel=5e-3)  # the lever is R - delta


def test_a_contact_that_lammps_law_lets_slide_at_once_keeps_a_spring_against_its_motion():
    """gamma v_t is above mu F_n at first touch, as both dashpots are alike: the spring takes up what is too much."""
    (impact,) = at_floor(EVERY_LAW["hertz-lammps"], [1.0])
    regime, sign, spring = PlanarLaw.first(impact.law(), -impact.speed, impact.speed, impact.lasts)
    assert (regime, sign) == ("slides", -1.0)
    assert spring < 0


@pytest.mark.ring
@pytest.mark.compiles
@pytest.mark.parametrize("situation", [one for one in SITUATIONS if one.rods], ids=lambda one: one.name)
def test_impacts_of_rods_come_nearer_to_the_integration(situation):
    """In proportion to the step; between parallel rods, where the contact jumps from end to end, only somehow."""
    platform = Platform(NUMBA.backend)
    (impact,) = situation.make(EVERY_LAW["linear"])
    coarse, fine = (np.abs(errors(platform, impact, impact.parted(), steps, 4)).max(1).mean() for steps in (40, 2560))
    assert fine < (0.5 if "parallel" in situation.name else 0.03) * coarse
