"""Versions of laws and walls: part of keys where they are above 1, kept with what was made, never mixed in a mean."""

import json

import pytest
from labbook_toy import Backend
from toy_lab import carry_out, labbook, study, study_file

from labbook.lab import Catalogue, LabFolder, identity
from labbook.lab.packings import PackingRecord
from labbook.lab.runs import open_run
from labbook.plan.plan import Planner
from labbook.results.calibrating import NotCalibrated, calibrate
from labbook.results.find import find
from labbook.results.frames import frames
from labbook.scene import HertzLiggghts, HertzMindlin, LinearSpringDashpot, Plane, Scene, Spheres, WedgeHopper
from labbook.scene.model import canonical

HOPPER = WedgeHopper(width=0.1, height=0.4, thickness=3.1e-3, orifice=0.03, angle=1.0)
MINDLIN = HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25, friction=0.5, restitution=0.2)
WHY = "law hertz-mindlin version 1, now 2: sliding contacts carry mu F_n"


def scene(law):
    return Scene(grains=Spheres(diameter=3e-3, density=2500, count=10), contact=law, container=HOPPER)


def plan(asked, lab):
    return Planner(asked, Catalogue(lab), Backend().capabilities).plan()


def test_a_version_above_1_is_part_of_the_key_of_a_scene_and_no_other_is():
    linear = scene(LinearSpringDashpot(normal_stiffness=1e4))
    assert identity.versions(linear) == {}
    assert identity.scene_key(linear) == identity.scene_key(linear, {})
    assert "version" not in canonical(identity.scene_identity(linear))
    mindlin, now = scene(MINDLIN), {"law hertz-mindlin": 2}
    assert identity.versions(mindlin) == now
    assert identity.scene_key(mindlin) == identity.scene_key(mindlin, now) != identity.scene_key(mindlin, {})
    assert json.loads(canonical(identity.scene_identity(mindlin)))["contact"]["version"] == 2
    assert len({identity.scene_key(mindlin, {"law hertz-mindlin": version}) for version in (1, 2, 3)}) == 3


def test_a_version_of_a_wall_counts_for_the_scenes_that_have_it(monkeypatch):
    linear = scene(LinearSpringDashpot(normal_stiffness=1e4))
    before = identity.scene_key(linear)
    monkeypatch.setattr(Plane, "version", 3)
    monkeypatch.setattr(Plane, "changes", {2: "rims turn", 3: "rims rub"})
    assert identity.versions(linear) == {"wall plane": 3}
    assert identity.scene_key(linear, {}) == before != identity.scene_key(linear)
    walls = json.loads(canonical(identity.scene_identity(linear)))["walls"]
    assert {wall["shape"].get("version") for wall in walls if wall["shape"]["kind"] == "plane"} == {3}
    assert all("version" not in wall["shape"] for wall in walls if wall["shape"]["kind"] != "plane")
    assert identity.outdated({}, {"wall plane": 3}) == "wall plane version 1, now 3: rims turn; rims rub"
    assert identity.outdated({"wall plane": 2}, {"wall plane": 3}) == "wall plane version 2, now 3: rims rub"
    assert identity.outdated({"wall plane": 3}, {"wall plane": 3}) == ""


def test_older_versions_are_all_combinations_the_newest_first():
    assert list(identity.older({})) == []
    assert list(identity.older({"law a": 2, "wall b": 3})) == [
        {"law a": 2, "wall b": 2}, {"law a": 2}, {"wall b": 3}, {"wall b": 2}, {},
    ]  # fmt: skip


def test_runs_by_an_older_version_are_stale_and_enter_no_mean_of_newer_ones(tmp_path, monkeypatch):
    lab = tmp_path / "lab"
    with monkeypatch.context() as then:
        then.setattr(HertzMindlin, "version", 1)
        carry_out(study(tmp_path, replicates=3), lab)
        assert plan(study(tmp_path, replicates=3), lab).counts() == {"done": 6}
    old = set(map(str, (lab / "runs").iterdir()))
    made = plan(study(tmp_path, replicates=3), lab)
    assert {(item.state, item.reason) for item in made.items} == {("stale", WHY)}
    only_old = find(study(tmp_path, replicates=3), Catalogue(lab), "toy")
    assert only_old.stale == {WHY: 6}
    assert {len(point.runs) for point in only_old.points} == {3}
    with pytest.raises(NotCalibrated, match="its runs are stale"):
        calibrate("toy", only_old.points)
    shown = frames(only_old)
    assert all(shown["points"]["stale"])
    assert all(shown["runs"]["stale"])
    carry_out(study(tmp_path, replicates=1), lab)
    mixed = find(study(tmp_path, replicates=3), Catalogue(lab), "toy")
    assert not mixed.stale
    assert {len(point.runs) for point in mixed.points} == {1}
    assert not {str(lab / "runs" / run.run_key) for point in mixed.points for run in point.runs} & old
    assert plan(study(tmp_path, replicates=3), lab).counts() == {"done": 2, "stale": 4}


def test_old_records_say_nothing_of_versions_and_stay_readable(tmp_path, monkeypatch):
    lab = LabFolder(tmp_path / "lab")
    for version, stored in ((1, None), (2, {"law hertz-mindlin": 2})):
        monkeypatch.setattr(HertzMindlin, "version", version)
        before = {folder.name for folder in lab.runs.glob("*")}
        carry_out(study(tmp_path, orifices="[24]", replicates=1), lab.folder)
        (key,) = {folder.name for folder in lab.runs.glob("*")} - before
        record, _ = open_run(lab.run(key))
        for file in (lab.run(key) / "run.json", lab.packing(record.packing_key) / PackingRecord.FILE):
            assert json.loads(file.read_text()).get("versions") == stored
    monkeypatch.setattr(HertzMindlin, "version", 3)
    for folder in lab.runs.glob("*"):
        open_run(folder)


def test_a_filling_by_an_older_law_makes_its_runs_stale(tmp_path, monkeypatch):
    lab = tmp_path / "lab"
    more = "fill: {contact: {law: hertz-mindlin, shear_modulus: 2 MPa, poisson_ratio: 0.25, restitution: 0.2}}"
    path = study_file(tmp_path, more, orifices="[24]", replicates=1)
    path.write_text(path.read_text().replace("contact: {law: hertz-mindlin", "contact: {law: hertz-liggghts", 1))
    with monkeypatch.context() as then:
        then.setattr(HertzMindlin, "version", 1)
        labbook("run", path, "--lab", lab, "--backend", "toy")
    (item,) = json.loads(labbook("plan", path, "--lab", lab, "--backend", "toy", "--json").stdout)["runs"]
    assert (item["state"], item["reason"]) == ("stale", WHY)
    assert identity.versions(scene(HertzLiggghts(shear_modulus=1e8, poisson_ratio=0.25))) == {}


@pytest.mark.parametrize("backend_too", [False, True])
def test_the_newest_law_counts_before_the_newest_backend(tmp_path, monkeypatch, backend_too):
    """A run by the law as it is now and an older backend is shown rather than one by an older law."""
    lab = tmp_path / "lab"
    with monkeypatch.context() as then:
        then.setattr(HertzMindlin, "version", 1)
        carry_out(study(tmp_path, replicates=1), lab, backend=Backend(version=2 if backend_too else 1))
    carry_out(study(tmp_path, replicates=1), lab)
    found = find(study(tmp_path, replicates=1), Catalogue(lab), "toy")
    assert {(run.outdated, run.cache_version) for point in found.points for run in point.runs} == {("", 1)}
