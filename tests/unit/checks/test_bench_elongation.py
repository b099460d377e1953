"""Rods of several aspect ratios, timed, and beds of many members."""

import json

import elongation
import members
import pytest
from elongation import elongated
from labbook_numba import Backend

from labbook.checks.bench import speed
from labbook.scene import Spherocylinders

pytestmark = pytest.mark.compiles


@pytest.mark.parametrize("aspect_ratio", [2.0, 10.0])
def test_grains_of_all_aspect_ratios_have_one_volume(aspect_ratio):
    rods, spheres = elongated(aspect_ratio, 100).grains, elongated(1.0, 100).grains
    assert isinstance(rods, Spherocylinders)
    assert rods.length / rods.diameter == pytest.approx(aspect_ratio)
    assert rods.mass == pytest.approx(spheres.mass)


@pytest.mark.ring
def test_a_grain_step_of_each_has_a_cost(monkeypatch):
    backend = Backend(wide=True)  # whose kernels are those of the contract's tests
    monkeypatch.setattr(elongation, "load", lambda _: backend)
    monkeypatch.setattr(members, "SETTLED", 100.0)  # long before they rest
    monkeypatch.setattr(members, "OUTFLOW", 0.01)
    monkeypatch.setattr(speed, "TIMED", 100_000)
    result = elongation.run("numba", "cpu", repeats=2, aspect_ratios=(1.0, 3.0), grains=60)
    assert [case["aspect_ratio"] for case in result["cases"]] == [1.0, 3.0]
    for case in result["cases"]:
        assert 0 < case["grains"] <= 60
        assert 0 < case["low"] <= case["cost"] <= case["high"]
    assert f'"cost": {result["cases"][1]["cost"]!r}' in json.dumps(result)
