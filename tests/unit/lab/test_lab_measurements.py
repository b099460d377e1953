"""Files that a study names, in a lab: kept with it, brought by an import, and noticed if they were changed."""

import pytest
from toy_lab import carry_out, labbook, study_file

from labbook.lab import LabFolder, studies
from labbook.study import StudyError, load

CSV = "container.orifice [mm],value [g/s],error [g/s]\n18,18.9,0.4\n30,60,1\n"


@pytest.fixture
def ran(tmp_path):
    """A lab in which a study with measurements was run, and that study."""
    (tmp_path / "bench").mkdir()
    (tmp_path / "bench/measured.csv").write_text(f"# {tmp_path}\n{CSV}")  # no other lab of this process has the same
    path = study_file(tmp_path, "reference: {file: bench/measured.csv}", count=200, orifices="[24]", replicates=1)
    study = load(path)
    lab = LabFolder(tmp_path / "lab")
    carry_out(study, lab.folder)
    return lab, study


def test_a_lab_keeps_measurements_with_the_study(ran):
    lab, study = ran
    assert load(studies.study_files(lab)["toy-study"]).reference == study.reference
    carry_out(study.change(reference=None), lab.folder)
    assert [file.name for file in lab.studies.iterdir()] == ["toy-study.yaml"]


def test_an_import_brings_them(ran, tmp_path):
    lab, study = ran
    labbook("import", lab.folder, "--lab", tmp_path / "other")
    assert load(studies.study_files(LabFolder(tmp_path / "other"))["toy-study"]).reference == study.reference


def test_a_copy_that_was_changed_is_not_used(ran, tmp_path):
    lab, study = ran
    (tmp_path / "bench/measured.csv").unlink()
    (key,) = study.beside.files.values()
    (lab.attached / key).write_text(CSV.replace("18.9", "19.9"))
    with pytest.raises(StudyError, match="no copy is left"):
        load(studies.study_files(lab)["toy-study"])
