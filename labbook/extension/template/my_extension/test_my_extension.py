"""Tests of the extension: pytest my_extension"""

from types import SimpleNamespace
from typing import Any

from labbook.backend import load
from labbook.checks.doctor import bounce
from labbook.measure import MEASURES
from labbook.scene import CONTACT_LAWS

from .half_discharge import HalfDischarge
from .viscous import Viscous


def test_labbook_has_found_the_extension():
    assert CONTACT_LAWS["viscous"] is Viscous
    assert isinstance(MEASURES["half_discharge"], HalfDischarge)


def test_a_grain_bounces_with_the_restitution_that_the_law_states():
    law = Viscous(normal_stiffness=2e3, restitution=0.5)
    assert abs(bounce(load("reference"), "cpu", law) - 0.5) < 5e-3  # a collision has 400 steps


def test_half_of_the_grains_have_left_at_the_median_of_their_times():
    run: Any = SimpleNamespace(tables={"crossing": {"time": [3.0, 1.0, 2.0]}})
    window: Any = None
    (number,) = HalfDischarge().evaluate(run, window).numbers
    assert number.value == 2.0
