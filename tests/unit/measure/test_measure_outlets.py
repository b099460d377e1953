"""Flow rates of several outlets, of crossings made by hand: two grains of three leave through the left one."""

import math
from pathlib import Path

import numpy as np
import pytest
from toy_lab import carry_out

from labbook.api import Lab
from labbook.backend.numerics import Numerics
from labbook.measure import MEASURES, MeasureError, RunData
from labbook.scene import HertzMindlin, Packing, Primitives, Scene, Spheres, Strip, Wall
from labbook.study import load
from labbook.study.schema import Window

STUDIES = Path(__file__).parents[3] / "studies"
MEASURE = MEASURES["outlets"]
N, RATE, WINDOW = 1200, 600.0, Window(start=0.1, end=0.5)
D = 3e-3
MASS = 2500 * math.pi / 6 * D**3


def lid(name, start, end):
    return Wall(name=name, shape=Strip(start=(start, 0.0), end=(end, 0.0)), opens="start")


BOTH = (lid("left", -0.03, -0.01), lid("right", 0.01, 0.03))


def by_hand(parts=BOTH, outcome="finished", left=900) -> RunData:
    """Grains leave evenly, RATE a second, up to 4 mm beside the middle of the lids and 1 mm below these."""
    container = Primitives(parts=parts, outlet_plane=-1e-3)
    scene = Scene(
        grains=Spheres(diameter=D, density=2500, count=N),
        contact=HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25),
        container=container,
    )
    start = Packing(x=np.zeros((N, 3)), v=np.zeros((N, 3)), omega=np.zeros((N, 3)))
    ids, rng = np.arange(left), np.random.default_rng(1)
    x = np.where(ids % 3 < 2, -0.02, 0.02) + rng.uniform(-4e-3, 4e-3, left)
    rows = {"time": (1 + ids) / RATE, "id": ids, "x": x, "y": np.zeros(left), "z": np.full(left, -1e-3)}
    order = rng.permutation(left)  # rows come as they come
    table = {name: column[order] for name, column in rows.items()}
    return RunData(scene, Numerics(dt=1e-5), 1, start, outcome, 2.0, {"crossing": table})


def test_each_outlet_has_its_flow_rate():
    """Within a grain in the window of 480."""
    run = by_hand()
    left, right = MEASURE.evaluate(run, WINDOW).numbers
    assert (left.quantity, right.quantity) == ("flow_rate_left", "flow_rate_right")
    assert left.value == pytest.approx(2 / 3 * RATE * MASS, rel=0.005)
    assert right.value == pytest.approx(1 / 3 * RATE * MASS, rel=0.01)
    (whole,) = [one for one in MEASURES["flow_rate"].evaluate(run, WINDOW).numbers if one.quantity == "flow_rate"]
    assert left.value + right.value == pytest.approx(whole.value, rel=0.005)
    assert 0 < left.error < 0.05 * left.value
    through = MEASURE.evaluate(run, WINDOW).arrays["outlet"]
    assert np.array_equal(through, np.arange(900) % 3 // 2)


def test_names_of_lids_are_names_of_quantities():
    declared = {one.name: one.unit for one in MEASURE.quantities(by_hand().scene)}
    assert declared.keys() == {
        "flow_rate_left", "flow_rate_right", "flow_rate_left_flowing", "flow_rate_right_flowing"
    }  # fmt: skip
    assert set(declared.values()) == {"kg/s"}
    found = MEASURE.evaluate(by_hand(outcome="clogged"), WINDOW).numbers
    assert {one.quantity for one in found} == {"flow_rate_left_flowing", "flow_rate_right_flowing"}


def test_too_few_grains_of_an_outlet_give_no_rate():
    left, right = MEASURE.evaluate(by_hand(left=270), Window(start=0.1, end=0.2)).numbers
    assert math.isfinite(left.value)
    assert math.isnan(right.value)
    assert right.note == "too few grains: 90 left through right; 60 in the window are needed"


def test_one_outlet_has_the_flow_rate_of_all():
    with pytest.raises(MeasureError, match="has no two"):
        MEASURE.check(by_hand(parts=BOTH[:1]).scene)
    assert MEASURE.quantities(by_hand(parts=BOTH[:1]).scene) == ()


@pytest.mark.slow
def test_points_have_the_rates_of_their_outlets(tmp_path):
    text = (STUDIES / "two-outlets.yaml").read_text(encoding="utf-8").replace("count: 700", "count: 400")
    path = tmp_path / "two.yaml"
    path.write_text(text.replace("[0.2, 0.5]", "[0.5]").replace("replicates: 3", "replicates: 2"), encoding="utf-8")
    carry_out(load(path), tmp_path / "lab")
    (point,) = Lab(tmp_path / "lab", backend="toy").results(load(path), progress=False).points
    rates = [point.pooled[f"flow_rate_lid-{side}"].value for side in ("left", "right")]
    assert sum(rates) == pytest.approx(point.pooled["flow_rate"].value, rel=0.05), "to a few grains at the ends"
