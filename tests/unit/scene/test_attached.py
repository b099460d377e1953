"""Files beside a study: which may be attached, and where their content is found afterwards."""

import hashlib
import os

import pytest
from pydantic import ValidationError

from labbook.scene import attached
from labbook.scene.attached import AttachedError, AttachedFile, StudyFolder
from labbook.scene.model import Model


class _Part(Model):
    file: AttachedFile


def _read(folder, name):
    return _Part.model_validate({"file": name}, context={"units": "required", "beside": StudyFolder(folder)})


def test_a_model_holds_the_hash_of_the_content_and_nothing_of_the_name(tmp_path):
    for name in ("one.csv", "two.csv"):
        (tmp_path / name).write_text("x,y\n")
    one, two = _read(tmp_path, "one.csv"), _read(tmp_path, "two.csv")
    assert one == two
    assert one.file == hashlib.sha256(b"x,y\n").hexdigest()
    assert attached.content(one.file) == b"x,y\n"
    assert _Part.model_validate_json(one.model_dump_json()) == one  # as records are read


def test_a_file_in_a_folder_below_may_be_attached(tmp_path):
    (tmp_path / "walls").mkdir()
    (tmp_path / "walls" / "a.stl").write_bytes(b"solid")
    assert attached.content(_read(tmp_path, "walls/a.stl").file) == b"solid"


@pytest.mark.parametrize("name", ["../secret", "/etc/hostname", "a/../../secret", "./a", "a//b", "", "a\0b"])
def test_paths_outside_the_folder_are_refused(tmp_path, name):
    (tmp_path / "study").mkdir()
    (tmp_path / "secret").write_text("s")
    with pytest.raises(AttachedError, match=r"folder of the study|cannot be read"):
        StudyFolder(tmp_path / "study").attach(name)


def test_links_are_refused_also_as_folders(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "a").write_text("s")
    folder = tmp_path / "study"
    folder.mkdir()
    (folder / "linked").symlink_to(tmp_path / "elsewhere")
    (folder / "a").symlink_to(tmp_path / "elsewhere" / "a")
    for name in ("a", "linked/a"):
        with pytest.raises(AttachedError, match="is a link"):
            StudyFolder(folder).attach(name)


def test_what_is_missing_too_large_or_no_file_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(attached, "MOST_BYTES", 3)
    (tmp_path / "large").write_bytes(b"1234")
    os.mkfifo(tmp_path / "pipe")
    for name, reason in (("large", "4 bytes"), ("pipe", "ordinary file"), ("none", "No such file"), (".", "study")):
        with pytest.raises(AttachedError, match=reason):
            StudyFolder(tmp_path).attach(name)


def test_an_error_in_a_model_has_reason_and_remedy(tmp_path):
    with pytest.raises(ValidationError) as error:
        _read(tmp_path, "none.csv")
    (detail,) = error.value.errors()
    assert detail["type"] == "attached"
    assert "none.csv cannot be read" in detail.get("ctx", {})["reason"]


def test_a_changed_file_is_not_mistaken_for_what_was_attached(tmp_path):
    file = tmp_path / "a"
    file.write_text("first")
    key = StudyFolder(tmp_path).attach("a")
    file.write_text("second")
    with pytest.raises(AttachedError, match="a was changed or removed"):
        attached.content(key)
    copies = tmp_path / "copies"
    copies.mkdir()
    (copies / key).write_text("damaged")
    attached.search(copies)
    with pytest.raises(AttachedError):
        attached.content(key)
    (copies / key).write_text("first")
    assert attached.content(key) == b"first"


def test_another_machine_is_given_the_contents(tmp_path, monkeypatch):
    (tmp_path / "a").write_text("there")
    contents = attached.contents([StudyFolder(tmp_path).attach("a")])
    monkeypatch.setattr(attached, "_paths", {})
    monkeypatch.setattr(attached, "_contents", {})
    (key,) = contents
    with pytest.raises(AttachedError, match="lies in no lab"):
        attached.content(key)
    attached.add(contents[key])
    assert attached.content(key) == b"there"
