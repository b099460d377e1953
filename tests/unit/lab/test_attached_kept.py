"""Files that studies name, kept in a lab by their content, and taken over from other labs."""

import pytest

from labbook.lab import studies
from labbook.lab.folder import LabFolder
from labbook.lab.index import Index
from labbook.lab.merge import merge
from labbook.scene import attached
from labbook.scene.attached import AttachedError, StudyFolder

_TEXT = "name: filled\n"


@pytest.fixture(autouse=True)
def _nothing_is_known(monkeypatch):
    for name in ("_paths", "_names", "_contents", "_folders"):
        monkeypatch.setattr(attached, name, {})


def _kept(folder, content=b"x\n1\n"):
    """A lab with a study that names the file start.csv, and the hash of that."""
    folder.mkdir()
    (folder / "start.csv").write_bytes(content)
    beside, lab = StudyFolder(folder), LabFolder(folder / "lab")
    key = beside.attach("start.csv")
    lab.runs.mkdir(parents=True)
    studies.attach(lab, beside.files.values())
    studies.keep(lab, "filled", _TEXT, None, beside.files)
    (folder / "start.csv").unlink()
    return lab, key


def test_the_copy_of_a_study_finds_its_files_in_the_lab(tmp_path):
    lab, key = _kept(tmp_path / "a")
    assert StudyFolder.of(studies.study_path(lab, "filled")).attach("start.csv") == key
    assert attached.content(key) == b"x\n1\n"
    studies.keep(lab, "filled", _TEXT)  # a later text names none
    with pytest.raises(AttachedError, match="cannot be read"):
        StudyFolder.of(studies.study_path(lab, "filled")).attach("start.csv")
    assert attached.content(key) == b"x\n1\n"  # of earlier runs


def test_a_damaged_copy_is_written_again(tmp_path):
    lab, key = _kept(tmp_path / "a")
    (lab.attached / key).write_bytes(b"damaged")
    with pytest.raises(AttachedError, match="no copy is left"):
        studies.attach(lab, [key])
    attached.add(b"x\n1\n")
    studies.attach(lab, [key])
    assert (lab.attached / key).read_bytes() == b"x\n1\n"


def test_import_brings_the_files_of_studies(tmp_path):
    theirs, key = _kept(tmp_path / "theirs")
    mine = LabFolder(tmp_path / "mine" / "lab")
    mine.runs.mkdir(parents=True)
    index = Index(mine)
    merged = merge(index, theirs.folder)
    index.close()
    assert merged.studies == ["filled"]
    assert not merged.left_out
    (theirs.attached / key).unlink()
    assert StudyFolder.of(studies.study_path(mine, "filled")).attach("start.csv") == key
    assert attached.content(key) == b"x\n1\n"


def test_import_leaves_out_links_and_what_was_changed(tmp_path):
    theirs, key = _kept(tmp_path / "theirs")
    (theirs.attached / key).write_bytes(b"other")
    secret = tmp_path / "secret"
    secret.write_text("s")
    linked = attached.key_of(b"s")
    (theirs.attached / linked).symlink_to(secret)
    (theirs.attached / "notes.txt").write_text("no hash")
    mine = LabFolder(tmp_path / "mine")
    mine.runs.mkdir(parents=True)
    index = Index(mine)
    merged = merge(index, theirs.folder)
    index.close()
    assert len(merged.left_out) == 2
    assert any("wrong checksum" in one for one in merged.left_out)
    assert any("it is a link" in one for one in merged.left_out)
    assert not mine.attached.exists()
