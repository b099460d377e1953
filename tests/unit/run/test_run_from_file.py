"""A study that starts from a file: its keys, its copy in the lab, on a worker, on another machine, in two processes."""

import numpy as np
import pytest
from labbook_toy import Backend
from toy_lab import arrays, carry_out, labbook, study

from labbook.filling import place
from labbook.lab import LabFolder, studies
from labbook.lab.packings import PackingRecord
from labbook.plan.demand import PointDemand
from labbook.run.cluster import Task
from labbook.run.cluster import carry_out as on_worker
from labbook.run.slurm import expected
from labbook.scene import attached
from labbook.study import Study, StudyError, load

SMALL = {"count": 60, "orifices": "[24]", "replicates": 1}


def filled(folder, name="grains.csv", shift="", start="gas", more=()) -> Study:
    """A study of 60 grains whose start is a file in its folder."""
    folder.mkdir(exist_ok=True)
    (point,) = study(folder, **SMALL).points
    x = place(point.scene.close(), start, 1).x
    np.savetxt(folder / name, 1e3 * x, "%.17g", ",", header="x [mm],y [mm],z [mm]", comments="")
    return study(folder, f"fill: {{kind: file, file: {name}{shift}}}", *more, **SMALL)


def keys(asked: Study):
    (point,) = asked.points
    return PointDemand(asked, point).run(1).keys(Backend().capabilities)


@pytest.fixture
def elsewhere(monkeypatch):
    """Forget where files are, as another process does."""

    def forget():
        for known in ("_paths", "_names", "_contents", "_folders"):
            monkeypatch.setattr(attached, known, {})

    return forget


def test_the_key_of_a_packing_has_the_content_and_the_shift_and_not_the_name(tmp_path):
    one, renamed = filled(tmp_path / "a"), filled(tmp_path / "b", "other.csv")
    shifted = filled(tmp_path / "c", shift=", shift: [0 mm, 0 mm, 1 mm]")
    dense = filled(tmp_path / "d", start="rain")
    assert keys(one) == keys(renamed)
    assert len({keys(each).packing for each in (one, shifted, dense)}) == 3
    assert keys(one).scene == keys(dense).scene


def test_a_run_begins_at_the_positions_and_the_lab_has_the_file(tmp_path, elsewhere):
    asked, lab = filled(tmp_path / "a"), LabFolder(tmp_path / "lab")
    assert not carry_out(asked, lab.folder).tally.failed
    (tmp_path / "a/grains.csv").unlink()
    elsewhere()
    again = load(studies.study_files(lab)["toy-study"])
    assert keys(again) == keys(asked)
    record = PackingRecord.read(lab.packing(keys(asked).packing))
    assert record.filling.file == asked.points[0].fill.grain_file
    assert '"file"' in (lab.packing(keys(asked).packing) / "packing.json").read_text()
    # without its packings, from the copy alone
    assert not carry_out(again, tmp_path / "second").tally.failed
    assert arrays(LabFolder(tmp_path / "second").run(keys(asked).run)) == arrays(lab.run(keys(asked).run))


def test_records_of_other_starts_stay_as_they_were(tmp_path):
    asked = study(tmp_path, **SMALL)
    carry_out(asked, tmp_path / "lab")
    text = (LabFolder(tmp_path / "lab").packing(keys(asked).packing) / "packing.json").read_text()
    assert '"file"' not in text
    assert not (tmp_path / "lab/attached").exists()


def test_a_worker_of_another_machine_is_given_the_file(tmp_path, elsewhere):
    asked = filled(tmp_path / "a")
    carry_out(asked, tmp_path / "lab")
    content = attached.contents(asked.beside.files.values())
    (tmp_path / "a/grains.csv").unlink()
    elsewhere()
    stated = expected(asked, Backend().capabilities)
    task = Task(asked, "toy", "cpu", stated, {0: ((1, 1),)}, {}, {}, {}, 300.0, "never", content)
    back = on_worker(task)
    assert not back.refused
    assert not back.failed
    assert [*back.runs] == [keys(asked).run]


def test_another_content_is_another_study_to_a_task_of_slurm(tmp_path):
    asked, other = filled(tmp_path / "a"), filled(tmp_path / "b", start="rain")
    assert asked.text == other.text
    assert expected(asked, Backend().capabilities) != expected(other, Backend().capabilities)


def test_an_imported_study_finds_its_file(tmp_path, elsewhere):
    asked = filled(tmp_path / "a")
    carry_out(asked, tmp_path / "theirs")
    labbook("import", tmp_path / "theirs", "--lab", tmp_path / "mine")
    elsewhere()
    (tmp_path / "a/grains.csv").unlink()
    (tmp_path / "theirs").rename(tmp_path / "gone")
    mine = LabFolder(tmp_path / "mine")
    assert keys(load(studies.study_files(mine)["toy-study"])) == keys(asked)
    shown = labbook("plan", mine.folder / "study-files/toy-study.yaml", "--lab", mine.folder, "--backend", "toy")
    assert "1 done" in shown.stdout


def test_two_processes_place_and_write_beside_each_other(tmp_path, monkeypatch):
    asked = filled(tmp_path / "a", more=("discharges_per_bed: 3",))
    summary = carry_out(asked, tmp_path / "lab", workers=2)
    assert not summary.tally.failed
    assert len(summary.tally.ran) == 3


def test_a_file_is_one_bed(tmp_path):
    folder = tmp_path / "a"
    filled(folder)
    with pytest.raises(StudyError, match="discharges_per_bed: 3 or more"):
        study(folder, "fill: {kind: file, file: grains.csv}", **{**SMALL, "replicates": 2})
    with pytest.raises(StudyError, match=r"accuracy\.flow_rate: .*a file is one bed"):
        study(folder, "fill: {kind: file, file: grains.csv}", "accuracy: {flow_rate: 3 %}", **SMALL)


@pytest.mark.parametrize(
    ("fill", "message"),
    [
        ("{kind: file}", r"toy\.yaml:\d+: fill\.file: this key is missing"),
        ("{kind: rain, file: grains.csv}", r"fill\.file: a rain start reads no file"),
        ("{kind: gas, shift: [0 mm, 0 mm, 1 mm]}", r"fill\.shift: a gas start reads no file"),
        ("{kind: file, file: ../grains.csv}", r"toy\.yaml:\d+: fill\.file: .*not a path within the folder"),
        ("{kind: file, file: none.csv}", r"fill\.file: .*none\.csv cannot be read: No such file"),
        ("{kind: file, file: toy.yaml}", r"fill\.file: toy\.yaml: .*the headings x"),
        ("{kind: file, file: grains.csv, shift: [1 m, 0 mm, 0 mm]}", r"fill\.file: 60 grains lie outside"),
    ],
)
def test_what_cannot_start_is_refused_before_anything_runs(tmp_path, fill, message):
    filled(tmp_path)
    with pytest.raises(StudyError, match=message):
        study(tmp_path, f"fill: {fill}", **SMALL)
