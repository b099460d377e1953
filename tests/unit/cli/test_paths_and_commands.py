"""Paths that users give in Python, and commands that messages and pages give them to copy."""

import shlex
from pathlib import Path

import pytest
from toy_lab import labbook as verb
from toy_lab import study, study_file

import labbook
from labbook.commands import command
from labbook.lab import Catalogue, LabFolder, NoCatalogue


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A home folder, and another one to work in."""
    (tmp_path / "home").mkdir()
    (tmp_path / "here").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "home"


@pytest.mark.slow
def test_a_tilde_is_the_home_folder_in_every_path(home, one_format):
    asked = study(home, "fit: [beverloo]", orifices="[24]")
    assert labbook.load("~/toy.yaml") == asked
    assert asked.save("~/copy.yaml") == home / "copy.yaml"
    lab = labbook.Lab("~/my lab", "toy")
    assert lab.folder == home / "my lab"
    lab.run(asked, progress=False)
    labbook.Lab("~/second", "toy").run(asked, progress=False, base="~/my lab")
    results = lab.results(asked, progress=False)
    assert results.report("~/report").parent == home / "report"
    assert {path.parent for path in results.export("~/tables")} == {home / "tables"}
    verb("runs", "--lab=~/my lab")
    assert not list(Path().iterdir()), "and no folder is called ~"
    assert not list((home / "second/runs").glob("*")), "the runs of the base are not repeated"


@pytest.mark.parametrize("given", [None, 3, b"lab"])
def test_what_is_no_path_is_refused_when_the_lab_is_made(given):
    with pytest.raises(TypeError, match="Lab: folder: a path is needed"):
        labbook.Lab(given)
    with pytest.raises(TypeError, match="load: a path is needed"):
        labbook.load(given)


def test_an_empty_path_is_refused():
    with pytest.raises(ValueError, match="folder: the path is empty"):
        labbook.Lab("")
    with pytest.raises(ValueError, match="labbook-has-no-such-user"):
        labbook.Lab("~labbook-has-no-such-user/lab")


def test_a_command_is_one_that_a_shell_understands():
    said = command("run", Path("my studies/it's.yaml"), lab="my lab", backend="toy")
    words = ["labbook", "run", "my studies/it's.yaml", "--lab", "my lab", "--backend", "toy"]
    assert shlex.split(said) == words
    assert command("view", "40b1158f", lab="lab") == "labbook view 40b1158f --lab lab"


def test_commands_of_messages_are_quoted_and_name_the_lab(tmp_path):
    lab = tmp_path / "my lab"
    (tmp_path / "a b").mkdir()
    path = study_file(tmp_path / "a b", orifices="[24]")
    ended = verb("run", path, "--lab", lab, "--backend", "toy")
    said = ended.stdout.partition("Next: ")[2].splitlines()[0]
    assert shlex.split(said) == ["labbook", "report", str(path), "--lab", str(lab), "--backend", "toy"]
    (lab / "catalogue.db").unlink()
    with pytest.raises(NoCatalogue) as error:
        Catalogue(LabFolder(lab)).runs()
    assert shlex.split(str(error.value).partition("again: ")[2]) == ["labbook", "reindex", "--lab", str(lab)]
