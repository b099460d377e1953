"""What goes wrong with files and folders ends every verb in one line that says what to do, and leaves no half files."""

import errno
import os
import re
import shutil
from pathlib import Path

import pytest
from sqlalchemy import event
from toy_lab import carry_out, labbook, study, study_file

from labbook.cli.options import explanation
from labbook.lab import Catalogue
from labbook.lab.database import connect

SMALL = {"count": 200, "orifices": "[24]", "replicates": 2}
RUN = ("run", "--backend", "toy")
OF_STUDY = ("run", "plan", "fit", "report", "export", "view")
ALL = (*OF_STUDY, "status", "runs", "show", "reindex", "import")


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("sound")
    carry_out(study(folder, **SMALL), folder / "lab")
    return folder


@pytest.fixture
def place(sound, tmp_path) -> Path:
    shutil.copytree(sound, tmp_path / "here")
    return tmp_path / "here"


def words(verb: str, place: Path) -> list:
    """A verb with its arguments, but for the lab."""
    if verb in OF_STUDY:
        return [verb, study_file(place, **SMALL), "--backend", "toy"]
    return [verb, *{"show": ["ab"], "import": [place / "lab"]}.get(verb, [])]


def one_line(ended) -> str:
    """What was said; everything else about a failed verb is checked."""
    assert ended.exit_code == 1, ended.output
    said = [line for line in ended.output.splitlines() if not re.match(r"Left out| *\d+ s: ", line)]  # nor progress
    assert len(said) == 1, ended.output
    assert said[0].startswith("Error: ")
    return said[0]


def half_files(folder: Path) -> list[Path]:
    found = [path for path in folder.rglob("*") if path.is_file() and not path.name.endswith((".lock", "-wal", "-shm"))]
    return [path for path in found if path.stat().st_size == 0 or path.suffix in (".part", ".partial")]


@pytest.mark.parametrize("verb", ALL)
def test_a_file_in_place_of_the_lab_is_named(place, verb):
    lab = place / "note.txt"
    lab.write_text("no lab")
    line = one_line(labbook(*words(verb, place), "--lab", lab, check=False))
    assert str(lab) in line
    assert "--lab" in line
    assert lab.read_text() == "no lab"


@pytest.mark.usefixtures("one_format")
@pytest.mark.parametrize("verb", ["run", "report", "export"])
def test_a_full_disk_is_one_line_and_leaves_no_half_files(place, verb, monkeypatch):
    def full(one, other):
        raise OSError(errno.ENOSPC, "No space left on device", str(one))

    lab = place / ("new" if verb == "run" else "lab")
    with monkeypatch.context() as patched:
        patched.setattr("labbook.lab.folder.os.replace", full)
        line = one_line(labbook(*words(verb, place), "--lab", lab, check=False))
    assert "space" in line
    assert not half_files(lab)
    assert labbook(*words(verb, place), "--lab", lab).exit_code == 0, "with room the same command does it"


@pytest.mark.parametrize("verb", ["reindex", "run"])
def test_no_room_for_the_index_is_one_line(place, verb, monkeypatch):
    def small(lab, *, read_only):
        engine = connect(lab.catalogue, read_only=read_only)
        event.listen(engine, "connect", lambda connection, _: connection.execute("PRAGMA max_page_count=5"))
        return engine

    (place / "lab/catalogue.db").unlink()
    for suffix in ("-wal", "-shm"):
        (place / f"lab/catalogue.db{suffix}").unlink(missing_ok=True)
    with monkeypatch.context() as patched:
        patched.setattr("labbook.lab.index.open_engine", small)
        assert "room" in one_line(labbook(*words(verb, place), "--lab", place / "lab", check=False))
    assert labbook("reindex", "--lab", place / "lab").output.startswith("2 runs and 2 packings indexed")


def test_a_lab_that_nobody_can_write_to_is_read_without_the_log_of_its_index(place, monkeypatch):
    """SQLite makes that log even to read, and fails where it may not."""
    lab = place / "lab"
    for suffix in ("-wal", "-shm"):
        (lab / f"catalogue.db{suffix}").unlink(missing_ok=True)
    monkeypatch.setattr("labbook.lab.database.os.access", lambda *_: False)
    catalogue = Catalogue(lab)
    assert catalogue.counts() == {"finished": 2}
    catalogue.close()
    assert sorted(path.name for path in lab.iterdir() if path.name.startswith("catalogue")) == ["catalogue.db"]


def test_a_lab_that_cannot_be_written_is_one_line(place, monkeypatch):
    """As root, who may write everywhere, this cannot be tried out with permissions."""

    def forbidden(path, flags, *_, **__):
        if flags & os.O_CREAT and str(path).endswith(".lock"):
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))
        return opened(path, flags, *_, **__)

    opened = os.open
    monkeypatch.setattr("labbook.lab.folder.os.open", forbidden)
    asked = study_file(place, **{**SMALL, "replicates": 3})
    line = one_line(labbook("run", asked, "--backend", "toy", "--lab", place / "lab", check=False))
    assert "Read-only file system" in line
    assert "copy of the lab" in line


@pytest.mark.parametrize(("number", "remedy"), [
    (errno.ENOSPC, "free some disk space"),
    (errno.EACCES, "use another folder"),
    (errno.EROFS, "copy of the lab"),
    (errno.ENOTDIR, "move the file"),
    (errno.EIO, "check the disk"),
])  # fmt: skip
def test_every_error_of_files_has_a_remedy(number, remedy):
    line = explanation(OSError(number, os.strerror(number), "/lab/runs"))
    assert line is not None
    assert line.startswith(f"/lab/runs: {os.strerror(number)}; ")
    assert remedy in line


def test_what_is_no_error_of_files_keeps_its_traceback():
    assert explanation(ValueError("a mistake of ours")) is None
    assert explanation(BrokenPipeError(errno.EPIPE, "Broken pipe")) is None
