"""Stress on walls from a study to its numbers, on the CPU backend: with an outlet, and without."""

import numpy as np
import pytest

pytest.importorskip("numba")

from labbook_numba import Backend
from toy_results import analyse

from labbook.lab import Catalogue, LabFolder
from labbook.plan.coverage import finished
from labbook.results.walls import pooled_walls
from labbook.run.runner import Runner
from labbook.study import define

pytestmark = [pytest.mark.compiles, pytest.mark.slow]
GRAINS = {"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 150}
LAW = {"law": "hertz-mindlin", "shear_modulus": "1 MPa", "poisson_ratio": 0.25, "friction": 0.5} | {
    "restitution": 0.2,
    "rolling_friction": 0.0,
}
NUMERICS = {"dt": "20 us", "steps_per_beat": 200}
SIDE = {"name": "side", "shape": {"kind": "frustum", "lower": ["9 mm", "0 mm"], "upper": ["9 mm", "300 mm"]}}
SIDE["motion"] = {"velocity": ["0 m/s", "0 m/s", "5 mm/s"]}
BOTTOM = {"name": "bottom", "shape": {"kind": "frustum", "lower": ["0 mm", "0 mm"], "upper": ["9 mm", "0 mm"]}}


def walls(tmp_path, count=150, **keys):
    """The walls of the only point of a study, and the only run."""
    asked = define(name="walls", grains=GRAINS | {"count": count}, contact=LAW, numerics=NUMERICS, replicates=1, **keys)
    summary = Runner(asked, LabFolder(tmp_path), Backend(wide=True)).run()
    assert summary.done == 1, summary.tally.failed
    (point,) = analyse(asked, finished(Catalogue(tmp_path), asked, "numba")).points
    found = pooled_walls(point)
    assert found is not None
    return found, point.runs[0]


def test_a_silo_is_observed_with_its_lid_before_the_opening(tmp_path):
    silo = {"kind": "conical-silo", "diameter": "24 mm", "height": "120 mm", "angle": "40 deg", "orifice": "15 mm"}
    fill = {"settled_below": 1e-7, "moving": 0.0}
    found, run = walls(tmp_path, container=silo, measure=["flow_rate", "wall_stress"], fill=fill)
    table = run.run.data().tables["traction"]  # as it is read from the folder, and checked
    rest = table["step"] == 0
    layout = found.layout
    assert layout.names.tolist() == ["side", "bottom", "lid"]
    assert table["fz"][rest].sum() == pytest.approx(layout.weight, rel=1e-3)
    assert table["fz"][rest & (table["wall"] == 2)].sum() > 0, "the lid carries a part"
    assert not (table["wall"][~rest] == 2).any(), "and is gone after the opening"
    assert np.diff(np.unique(table["step"])[1:]).min() % 200 == 0
    numbers = {name: run.measured[name].value for name in ("weight_balance", "carried.lid")}
    assert abs(numbers["weight_balance"]) < 1e-3
    assert 0 < numbers["carried.lid"] < 1


def test_friction_is_mobilised_where_walls_have_moved(tmp_path):
    """Rain leaves contacts at walls with friction of either sign; after the motion it points up at most of them.

    Means and standard deviations over 22 beds of rain: 0.006, 0.030; over 21 that were lifted by 0.1 d: 0.226, 0.040.
    """
    silo = {"kind": "cylinder-silo", "diameter": "18 mm", "height": "200 mm", "orifice": "9 mm"}
    fill = {"settled_below": 1e-7, "moving": 0.0}
    numbers = []
    for name, more in (("rain", {}), ("lifted", {"mobilise": {"bottom": "0.1 d", "velocity": "5 mm/s"}})):
        measures = ["flow_rate", "wall_stress"]
        _, run = walls(tmp_path / name, container=silo, measure=measures, fill=fill | more)
        numbers.append({name: run.measured[name].value for name in ("wall_friction", "carried.side")})
        assert run.measured["weight_balance"].value == pytest.approx(0, abs=1e-3)
    rain, after = numbers
    assert rain["wall_friction"] < 0.11 < after["wall_friction"] < 0.5
    assert after["carried.side"] > rain["carried.side"] + 0.1


def test_a_study_without_an_outlet_runs_for_its_time(tmp_path):
    """The surface of its side moves up and so carries weight; at rest it may push down.

    Balance later in eight beds: standard deviation 0.0011 within 0.4 s, but 0.008 within 0.1 s, as the bed moves.
    """
    container = {"kind": "primitives", "parts": [SIDE, BOTTOM]}
    fill = {"settled_below": 1e-7, "moving": 0.0}
    found, run = walls(tmp_path, container=container, measure=["wall_stress"], stop={"max_time": "0.4 s"}, fill=fill)
    assert run.outcome == "time-limit"
    assert run.measured["weight_balance"].value == pytest.approx(0, abs=1e-3)
    rest, later = (found.by_bed(f"{when}_force")[0, 0, 2] / found.layout.weight for when in ("rest", "flow"))
    assert later > rest + 0.1
    assert run.measured["wall_friction_flow"].value > 0.2
    assert run.measured["weight_balance_flow"].value == pytest.approx(0, abs=0.005)


def test_walls_and_outflow_carry_a_fed_bed(tmp_path):
    """Grains that left and are not back yet do not count as weight; 4 % of these grains are.

    In eight beds: mean 0.001, standard deviation 0.006.
    """
    silo = {"kind": "conical-silo", "diameter": "24 mm", "height": "160 mm", "angle": "40 deg", "orifice": "12 mm"}
    _, run = walls(
        tmp_path, container=silo, measure=["flow_rate", "wall_stress"], feed={"kind": "reinject"}, count=300,
        stop={"max_time": "2 s"}, window={"start": 0.5},
    )  # fmt: skip
    assert run.measured["weight_balance_flow"].value == pytest.approx(0, abs=0.02)
