"""Beds that are filled by other numerics than those of the flow: `fill.numerics`."""

import pytest
from toy_lab import carry_out
from toy_lab import study as toy_study

from labbook.backend import Capabilities
from labbook.lab.folder import LabFolder
from labbook.lab.packings import PackingRecord
from labbook.lab.records import RunRecord
from labbook.plan.demand import PointDemand
from labbook.study import define
from labbook.study.load import StudyError

EMPTY = frozenset[str]()
NUMBA, WARP = (Capabilities(name, 1, EMPTY, EMPTY, EMPTY, EMPTY, ()) for name in ("numba", "warp"))


def study(**keys):
    stated = {
        "name": "steps",
        "grains": {"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 100},
        "contact": {"law": "hertz-mindlin", "shear_modulus": "100 MPa", "poisson_ratio": 0.25, "friction": 0.5,
                    "rolling_friction": 0.01, "restitution": 0.2},
        "container": {"kind": "wedge-hopper", "width": "30 mm", "height": "60 mm", "thickness": "1.01 d",
                      "orifice": "20 mm"},
    }  # fmt: skip
    return define(stated | keys)


def packings(one, backend=NUMBA):
    return [PointDemand(one, point).run(1).keys(backend).packing for point in one.points]


def test_runs_of_several_steps_start_from_the_same_bed():
    sweep = {"numerics.dt": "[1.25, 2.5, 5] us"}
    assert len(set(packings(study(sweep=sweep)))) == 3
    shared = study(sweep=sweep, fill={"numerics": {"dt": "5 us"}})
    assert len(set(packings(shared))) == 1
    assert packings(shared)[0] == packings(study(numerics={"dt": "5 us"}))[0]
    runs = {PointDemand(shared, point).run(1).keys(NUMBA).run for point in shared.points}
    assert len(runs) == 3


def test_two_backends_do_not_share_a_bed_because_it_has_numerics_of_its_own():
    one = study(fill={"numerics": {"dt": "5 us"}})
    assert packings(one, NUMBA) != packings(one, WARP)


def test_keys_are_those_that_the_backends_version_gives():
    one = study(fill={"numerics": {"dt": "5 us"}})
    demand = PointDemand(one, one.points[0]).run(1)
    assert demand.run_key("numba", 1) == demand.keys(NUMBA).run
    assert demand.lineage("numba") == demand.keys(NUMBA).lineage


def test_what_the_filling_leaves_out_is_that_of_the_flow():
    one = study(numerics={"precision": "mixed", "dt": "0.05 rayleigh"}, fill={"numerics": {"stiffness_scale": 4}})
    flow, fill = one.points[0].numerics, PointDemand(one, one.points[0]).filling_numerics
    assert (fill.precision, fill.stiffness_scale) == ("mixed", 4)
    assert fill.dt == pytest.approx(flow.dt / 2)  # the Rayleigh time goes as one over the root of the modulus


def test_a_filling_that_states_no_numerics_is_stored_as_before():
    assert "numerics" not in study().points[0].fill.model_dump(mode="json")
    assert packings(study()) == packings(study(fill={"numerics": {}}))


def test_a_step_of_its_own_leaves_that_of_the_flow_alone():
    with pytest.raises(StudyError, match=r"fill\.numerics\.dt.*beds do not come to rest"):
        study(fill={"numerics": {"dt": "50 us"}})
    assert study(fill={"numerics": {"dt": "5 us"}}).points[0].numerics.dt == study().points[0].numerics.dt


def test_beds_softer_than_the_flow_are_refused():
    with pytest.raises(StudyError, match=r"fill\.numerics\.stiffness_scale: grains 10 times softer"):
        study(fill={"numerics": {"stiffness_scale": 0.1}})
    assert study(numerics={"stiffness_scale": 0.1}, fill={"numerics": {"stiffness_scale": 1}})


def test_unknown_keys_are_named_where_they_stand():
    with pytest.raises(StudyError, match=r"fill\.numerics\.step: unknown key"):
        study(fill={"numerics": {"step": "5 us"}})


def test_a_sweep_may_vary_the_step_of_the_filling():
    one = study(sweep={"fill.numerics.dt": "[2.5, 5] us"})
    assert [PointDemand(one, point).filling_numerics.dt for point in one.points] == [2.5e-6, 5e-6]
    assert [point.at["fill.numerics.dt"] for point in one.points] == [2.5e-6, 5e-6]
    assert len(set(packings(one))) == 2


def test_the_runner_fills_by_the_one_and_flows_by_the_other(tmp_path):
    one = toy_study(tmp_path, "fill: {numerics: {dt: 0.02 ms}}", replicates=1, orifices="[24]")
    own = one.points[0].numerics
    assert own.dt != 2e-5
    summary = carry_out(one, tmp_path / "lab")
    assert summary.complete
    lab = LabFolder(tmp_path / "lab")
    (packing,) = (PackingRecord.read(folder) for folder in lab.packings.iterdir())
    (run,) = (RunRecord.read(folder) for folder in lab.runs.iterdir())
    assert (packing.numerics.dt, run.numerics.dt) == (2e-5, own.dt)
    assert carry_out(one, tmp_path / "lab").tally.packings == 0
