"""Pilots: what is run first where an error is asked of scenes that were not measured, and what comes of it."""

import json
import math
import os
import re

import numpy as np
import pytest
from labbook_toy import Backend, Ensemble
from toy_lab import labbook, study, study_file

from labbook.accuracy.regression import Observation, regress
from labbook.api import Lab, PilotNeeded
from labbook.lab import LabFolder, studies
from labbook.results.calibrating import PilotStopped
from labbook.scene import HertzMindlin
from labbook.study import load
from labbook.study.pilot import STEPS, STEPS_SEEDS, first_needed

ASKED = "accuracy: {flow_rate: 40 %, max_replicates: 4}"
NAME = "toy.calibration.json"


def asked_file(folder, *more, **changes):
    """A study that asks for an error, and leaves its step to labbook; of outlets too narrow to have been measured."""
    path = study_file(folder, *(more or (ASKED,)), **{"orifices": "[16.5]", "replicates": 2, **changes})
    path.write_text(path.read_text().replace("dt: 10 us, ", ""))
    return path


@pytest.fixture
def few(monkeypatch):
    """Pilots of few seeds."""
    monkeypatch.setattr("labbook.study.pilot.STEPS_SEEDS", 13)


def test_it_has_two_steps_at_three_of_the_points_that_need_them(tmp_path):
    made = first_needed(load(asked_file(tmp_path, orifices="[14.5, 15, 16, 16.5, 17, 30]")))
    assert made is not None
    assert {point.at["container.orifice"] for point in made.points} == {0.0145, 0.016, 0.017}, "30 mm was measured"
    assert made.points[0].label.startswith("orifice 14.5 mm, ")
    assert len(made.points) == 3 * len(STEPS)
    assert made.replicates == STEPS_SEEDS
    assert {point.numerics.stiffness_scale for point in made.points} == {1.0}
    assert len({repr(point.fill.numerics) for point in made.points}) == 1, "so that the steps share beds"


def test_a_plan_has_its_runs_and_its_time_too(tmp_path):
    path = asked_file(tmp_path, orifices="[15, 16, 17, 30]")
    told = labbook("plan", path, "--lab", tmp_path / "lab", "--backend", "toy").output
    runs = 3 * len(STEPS) * STEPS_SEEDS
    assert re.search(rf"Before that, the pilot: {runs} runs, {STEPS_SEEDS} packings to make; about \d", told)
    asked = json.loads(labbook("plan", path, "--lab", tmp_path / "lab", "--backend", "toy", "--json").output)
    assert asked["pilot"]["counts"] == {"missing": runs}
    assert asked["pilot"]["forecast"]["seconds"] > 0
    known = labbook("plan", asked_file(tmp_path, orifices="[30]"), "--lab", tmp_path / "lab", "--backend", "toy").output
    assert "pilot" not in known


@pytest.mark.parametrize(
    "changes",
    [
        {"more": ("accuracy: {max_replicates: 4}",)},
        {"orifices": "[30]"},
        {"more": (ASKED, "fill: {numerics: {dt: 1 us}}")},
    ],
)
def test_it_is_not_run_where_nothing_is_to_be_chosen_or_all_is_known(tmp_path, changes):
    assert first_needed(load(asked_file(tmp_path, *changes.pop("more", ()), **changes))) is None
    assert first_needed(study(tmp_path, ASKED)) is None, "a step that is stated is kept"


def test_what_was_measured_by_an_older_version_of_the_law_is_measured_again(tmp_path, monkeypatch):
    """An outlet of 30 mm was, by version 2."""
    monkeypatch.setattr(HertzMindlin, "version", 3)
    path = asked_file(tmp_path, orifices="[30]")
    made = first_needed(load(path))
    assert made is not None
    assert {point.at["container.orifice"] for point in made.points} == {0.03}
    told = " ".join(labbook("plan", path, "--lab", tmp_path / "lab", "--backend", "toy").output.split())
    assert "Not calibrated: the law hertz-mindlin has version 3, calibrated: version 2; dt = " in told
    assert "labbook run first measures it by a pilot and chooses again" in told


def test_a_scene_that_cannot_be_calibrated_gets_none(tmp_path):
    path = asked_file(tmp_path)
    with path.open("a") as file:
        file.write("walls: {all: {friction: 0.3}}\n")
    asked = load(path)
    assert asked.points[0].unchosen
    assert first_needed(asked) is None


@pytest.mark.slow
def test_run_measures_first_and_then_runs_what_that_allows(tmp_path, few):
    path, lab = asked_file(tmp_path), tmp_path / "lab"
    planned = labbook("plan", path, "--lab", lab, "--backend", "toy").output
    assert "labbook run first measures it by a pilot" in " ".join(planned.split())
    said = " ".join(labbook("run", path, "--lab", lab, "--backend", "toy").output.split())
    assert "a pilot of 26 runs comes first" in said
    asked = load(path)
    choice = asked.points[0].choice
    assert asked.calibration_file == tmp_path / NAME
    assert choice is not None
    assert "toy-study-pilot, 26 runs" in choice.source
    assert choice.stiffness_scale == 1.0, "what softness does was not measured"
    planned = labbook("plan", path, "--lab", lab, "--backend", "toy").output
    assert "Chosen for 40 %" in planned
    assert "missing" not in planned
    again = labbook("run", path, "--lab", lab, "--backend", "toy").output
    assert "pilot" not in again.partition("Next:")[0]


@pytest.mark.slow
def test_without_it_the_usual_step_is_taken(tmp_path):
    path, lab = asked_file(tmp_path), tmp_path / "lab"
    labbook("run", path, "--lab", lab, "--backend", "toy", "--no-pilot")
    assert not (tmp_path / NAME).exists()
    planned = labbook("plan", path, "--lab", lab, "--backend", "toy").output
    assert "Not calibrated" in planned
    assert "missing" not in planned


def test_what_cannot_be_done_is_said_before_anything_runs(tmp_path, monkeypatch):
    path, lab = asked_file(tmp_path), tmp_path / "lab"
    ended = labbook("run", path, "--lab", lab, "--backend", "toy", "--shard", "1/2", check=False)
    assert ended.exit_code
    assert "labbook pilot" in ended.output
    may = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK and may(path, mode))
    ended = labbook("run", path, "--lab", lab, "--backend", "toy", check=False)
    assert ended.exit_code
    said = " ".join(ended.output.split())
    assert str(tmp_path / NAME) in said.replace(" ", "")
    assert "--out FILE" in said
    assert not (lab / "runs").exists()


@pytest.mark.slow
def test_one_that_was_stopped_goes_on(tmp_path, monkeypatch, few):
    path, lab = asked_file(tmp_path), Lab(tmp_path / "lab", "toy")
    beats, advance = 0, Ensemble.advance

    def interrupted(self, *given):
        nonlocal beats
        beats += 1
        if beats == 30:
            os.kill(os.getpid(), 2)
        return advance(self, *given)

    with monkeypatch.context() as patch:
        patch.setattr("labbook_toy.Ensemble.advance", interrupted)
        with pytest.raises(PilotStopped):
            lab.pilot(load(path), progress=False)
    assert not (tmp_path / NAME).exists()
    assert lab.pilot(load(path), progress=False).points[0].choice is not None


@pytest.mark.slow
def test_a_study_made_in_python_has_its_calibration_in_the_lab(tmp_path, few):
    made, lab = load(asked_file(tmp_path)).change({"name": "made-here"}), Lab(tmp_path / "lab", "toy")
    found = lab.pilot(made, progress=False)
    assert found.points[0].choice is not None
    assert found.calibration_file == (tmp_path / "lab/study-files/made-here.calibration.json").resolve()
    assert first_needed(found) is None
    assert lab.run(found, progress=False).complete


@pytest.mark.slow
@pytest.mark.parametrize("in_python", [True, False])
def test_a_lab_in_python_measures_first_as_the_command_does(tmp_path, few, in_python):
    asked, lab = load(asked_file(tmp_path)), Lab(tmp_path / "lab", "toy")
    asked = asked.change({"name": "made-here"}) if in_python else asked
    summary = lab.run(asked, progress=False)
    assert summary.complete
    assert summary.study is not None
    assert summary.study.points[0].choice is not None, "numerics are chosen by the pilot"
    assert not lab.plan(asked).todo, "also of the study as it was before"
    (point, *_) = lab.results(asked, progress=False).points
    assert point.point.choice is not None
    assert len(point.runs) >= 3


@pytest.mark.slow
def test_a_lab_in_python_leaves_the_pilot_out_if_it_is_told_to(tmp_path, few):
    asked, lab = load(asked_file(tmp_path)), Lab(tmp_path / "lab", "toy")
    summary = lab.run(asked, progress=False, pilot=False)
    assert summary.study is not None
    assert summary.study.points[0].choice is None
    assert not list((tmp_path / "lab").glob("study-files/*-pilot.yaml"))
    with pytest.raises(PilotNeeded, match=r"lab\.pilot"):
        lab.run(asked, progress=False, shard="1/2")


@pytest.mark.slow
def test_the_lab_keeps_it_with_the_study(tmp_path, monkeypatch, few):
    path, lab = asked_file(tmp_path), LabFolder(tmp_path / "lab")
    labbook("run", path, "--lab", lab.folder, "--backend", "toy")
    kept = studies.study_files(lab)["toy-study"]
    beside = studies.calibration(lab, kept)
    assert beside is not None
    assert beside.read_bytes() == (tmp_path / NAME).read_bytes()
    assert load(kept, beside).points[0].numerics == load(path).points[0].numerics
    monkeypatch.setattr("labbook.lab.merge.load", lambda name: Backend())
    other = LabFolder(tmp_path / "other")
    labbook("import", lab.folder, "--lab", other.folder)
    brought = studies.calibration(other, studies.study_files(other)["toy-study"])
    assert brought is not None
    assert brought.read_bytes() == beside.read_bytes()
    studies.keep(lab, "toy-study", "name: toy-study\n")
    assert studies.calibration(lab, kept) is None, "a study without one has none left over"


def test_the_step_alone_says_nothing_of_softness():
    rng, slope = np.random.default_rng(5), 3.0
    runs = [
        Observation(f"bed {bed}", 1e-3, 1e-3, step, math.exp(slope * step**2 + 0.02 * math.sin(bed) + noise))
        for bed in range(16)
        for step, noise in zip((0.02, 0.06), 1e-4 * rng.standard_normal(2), strict=True)
    ]
    found = regress(runs)
    errors = np.sqrt(np.diag(found.covariance))
    assert abs(found.values[1] - slope) < 4 * errors[1] < 0.1
    assert np.all(np.isinf(errors[[0, 2]]))
    assert found.freedom == 32 - 16 - 1
    with pytest.raises(ValueError, match="the step or the precision, and overlap"):
        regress([Observation(one.bed, one.filled, one.overlap + one.step, 0.02, one.rate) for one in runs])
