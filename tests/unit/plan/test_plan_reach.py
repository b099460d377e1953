"""How far the stop rule lets a bed discharge, and that a window which ends later is told of."""

from dataclasses import replace
from pathlib import Path

import pytest
from labbook_toy import Backend
from toy_lab import carry_out, labbook, study, study_file
from toy_results import analyse

from labbook.filling.bed import PACKED
from labbook.lab import Catalogue, LabFolder
from labbook.lab.packings import load_packing
from labbook.plan.advice import cut_short
from labbook.plan.coverage import finished
from labbook.plan.demand import PointDemand
from labbook.plan.forecast import discharge_time
from labbook.plan.plan import Planner
from labbook.report.page import summary
from labbook.study import load

STUDIES = Path(__file__).parents[3] / "studies"
PAPERS = sorted(STUDIES.glob("pongo2022-*.yaml"))


def told(asked, lab) -> list[str]:
    return list(cut_short(Planner(asked, Catalogue(lab), Backend().capabilities).plan(), LabFolder(lab)))


@pytest.mark.parametrize("file", PAPERS, ids=lambda file: file.stem)
def test_windows_of_the_rotating_bottom_end_before_the_bed_is_too_low(file):
    asked = load(file)
    for point in asked.points:
        shared = PointDemand(asked, point)
        assert shared.reach() >= asked.window.end, point.label
        if asked.stop.fill_height == pytest.approx(0.095):
            assert shared.reach() < asked.stop.discharged == 1, "the height stops it, as in the paper"


def test_a_bed_discharges_down_to_the_asked_height_or_the_asked_part(tmp_path):
    asked = study(tmp_path, "stop: {fill_height: 20 mm}")
    shared = PointDemand(asked, asked.points[0])
    scene = shared.scene
    ahead = shared.expected_height
    assert ahead is not None
    assert ahead == pytest.approx(200 * scene.grains.volume / (PACKED * 0.06 * 1.01 * 0.003))
    assert shared.reach() == pytest.approx(1 - 0.02 / ahead)
    assert shared.reach(0.025) == pytest.approx(0.2)
    assert shared.reach(1.0) == 0.65, "the part comes first"
    assert shared.reach(0.01) == 0, "it is too low from the start"
    conical = load(STUDIES / "conical-silo.yaml")
    assert PointDemand(conical, conical.points[0]).expected_height is None
    plain = PointDemand(study(tmp_path), asked.points[0])
    assert discharge_time(shared) / discharge_time(plain) == pytest.approx(shared.reach() / 0.65)


def test_a_window_that_outlasts_the_stop_is_told_before_and_with_the_true_height_after(tmp_path):
    lab = tmp_path / "lab"
    asked = study(tmp_path, "stop: {fill_height: 12 mm}")
    (before,) = told(asked, lab)
    assert before.startswith(f"{asked.path}: stop.fill_height: the bed will be, at a packing fraction of {PACKED}, ")
    assert "before the window ends (window.end, 0.6), at orifice 18 mm; orifice 24 mm" in before
    carry_out(asked, lab)
    height = min(2 * load_packing(folder).x[:, 2].mean() for folder in (lab / "packings").iterdir())
    (after,) = told(asked, lab)
    assert f"the bed is {height * 1e3:.3g} mm high" in after
    assert f"with {100 - 1.2 / height:.0f} % discharged" in after
    assert f"stop.fill_height below {0.4 * height * 1e3:.3g} mm, a window.end below {1 - 0.012 / height:.2f}" in after
    lower = replace(asked, stop=asked.stop.model_copy(update={"fill_height": 0.39 * height}))
    assert told(lower, lab) == []
    assert told(replace(asked, stop=asked.stop.model_copy(update={"fill_height": None})), lab) == []


def test_plan_run_and_report_say_so(tmp_path):
    path, lab = study_file(tmp_path, "stop: {fill_height: 48 mm}", replicates=1, count=800), tmp_path / "lab"
    where = f"{path}: stop.fill_height: the bed"
    assert where in labbook("plan", path, "--lab", lab, "--backend", "toy").output
    assert where in labbook("run", path, "--lab", lab, "--backend", "toy").output
    asked = load(path)
    found = analyse(asked, finished(Catalogue(lab), asked, "toy"))
    assert [point.remark for point in found.points] == ["stopped within the window"] * 2
    (sentence,) = (text for text in summary(found) if "stop.fill_height" in text)
    assert "D = 18 mm; D = 24 mm" in sentence
    assert sentence.endswith("lower stop.fill_height or window.end in toy.yaml.")
    whole = study(tmp_path, replicates=1)
    carry_out(whole, tmp_path / "whole")
    found = analyse(whole, finished(Catalogue(tmp_path / "whole"), whole, "toy"))
    assert not any("stop.fill_height" in text for text in summary(found))
