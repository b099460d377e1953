"""The benchmark measures what it says, on a small hopper."""

import pytest
import switches
from switches import STILL, bed_of, variants

from labbook.backend import load
from labbook.backend.probes import Contacts
from labbook.checks.bench import speed
from labbook.checks.bench.speed import FAN_STEP, SETTLED, fan, settle

pytestmark = [pytest.mark.compiles, pytest.mark.ring]


def test_rates_are_of_the_settled_and_the_flowing_hopper():
    result = speed.run("numba", repeats=1, extent="full", grains=600, boxes=(500,), rods=200)
    resting, flowing, *mixed, stack = [rate for rate in result.rates if not rate.case.startswith("rods")]
    assert (resting.case, resting.grains) == ("fan settled", 600)
    assert 0 < flowing.grains < 600
    assert resting.low <= resting.median <= resting.high
    assert {rate.precision for rate in mixed} == {"mixed"}
    assert (stack.case, stack.grains) == ("box at rest", 500)
    rods = {(rate.case, rate.precision): rate for rate in result.rates if rate.case.startswith("rods")}
    assert set(rods) == {
        (f"rods {how}", precision) for how in ("settled", "flowing") for precision in ("double", "mixed")
    }
    for precision in ("double", "mixed"):
        assert rods["rods settled", precision].grains == 200
        assert 0 < rods["rods flowing", precision].grains < 200
    assert all(0 < rate.low <= rate.median <= rate.high for rate in rods.values())
    assert result.large is not None
    assert result.large > 0
    assert result.speed_up > 0
    assert result.as_dict()["backend"] == "numba"


def test_switches_save_and_a_start_takes_time(monkeypatch):
    """Of what switches save, one is timed: each is a kernel more."""
    case = "without friction"
    monkeypatch.setattr(switches, "variants", lambda scene: {case: variants(scene)[case]})
    result = switches.run("numba", repeats=1, grains=200)
    assert [saving["case"] for saving in result["savings"]] == [case, "with a ledger"]
    assert all(0 < saving["low"] <= saving["times"] <= saving["high"] for saving in result["savings"])
    assert 0 < result["starting"]["cached"] < result["starting"]["first_step"]
    assert result["starting"]["compiled"] > 0


def test_the_bed_stays_as_it_is_while_switches_are_timed():
    """Whatever is left out, there are as many contacts afterwards: rates differ by what a contact costs."""
    closed = fan(grains=200).close()
    numba = load("numba")
    bed = settle(numba, closed, FAN_STEP, SETTLED)
    scenes = {"as it is": closed, **variants(closed)}
    found = {}
    for what in ("as it is", "without friction", "without front and back", "with several sizes", "with two kinds"):
        ensemble = numba.open(numba.specialise(scenes[what], STILL, [Contacts()]), 1)
        ensemble.admit(scenes[what], STILL, bed_of(scenes[what], bed))
        ensemble.advance(15)
        (rows,) = ensemble.drain().values()
        last = rows["step"] == rows["step"].max()
        found[what] = {(i, j) for i, j in zip(rows["i"][last], rows["j"][last], strict=True) if j >= 0}
        ensemble.close()
    assert len(found["as it is"]) > 200
    assert all(contacts == found["as it is"] for contacts in found.values())
