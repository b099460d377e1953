"""The texts of studies that a lab keeps: which, when they are written, and what an import makes of them."""

import errno
import os
import shutil
from pathlib import Path

import pytest
from labbook_toy import Backend
from toy_lab import carry_out, labbook, study, study_file
from toy_pair import compared

from labbook.api import Lab
from labbook.checks.compare.compare import select_points
from labbook.lab import DiskFull, LabFolder, studies
from labbook.plan.demand import PointDemand
from labbook.run.watch import NullWatcher, View
from labbook.study import Study, define, load

SMALL = {"count": 200, "orifices": "[24]", "replicates": 1}
COMMENT = "# why 24 mm: the smallest outlet that never clogs (μ = 0.5)\n"


def commented(folder: Path, **changes) -> Path:
    """A study file with a comment, and ends of lines as Windows has them."""
    path = study_file(folder, **{**SMALL, **changes})
    path.write_bytes((COMMENT + path.read_text()).replace("\n", "\r\n").encode())
    return path


def keys(asked: Study) -> list[str]:
    """Keys of the first replicate of every point on the toy backend."""
    return [PointDemand(asked, point).run(1).keys(Backend().capabilities).run for point in asked.points]


class Said(NullWatcher):
    """What a runner said, and when its first job was going on."""

    def __init__(self, lab: LabFolder):
        self.lab, self.lines, self.there = lab, [], []

    def show(self, view: View) -> None:
        self.there.append(bool(studies.study_files(self.lab)))

    def tell(self, line: str) -> None:
        self.lines.append(line)


def test_a_run_keeps_its_study_as_its_author_wrote_it(tmp_path):
    path, lab = commented(tmp_path, orifices="[18, 24]"), LabFolder(tmp_path / "lab")
    labbook("run", path, "--lab", lab.folder, "--backend", "toy")
    assert studies.study_files(lab) == {"toy-study": lab.folder / "study-files/toy-study.yaml"}
    kept = studies.study_files(lab)["toy-study"]
    assert kept.read_bytes() == path.read_bytes()
    again, asked = load(kept), load(path)
    assert again.points == asked.points
    assert keys(again) == keys(asked)
    assert [folder.name for folder in kept.parent.iterdir()] == ["toy-study.yaml"]
    assert labbook("run", kept, "--lab", lab.folder, "--backend", "toy").stdout.startswith("2 of 2 runs done\n")


def test_it_is_kept_before_the_first_run_begins(tmp_path):
    lab = LabFolder(tmp_path / "lab")
    said = Said(lab)
    carry_out(load(commented(tmp_path)), lab.folder, watcher=said, backend=Backend(delay=0.005))
    assert said.there
    assert all(said.there)


def test_the_text_is_that_of_the_last_run_and_is_written_only_if_it_differs(tmp_path):
    path, lab = commented(tmp_path), LabFolder(tmp_path / "lab")
    carry_out(load(path), lab.folder)
    kept = studies.study_files(lab)["toy-study"]
    before = kept.stat()
    carry_out(load(path), lab.folder)
    assert (kept.stat().st_ino, kept.stat().st_mtime_ns) == (before.st_ino, before.st_mtime_ns)
    asked = load(path)
    path.write_text("overwritten after it was read")
    carry_out(asked, lab.folder)
    assert kept.read_text(encoding="utf-8").startswith(COMMENT), "what was run, not what the file says by now"
    carry_out(asked.change(replicates=2), lab.folder)
    assert kept.read_text() == asked.change(replicates=2).yaml()


def test_a_study_made_in_python_is_kept_as_yaml(tmp_path):
    asked = define({**load(study_file(tmp_path, **SMALL)).definition, "name": "in-python"})
    lab = LabFolder(tmp_path / "lab")
    carry_out(asked, lab.folder)
    assert studies.study_files(lab)["in-python"].read_text() == asked.yaml() == asked.text
    again = load(studies.study_files(lab)["in-python"])
    assert (again.points, keys(again)) == (asked.points, keys(asked))


def test_a_comparison_and_packings_alone_keep_the_whole_study(tmp_path):
    path, lab = commented(tmp_path, replicates=2, orifices="[18, 24]"), LabFolder(tmp_path / "lab")
    asked = load(path)
    compared(select_points(asked, [1]), lab.folder)
    assert studies.study_files(lab)["toy-study"].read_bytes() == path.read_bytes()
    carry_out(asked, tmp_path / "packings", packings_only=True)
    assert studies.study_files(LabFolder(tmp_path / "packings"))["toy-study"].read_bytes() == path.read_bytes()


def test_a_plan_and_results_keep_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("labbook.api.lab.load_to_plan", lambda name: Backend())
    asked, place = load(commented(tmp_path)), Lab(tmp_path / "lab", "toy")
    place.plan(asked)
    place.results(asked, progress=False)
    assert not studies.study_files(place.lab_folder)


def test_a_run_goes_on_where_the_text_cannot_be_kept_and_says_so(tmp_path):
    lab = LabFolder(tmp_path / "lab")
    lab.folder.mkdir()
    lab.studies.write_text("a file in place of the folder")
    said = Said(lab)
    assert carry_out(load(commented(tmp_path)), lab.folder, watcher=said).complete
    (line,) = said.lines
    assert str(lab.studies) in line
    assert "could not be copied" in line
    assert studies.study_files(lab) == {}


def test_a_full_disk_ends_the_run_before_it_begins_and_leaves_no_half_file(tmp_path, monkeypatch):
    lab, write = LabFolder(tmp_path / "lab"), os.replace

    def full(part, path):
        if Path(path).parent.name == "study-files":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write(part, path)

    monkeypatch.setattr("labbook.lab.folder.os.replace", full)
    with pytest.raises(DiskFull, match="free some space"):
        carry_out(load(commented(tmp_path)), lab.folder)
    assert list(lab.studies.iterdir()) == []
    assert not lab.runs.exists()


def test_what_else_lies_there_is_no_study(tmp_path):
    lab = LabFolder(tmp_path / "lab")
    for name in ("b", "a", "Z-1_x"):
        studies.keep(lab, name, "name: x\n")
    (lab.studies / "a.yaml.part").write_text("half")
    (lab.studies / "notes.txt").write_text("mine")
    (lab.studies / "1st.yaml").write_text("no name of a study")
    (lab.studies / "folder.yaml").mkdir()
    os.mkfifo(lab.studies / "pipe.yaml")
    assert list(studies.study_files(lab)) == ["Z-1_x", "a", "b"]
    assert not lab.works.exists() or not list(lab.works.iterdir())


@pytest.mark.parametrize("name", ["", "../a", "a/b", "a.b", ".a", "1a", "a\n", "ä", "a" * 81, "a\0"])
def test_a_name_that_no_study_has_is_refused(tmp_path, name):
    lab = LabFolder(tmp_path / "lab")
    with pytest.raises(ValueError, match="not the name of a study"):
        studies.keep(lab, name, "")
    assert not lab.folder.exists()


def test_a_pipe_in_place_of_the_file_is_not_waited_for(tmp_path):
    lab = LabFolder(tmp_path / "lab")
    lab.studies.mkdir(parents=True)
    os.mkfifo(lab.studies / "a.yaml")
    studies.keep(lab, "a", "name: a\n")
    assert studies.study_files(lab)["a"].read_text() == "name: a\n"


def test_a_folder_of_studies_alone_is_no_lab(tmp_path):
    (tmp_path / "study-files").mkdir()
    assert not LabFolder(tmp_path).exists


# import


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A lab with a study that was run."""
    folder = tmp_path_factory.mktemp("made")
    carry_out(study(folder, **SMALL), folder / "theirs")
    return folder


@pytest.fixture
def labs(made, tmp_path, monkeypatch) -> tuple[LabFolder, LabFolder]:
    """An empty lab, and a lab to import."""
    monkeypatch.setattr("labbook.lab.merge.load", lambda name: Backend())
    shutil.copytree(made / "theirs", tmp_path / "theirs")
    return LabFolder(tmp_path / "ours"), LabFolder(tmp_path / "theirs")


def test_an_import_brings_study_files_along_and_ours_stay(labs):
    ours, theirs = labs
    studies.keep(theirs, "other", "name: theirs\n")
    studies.keep(ours, "other", "name: ours\n")
    out = labbook("import", theirs.folder, "--lab", ours.folder).output
    assert "Study files imported: toy-study\n" in out
    assert "Not replaced: the study file other of this lab differs and is kept" in out
    assert studies.study_files(ours)["toy-study"].read_bytes() == studies.study_files(theirs)["toy-study"].read_bytes()
    assert studies.study_files(ours)["other"].read_text() == "name: ours\n"
    out = labbook("import", theirs.folder, "--lab", ours.folder).output
    assert "Study files imported" not in out
    assert "toy-study" not in out, "the same text needs no word"


@pytest.mark.parametrize(("harm", "said"), [
    (lambda path: path.symlink_to("/etc/hostname"), "copies no links"),
    (lambda path: os.mkfifo(path), "not an ordinary file"),
    (lambda path: path.mkdir(), "not an ordinary file"),
    (lambda path: path.write_bytes(b"\xff\xfe\x00"), "not text in UTF-8"),
    (lambda path: path.write_bytes(b" " * 2_000_001), "more than the allowed 2000000"),
])  # fmt: skip
def test_a_harmful_study_file_is_named_and_left_out(labs, harm, said):
    ours, theirs = labs
    harm(theirs.studies / "bad.yaml")
    ended = labbook("import", theirs.folder, "--lab", ours.folder, check=False)
    assert ended.exit_code == 1
    assert f"Not imported: {theirs.studies / 'bad.yaml'}: " in ended.output
    assert said in ended.output
    assert list(studies.study_files(ours)) == ["toy-study"]


def test_what_stands_in_the_way_here_stops_nothing_else(labs):
    ours, theirs = labs
    (ours.studies / "toy-study.yaml").mkdir(parents=True)
    studies.keep(theirs, "other", "name: other\n")
    ended = labbook("import", theirs.folder, "--lab", ours.folder, check=False)
    assert ended.exit_code == 1
    assert "Is a directory" in ended.output
    assert "Study files imported: other\n" in ended.output


def test_study_files_outlive_reindexing(labs):
    _, theirs = labs
    before = studies.study_files(theirs)["toy-study"].read_bytes()
    labbook("reindex", "--lab", theirs.folder)
    assert studies.study_files(theirs)["toy-study"].read_bytes() == before
