"""Files that a study names, in a lab: kept with it, brought by an import, and noticed if they were changed."""

import json

import pytest
from toy_lab import carry_out, labbook, study_file

from labbook.lab import LabFolder, studies
from labbook.study import StudyError, attached, load

CSV = "container.orifice [mm],value [g/s],error [g/s]\n18,18.9,0.4\n30,60,1\n"


@pytest.fixture
def ran(tmp_path):
    """A lab in which a study with measurements was run, and that study."""
    (tmp_path / "bench").mkdir()
    (tmp_path / "bench/measured.csv").write_text(CSV)
    path = study_file(tmp_path, "reference: {file: bench/measured.csv}", count=200, orifices="[24]", replicates=1)
    study = load(path)
    lab = LabFolder(tmp_path / "lab")
    carry_out(study, lab.folder)
    return lab, study


def test_a_lab_keeps_measurements_with_the_study(ran):
    lab, study = ran
    kept = load(studies.kept(lab)["toy-study"])
    assert kept.reference == study.reference
    assert kept.files == {"bench/measured.csv": CSV}
    without = study.change(reference=None)
    carry_out(without, lab.folder)
    assert [file.name for file in lab.studies.iterdir()] == ["toy-study.yaml"]


def test_an_import_brings_them(ran, tmp_path):
    lab, study = ran
    labbook("import", lab.folder, "--lab", tmp_path / "other")
    assert load(studies.kept(LabFolder(tmp_path / "other"))["toy-study"]).reference == study.reference


def test_a_copy_that_was_changed_is_not_used(ran):
    lab, _ = ran
    path = studies.kept(lab)["toy-study"]
    held = path.with_suffix(attached.COPY)
    record = json.loads(held.read_text())
    record["bench/measured.csv"]["text"] = CSV.replace("18.9", "19.9")
    held.write_text(json.dumps(record))
    with pytest.raises(StudyError, match="was changed after it was kept"):
        load(path)
    held.write_text("{}")
    with pytest.raises(StudyError, match="no such file beside the study"):
        load(path)
    held.write_text("[")
    with pytest.raises(StudyError, match="not the files of a study"):
        load(path)
