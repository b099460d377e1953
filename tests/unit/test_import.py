"""What `labbook import` takes from a lab that is damaged or made by somebody who means harm, and what it leaves out."""

import io
import json
import os
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from labbook_toy import Backend
from toy_lab import arrays, carry_out, labbook, study

from labbook.lab import Catalogue, Lab
from labbook.lab.folder import EVALUATION
from labbook.lab.tables import read_table

SMALL = {"count": 200, "orifices": "[24]", "replicates": 2}


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """Two labs with the same two runs, of which `theirs` go on for longer."""
    folder = tmp_path_factory.mktemp("labs")
    carry_out(study(folder, "stop: {max_time: 20 ms}", **SMALL), folder / "ours")
    carry_out(study(folder, **SMALL), folder / "theirs")
    return folder


@pytest.fixture
def labs(made, tmp_path, monkeypatch) -> tuple[Path, Path]:
    monkeypatch.setattr("labbook.lab.merge.load", lambda name: Backend())
    for name in ("ours", "theirs"):
        shutil.copytree(made / name, tmp_path / name)
    return tmp_path / "ours", tmp_path / "theirs"


def written(path: Path, columns) -> None:
    buffer = io.BytesIO()
    np.savez(buffer, **columns)
    path.write_bytes(buffer.getvalue())


def of_columns(file: str, **changes):
    def harm(run: Path) -> None:
        columns = read_table(run / file)
        for name, change in changes.items():
            columns[name] = change(columns[name])
        written(run / file, columns)

    return harm


def says(file="run.json", **changes):
    def harm(run: Path) -> None:
        whole = json.loads((run / file).read_text())
        for name, value in changes.items():
            *parents, last = name.split("__")
            part = whole
            for parent in parents:
                part = part[parent]
            part[last] = value
        (run / file).write_text(json.dumps(whole))

    return harm


def garbage(run: Path) -> None:
    longer = json.loads((run / "run.json").read_text())["coverage"]["duration"] + 1
    says(coverage__duration=longer)(run)
    (run / "crossing.npz").write_bytes(b"garbage")


def link_to_file(run: Path) -> None:
    (run / "crossing.npz").unlink()
    (run / "crossing.npz").symlink_to("/etc/hostname")


def link_besides(run: Path) -> None:
    (run / "passwords").symlink_to("/etc/passwd")


def link_to_folder(run: Path) -> None:
    run.rename(run.with_name("elsewhere"))
    run.symlink_to(run.with_name("elsewhere"))


def link_loop(run: Path) -> None:
    (run / "loop").symlink_to(run)


def folder(run: Path) -> None:
    (run / "more").mkdir()


def pipe(run: Path) -> None:
    (run / "run.json").unlink()
    os.mkfifo(run / "run.json")


def pipe_besides(run: Path) -> None:
    os.mkfifo(run / "pipe")


def bomb(run: Path) -> None:
    """3 GB of zeros in 3 MB, which are what they say, as a column of crossings."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (2**22,)})
    with zipfile.ZipFile(run / "crossing.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("time", "id", "step"):
            archive.writestr(f"{name}.npy", header.getvalue() + bytes(2**25))


def renamed(run: Path) -> None:
    run.rename(run.with_name("0" * 24))


HARMS = {
    "garbage": garbage,
    "file link": link_to_file,
    "another link": link_besides,
    "folder link": link_to_folder,
    "link loop": link_loop,
    "folder": folder,
    "pipe": pipe,
    "another pipe": pipe_besides,
    "bomb": bomb,
    "renamed": renamed,
    "density": says(scene__grains__density=99999.0),
    "numerics": says(numerics__dt=2e-5),
    "lineage": says(lineage_key="0" * 24),
    "nan time": of_columns("crossing.npz", time=lambda time: time * np.nan),
    "nan position": of_columns("checkpoint.npz", x=lambda x: x * np.nan),
    "foreign grains": of_columns("checkpoint.npz", ids=lambda ids: ids + 1000),
    "foreign step": of_columns("checkpoint.npz", count=lambda count: count + 1),
    "foreign backend": of_columns(
        "checkpoint.npz", _meta=lambda meta: np.array('{"engine": "numba", "cache_version": 5}')
    ),
    "large": lambda run: os.truncate(run / "run.json", 2**27),
}


@pytest.mark.parametrize("harm", HARMS)
def test_a_harmful_run_is_named_and_left_out_and_ours_stays(labs, harm):
    ours, theirs = labs
    victim, other = sorted((theirs / "runs").iterdir())
    before = arrays(ours / "runs" / victim.name)
    HARMS[harm](victim)
    ended = labbook("import", theirs, "--lab", ours, check=False)
    assert ended.exit_code == 1, "the import is not whole"
    assert "Not imported" in ended.output
    assert victim.name in ended.output or "0" * 24 in ended.output
    assert "1 runs and packings imported" in ended.output, "the other run, which is longer than ours"
    assert arrays(ours / "runs" / victim.name) == before
    assert arrays(ours / "runs" / other.name) == arrays(other)
    assert not list((ours / "work").iterdir())
    assert sorted(Catalogue(ours).runs().outcome) == ["finished", "time-limit"]
    assert not [path for path in ours.rglob("*") if path.is_symlink()]


def test_what_other_programs_put_there_is_not_copied(labs):
    ours, theirs = labs
    victim = sorted((theirs / "runs").iterdir())[0]
    (victim / ".ipynb_checkpoints").mkdir()
    (theirs / "runs" / ".ipynb_checkpoints").mkdir()
    (theirs / "runs" / "notes.txt").write_text("mine")
    (victim / "notes.txt").write_text("mine")
    assert labbook("import", theirs, "--lab", ours).output.startswith("2 runs and packings imported\n")
    taken = {path.name for path in (ours / "runs" / victim.name).iterdir()}
    assert {name for name in taken if not name.startswith(EVALUATION)} == {
        "run.json",
        "crossing.npz",
        "checkpoint.npz",
        "picture.png",
    }


@pytest.mark.parametrize("file", ["packing.json", "packing.npz"])
def test_a_damaged_packing_is_left_out_with_the_runs_that_began_from_it(labs, tmp_path, file):
    _, theirs = labs
    victim = sorted((theirs / "packings").iterdir())[0]
    (victim / file).write_bytes(b"garbage")
    ended = labbook("import", theirs, "--lab", tmp_path / "new", check=False)
    assert ended.exit_code == 1
    assert ended.output.count("Not imported") == 2
    assert ended.output.count(victim.name) >= 2
    assert "2 runs and packings imported" in ended.output
    assert Catalogue(tmp_path / "new").counts() == {"finished": 1}


def test_ours_is_replaced_where_it_cannot_be_read(labs):
    ours, theirs = labs
    assert labbook("import", ours, "--lab", theirs).output.startswith("0 runs and packings imported\n"), (
        "theirs are longer"
    )
    for again in (False, True):
        victim = sorted((theirs / "runs").iterdir())[0]
        packing = sorted((theirs / "packings").iterdir())[0]  # of either run: the other one is not replaced
        (victim / "crossing.npz").unlink()
        (packing / "packing.npz").write_bytes(b"")
        if again:
            labbook("reindex", "--lab", theirs)
        assert labbook("import", ours, "--lab", theirs).output.startswith("2 runs and packings imported\n")
        assert arrays(victim) == arrays(ours / "runs" / victim.name)
        assert sorted(Catalogue(theirs).runs().outcome) == ["finished", "time-limit"]


def test_a_longer_run_that_saw_less_does_not_replace_ours(labs, made, tmp_path):
    _, theirs = labs
    asked = study(tmp_path, "stop: {max_time: 20 ms}", "record: {every: 2 ms, replicates: 1}", **SMALL)
    carry_out(asked, tmp_path / "recorded")
    assert "1 runs and packings imported" in labbook("import", theirs, "--lab", tmp_path / "recorded").output
    kept = [folder for folder in (tmp_path / "recorded/runs").iterdir() if (folder / "recording.npz").exists()]
    assert len(kept) == 1


def test_unfinished_work_of_ours_is_gone_on_with_after_an_import(labs):
    ours, theirs = labs
    key = sorted((theirs / "runs").iterdir())[0].name
    work = Lab(ours).work(key)
    work.mkdir(parents=True)
    (work / "progress.json").write_text("{}")
    labbook("import", theirs, "--lab", ours)
    assert (work / "progress.json").exists()


def test_what_another_process_works_on_is_left_out(labs):
    ours, theirs = labs
    key = sorted((theirs / "runs").iterdir())[0].name
    claim = Lab(ours).claim(key)
    assert claim is not None
    ended = labbook("import", theirs, "--lab", ours, check=False)
    claim.release()
    assert ended.exit_code == 1
    assert "import again later" in ended.output
    assert "1 runs and packings imported" in ended.output


def test_a_full_disk_ends_an_import_in_one_line(labs, monkeypatch):
    import errno

    ours, theirs = labs
    before = {path.name: arrays(path) for path in (ours / "runs").iterdir()}

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("labbook.lab.merge.shutil.copyfileobj", full)
    ended = labbook("import", theirs, "--lab", ours, check=False)
    assert ended.exit_code == 1
    assert "no room is left" in ended.output
    assert len(ended.output.strip().splitlines()) == 1
    assert {path.name: arrays(path) for path in (ours / "runs").iterdir()} == before
    assert not list((ours / "work").iterdir())
