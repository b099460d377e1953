"""Calibrations of one's own: the pilot of a study, `labbook pilot`, and `accuracy.calibration`."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from toy_lab import labbook, study_file
from toy_results import analyse

from labbook.accuracy import groups
from labbook.api import Lab
from labbook.backend.numerics import Numerics
from labbook.plan.demand import PointDemand
from labbook.results.calibrating import NotCalibrated, calibrate
from labbook.study import load
from labbook.study.load import StudyError
from labbook.study.pilot import SETTINGS, is_pilot, pilot
from labbook.study.schema import Fill


def test_the_pilot_has_the_first_the_middle_and_the_last_point_in_every_setting(tmp_path):
    study = load(study_file(tmp_path, "accuracy: {flow_rate: 1 %}", orifices="[18, 19, 20, 22, 24]"))
    made = pilot(study, 5)
    assert len(made.points) == 3 * len(SETTINGS)
    assert {point.at["container.orifice"] for point in made.points} == {0.018, 0.020, 0.024}
    assert (made.replicates, made.accuracy.flow_rate, made.measure) == (5, None, ("flow_rate",))
    assert is_pilot(made)
    assert not is_pilot(study)
    scales = [(p.numerics.stiffness_scale, p.fill.numerics.stiffness_scale) for p in made.points if p.fill.numerics]
    assert scales == [(scale, filled) for scale, _, filled in SETTINGS for _ in range(3)]


def test_settings_that_fill_alike_share_their_beds(tmp_path):
    made = pilot(load(study_file(tmp_path)), 3)
    filled = {
        (PointDemand(made, point).closed_key, PointDemand(made, point).filling_numerics.model_dump_json())
        for point in made.points
    }
    assert len(filled) == len({setting[2] for setting in SETTINGS})


def test_a_calibration_finds_what_was_put_into_the_runs(synthetic):
    """Synthetic runs whose outlets are chosen so that W depends on overlap and step by known slopes."""
    base = synthetic.point(0, 0.03)
    wanted = np.array([1.2, 6.0])
    points, rates = [], {}
    for index, (scale, dt) in enumerate(((1, 2e-6), (1, 6e-6), (0.3, 4e-6), (0.1, 8e-6), (0.03, 1.5e-5))):
        numerics = Numerics(dt=dt, stiffness_scale=scale)
        at = {"numerics.dt": dt, "numerics.stiffness_scale": float(scale)}
        points.append(replace(base, index=index, numerics=numerics, fill=Fill(numerics=Numerics(dt=2e-6)), at=at))
        here = groups(base.scene, dt, scale)
        assert here is not None
        rates[index] = math.exp(wanted @ [here.overlap, here.step**2])
    study = synthetic.study_of(points, replicates=8, reference=None, fit=())
    runs = [synthetic.FinishedDouble(p, s) for p in points for s in range(1, 9)]
    results = analyse(study, runs)
    rng = np.random.default_rng(3)
    scaled = []
    for result in results.points:
        made = []
        for run in result.runs:
            bed = 1 + 0.02 * math.sin(run.seed)
            value = rates[result.point.index] * bed * (1 + 1e-4 * rng.standard_normal())
            measured = {**run.measured, "flow_rate": replace(run.measured["flow_rate"], value=value)}
            made.append(replace(run, measured=measured))
        scaled.append(replace(result, runs=tuple(made)))
    (found,) = calibrate("known", scaled)
    errors = np.sqrt(np.diag(found.slopes.covariance))[:2]
    assert np.all(np.abs(found.slopes.values[:2] - wanted) < 4 * errors)
    assert np.all(errors < 0.1 * wanted)
    assert found.effects.kinds == ("sphere", "slot", "hertz-mindlin", 2)
    assert len(found.changes) == 5
    assert found.changes[4].change == pytest.approx(math.log(rates[4] / rates[0]), abs=1e-3)
    with pytest.raises(NotCalibrated, match="too few"):
        calibrate("alone", scaled[:1])


def test_scenes_that_cannot_be_calibrated_are_refused_before_anything_runs(tmp_path):
    path = study_file(tmp_path, "walls: {all: {friction: 0.1}}", "accuracy: {flow_rate: 1 %}", orifices="[24]")
    path.write_text(path.read_text().replace("dt: 10 us, steps_per_beat: 200, ", ""))
    said = labbook("plan", path, "--lab", tmp_path / "lab", "--backend", "toy").output
    assert "Cannot be calibrated" in said
    assert "labbook pilot" not in said
    refused = labbook("pilot", path, "--lab", tmp_path / "lab", "--backend", "toy", check=False)
    assert refused.exit_code
    assert "cannot be calibrated" in refused.output
    assert not list((tmp_path / "lab").glob("runs/*"))


def test_the_verb_writes_a_file_that_the_study_can_name(tmp_path):
    path = study_file(tmp_path, orifices="[24]", count=200)
    said = labbook("pilot", path, "--lab", tmp_path / "lab", "--backend", "toy", "--seeds", 4).output
    written = tmp_path / "toy.calibration.json"
    assert f"Written: {written}" in said
    assert f"Next, in {path}: accuracy: {{flow_rate: 1 %}}" in said
    (entry,) = json.loads(written.read_text())["effects"]
    assert entry["scene"]["ratio"] == pytest.approx(8.0)
    with path.open("a") as file:
        file.write("accuracy: {flow_rate: 10 %, calibration: toy.calibration.json}\n")
    path.write_text(path.read_text().replace("dt: 10 us, steps_per_beat: 200, ", ""))
    point = load(path).points[0]
    assert point.choice is not None
    assert "toy-study-pilot" in point.choice.source
    assert "Chosen for 10 %" in labbook("plan", path, "--lab", tmp_path / "lab", "--backend", "toy").output


@pytest.mark.slow
def test_python_has_one_method_for_pilots(tmp_path):
    asked, lab = load(study_file(tmp_path, orifices="[24]", count=200)), Lab(tmp_path / "lab", "toy")
    assert not hasattr(lab, "calibrate")
    assert lab.pilot(asked, progress=False) is asked, "it requests no error, so that it needs none"
    made = lab.pilot(asked, progress=False, seeds=4)
    assert made.calibration_file == tmp_path / "toy.calibration.json"
    assert len(lab.frame(f"{asked.name}-pilot")) == 4 * len(SETTINGS)


@pytest.mark.parametrize(
    ("text", "said"), [(None, "No such file"), ("{}", "not a calibration file"), ("{", "Expecting")]
)
def test_a_calibration_that_cannot_be_read_is_named_with_its_key(tmp_path, text, said):
    if text is not None:
        (tmp_path / "mine.json").write_text(text)
    with pytest.raises(StudyError, match=rf"toy.yaml:\d+: accuracy.calibration: .*{said}"):
        load(study_file(tmp_path, "accuracy: {flow_rate: 1 %, calibration: mine.json}"))


def test_a_forecast_of_replicates_that_was_wrong_is_told(tmp_path):
    path = study_file(tmp_path, orifices="[24]", count=200)
    labbook("pilot", path, "--lab", tmp_path / "lab", "--backend", "toy", "--seeds", 4)
    written = tmp_path / "toy.calibration.json"
    stored = json.loads(written.read_text())
    stored["effects"][0] |= {"scatter": 0.5, "slopes": [0, 0, 0], "covariance": [[0, 0, 0]] * 3}
    written.write_text(json.dumps(stored))
    with path.open("a") as file:
        file.write("accuracy: {flow_rate: 30 %, calibration: toy.calibration.json}\n")
    path.write_text(path.read_text().replace("dt: 10 us, steps_per_beat: 200, ", ""))
    said = labbook("run", path, "--lab", tmp_path / "lab", "--backend", "toy").output
    assert "were expected, from a scatter of 50.00 %" in " ".join(said.split())
