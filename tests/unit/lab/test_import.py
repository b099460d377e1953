"""What `labbook import` takes from a lab that is damaged or made by somebody who means harm, and what it leaves out."""

import errno
import io
import json
import os
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from labbook_toy import Backend
from toy_lab import arrays, carry_out, labbook, start, study, study_file, unsealed

from labbook.lab import Catalogue, LabFolder, RunRecord
from labbook.lab import merge as merging
from labbook.lab.folder import EVALUATION
from labbook.lab.index import Index
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
        whole = json.loads(unsealed((run / file).read_text()))
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


def longer(**changes):
    """Says so consistently: 1000 steps more, whose state the checkpoint does not have."""

    def harm(run: Path) -> None:
        coverage = json.loads((run / "run.json").read_text())["coverage"]
        steps = coverage["steps"] + 1000
        says(coverage__steps=steps, coverage__duration=1e-5 * steps, **changes)(run)

    return harm


def provenance(**changes):
    def harm(run: Path) -> None:
        told = json.loads((run / "run.json").read_text())["sessions"]
        told[-1]["provenance"] |= changes
        says(sessions=told)(run)

    return harm


def loop_in_its_place(run: Path) -> None:
    shutil.rmtree(run)
    run.symlink_to(run.name)


def dangling(run: Path) -> None:
    shutil.rmtree(run)
    run.symlink_to("nowhere")


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
    "machine": provenance(machine={"a": 1}),
    "machines": provenance(machine=["a"]),
    "packages": provenance(packages="boo"),
    "gpu": provenance(gpu={"name": 3}),
    "threads": provenance(threads="many"),
    "study": says(study="<b>x"),
    "study of a path": says(study="../x"),
    "label": says(label="a\0b"),
    "end": says(finished="2026\0"),
    "grains": says(ledger__inside=10**15),
    "grains left": says(ledger__left=201),
    "start": says(ledger__started=201),
    "duration": says(coverage__duration=10.0),
    "duration and steps": longer(),
    "suspect": says(ledger__overlap=0.2),
    "loop": loop_in_its_place,
    "dangling link": dangling,
    "large": lambda run: os.truncate(run / "run.json", 2**27),
}


def test_of_a_run_that_says_what_it_cannot_the_key_is_named(labs):
    ours, theirs = labs
    victim, other = sorted((theirs / "runs").iterdir())
    HARMS["machine"](victim)
    HARMS["grains"](other)
    output = labbook("import", theirs, "--lab", ours, check=False).output
    assert f"{victim / 'run.json'}: sessions.0.provenance: machine: Input should be a valid string" in output
    assert f"{other / 'run.json'}: ledger.inside: {10**15} of 200 grains" in output


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
    assert "Runs and packings imported: 1" in ended.output, "the other run, which is longer than ours"
    assert arrays(ours / "runs" / victim.name) == before
    assert arrays(ours / "runs" / other.name) == arrays(other)
    assert not list((ours / "work").iterdir())
    assert sorted(Catalogue(ours).runs().outcome) == ["finished", "time-limit"]
    assert not [path for path in ours.rglob("*") if path.is_symlink()]


def test_what_is_said_stands_in_lines_also_where_both_streams_are_one(labs):
    ours, theirs = labs
    victim, _ = sorted((theirs / "runs").iterdir())
    (victim / "run.json").write_bytes(b"")
    process = start("import", theirs, "--lab", ours.with_name("new"), together=True)
    said, _ = process.communicate(timeout=60)
    first, second, *others = said.splitlines()
    assert first == "Runs and packings imported: 3"
    assert second == "Study files imported: toy-study"
    assert others
    assert all(line.startswith("Not imported: ") for line in others)


def test_what_other_programs_put_there_is_not_copied(labs):
    ours, theirs = labs
    victim = sorted((theirs / "runs").iterdir())[0]
    (victim / ".ipynb_checkpoints").mkdir()
    (theirs / "runs" / ".ipynb_checkpoints").mkdir()
    (theirs / "runs" / "notes.txt").write_text("mine")
    (victim / "notes.txt").write_text("mine")
    assert labbook("import", theirs, "--lab", ours).output.startswith("Runs and packings imported: 2\n")
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
    assert "Runs and packings imported: 2" in ended.output
    assert Catalogue(tmp_path / "new").counts() == {"finished": 1}


def test_ours_is_replaced_where_it_cannot_be_read(labs):
    ours, theirs = labs
    assert labbook("import", ours, "--lab", theirs).output.startswith("Runs and packings imported: 0\n"), (
        "theirs are longer"
    )
    for again in (False, True):
        victim = sorted((theirs / "runs").iterdir())[0]
        packing = sorted((theirs / "packings").iterdir())[0]  # of either run: the other one is not replaced
        (victim / "crossing.npz").unlink()
        (packing / "packing.npz").write_bytes(b"")
        if again:
            labbook("reindex", "--lab", theirs)
        assert labbook("import", ours, "--lab", theirs).output.startswith("Runs and packings imported: 2\n")
        assert arrays(victim) == arrays(ours / "runs" / victim.name)
        assert sorted(Catalogue(theirs).runs().outcome) == ["finished", "time-limit"]


def test_a_longer_run_that_saw_less_does_not_replace_ours(labs, made, tmp_path):
    _, theirs = labs
    asked = study(tmp_path, "stop: {max_time: 20 ms}", "record: {every: 2 ms, replicates: 1}", **SMALL)
    carry_out(asked, tmp_path / "recorded")
    assert "Runs and packings imported: 1" in labbook("import", theirs, "--lab", tmp_path / "recorded").output
    kept = [folder for folder in (tmp_path / "recorded/runs").iterdir() if (folder / "recording.npz").exists()]
    assert len(kept) == 1


def test_unfinished_work_of_ours_is_gone_on_with_after_an_import(labs):
    ours, theirs = labs
    key = sorted((theirs / "runs").iterdir())[0].name
    work = LabFolder(ours).work(key)
    work.mkdir(parents=True)
    (work / "progress.json").write_text("{}")
    labbook("import", theirs, "--lab", ours)
    assert (work / "progress.json").exists()


def test_what_another_process_works_on_is_left_out(labs):
    ours, theirs = labs
    key = sorted((theirs / "runs").iterdir())[0].name
    claim = LabFolder(ours).claim(key)
    assert claim is not None
    ended = labbook("import", theirs, "--lab", ours, check=False)
    claim.release()
    assert ended.exit_code == 1
    assert "import again later" in ended.output
    assert "Runs and packings imported: 1" in ended.output


def test_a_run_whose_packing_another_process_works_on_says_so(labs, tmp_path):
    _, theirs = labs
    key = sorted((theirs / "packings").iterdir())[0].name
    claim = LabFolder(tmp_path / "new").claim(key)
    assert claim is not None
    ended = labbook("import", theirs, "--lab", tmp_path / "new", check=False)
    claim.release()
    assert f"it starts from the packing {key}, which is not in this lab: another process works on that" in ended.output
    assert "No such file" not in ended.output
    assert "Runs and packings imported: 2" in ended.output


def test_a_full_disk_ends_an_import_in_one_line(labs, monkeypatch):
    ours, theirs = labs
    before = {path.name: arrays(path) for path in (ours / "runs").iterdir()}

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("labbook.lab.merge._copy_file", full)
    ended = labbook("import", theirs, "--lab", ours, check=False)
    assert ended.exit_code == 1
    assert "no room is left" in ended.output
    assert len(ended.output.strip().splitlines()) == 1
    assert {path.name: arrays(path) for path in (ours / "runs").iterdir()} == before
    assert not list((ours / "work").iterdir())


# others at work meanwhile


def imported(ours: Path, theirs: Path) -> merging.Merged:
    index = Index(LabFolder(ours))
    try:
        return merging.merge(index, theirs)
    finally:
        index.close()


def keys(lab: Path) -> list[str]:
    return sorted(path.name for path in (lab / "runs").iterdir())


def durations(lab: Path) -> dict[str, float]:
    return {key: RunRecord.read(lab / "runs" / key).coverage.duration for key in keys(lab)}


def at_the_claim(monkeypatch, act) -> None:
    """What another process does after the first look of an import, just before it claims a key."""
    claim = LabFolder.claim

    def late(lab: LabFolder, key: str):
        act(lab, key)
        return claim(lab, key)

    monkeypatch.setattr(LabFolder, "claim", late)


def test_a_longer_run_that_came_after_the_first_look_is_not_replaced(labs, made, monkeypatch):
    ours, theirs = labs
    shutil.rmtree(ours / "runs")
    longer = durations(theirs)

    def put(lab: LabFolder, key: str) -> None:
        if key in longer and not lab.run(key).exists():
            shutil.copytree(theirs / "runs" / key, lab.run(key))

    at_the_claim(monkeypatch, put)
    merged = imported(ours, made / "ours")  # the shorter ones
    assert not set(merged.copied) & set(longer)
    assert merged.left_out == []
    assert durations(ours) == longer


def test_a_run_whose_replacement_was_cut_short_is_put_back_before_it_is_compared(labs, made):
    """Killed between the two renames, a runner leaves the only copy of a run in the work folder."""
    _, longer = labs
    key = keys(longer)[0]
    work = LabFolder(longer).work(key)
    work.mkdir(parents=True)
    os.rename(longer / "runs" / key, work / "replaced")
    before = arrays(work / "replaced")
    imported(longer, made / "ours")
    assert arrays(longer / "runs" / key) == before
    assert not list((longer / "work").iterdir())


@pytest.mark.parametrize("how", ["replaced", "removed", "unreadable"])
@pytest.mark.parametrize("file", ["run.json", "crossing.npz", "packing.npz"])
def test_what_changes_in_the_source_while_it_is_copied_costs_one_line(labs, tmp_path, monkeypatch, how, file):
    ours, theirs = labs
    shutil.rmtree(ours)
    kind = "packings" if file == "packing.npz" else "runs"
    victim = sorted((theirs / kind).iterdir())[0]
    read, done = merging._read, []

    def meddled(path: Path, source, most: int = -1) -> bytes:
        content = read(path, source, most)
        if path == victim / file and not done:
            done.append(path)
            if how == "unreadable":
                with merging._reading(path):
                    raise OSError(errno.ESTALE, os.strerror(errno.ESTALE), str(path))
            again = shutil.copytree(victim, tmp_path / "again")
            (again / "run.json").touch()
            shutil.rmtree(victim)
            if how == "replaced":
                os.rename(again, victim)
        return content

    monkeypatch.setattr(merging, "_read", meddled)
    merged = imported(ours, theirs)
    assert done, "it came to that"
    of_it = [line for line in merged.left_out if str(victim) in line]
    assert len(of_it) == 1
    assert len(merged.left_out) == (2 if kind == "packings" else 1), (
        "the run that starts from a packing is left out too"
    )
    assert len(merged.copied) == 4 - len(merged.left_out)
    assert not list((ours / "work").iterdir())
    if how != "removed":
        assert imported(ours, theirs).left_out == []
        assert arrays(ours / kind / victim.name) == arrays(victim)


def test_unfinished_work_of_the_source_is_never_read(labs, monkeypatch):
    ours, theirs = labs
    key = keys(theirs)[0]
    work = LabFolder(theirs).work(key)
    work.mkdir(parents=True)
    shutil.copytree(theirs / "runs" / key, work / "done")
    seen: list[str] = []

    def noted(name: str):
        call = getattr(os, name)

        def wrapped(path=".", *more, **named):
            seen.append(str(path))
            return call(path, *more, **named)

        monkeypatch.setattr(os, name, wrapped)

    for name in ("open", "scandir", "listdir"):
        noted(name)
    assert len(imported(ours, theirs).copied) == 2
    assert [path for path in seen if path.startswith(str(theirs / "runs"))]
    assert not [path for path in seen if path.startswith(str(theirs / "work"))]


@pytest.mark.slow
def test_importing_again_and_again_from_a_lab_that_is_being_worked_in(tmp_path):
    """Runs of the source come, and are gone on with and replaced, while it is imported in a loop."""
    ours, theirs = tmp_path / "ours", tmp_path / "theirs"
    short = study_file(tmp_path, "stop: {max_time: 40 ms}", "record: {every: 4 ms, replicates: 2}", replicates=4)
    text = short.read_text()
    long = short.with_name("long.yaml")
    long.write_text(text.replace("40 ms", "10 s"))
    (theirs / "runs").mkdir(parents=True)
    best: dict[str, float] = {}
    imports, grown, left_out = 0, 0, []
    for asked in (short, long):
        process = start("run", asked, "--lab", theirs, "--backend", "toy", delay=0.003)
        ended = False
        while not ended:
            ended = process.poll() is not None
            left_out += imported(ours, theirs).left_out
            imports += 1
            now = durations(ours) if (ours / "runs").is_dir() else {}
            assert all(now.get(key, 0.0) >= duration for key, duration in best.items()), "none grows shorter"
            grown += sum(now[key] > duration for key, duration in best.items())
            best = now
        assert process.wait() == (1 if asked == short else 0), process.communicate()  # 40 ms give no flow rate
    assert imported(ours, theirs).left_out == []
    assert all(line.count("\n") == 0 and str(theirs) in line for line in left_out)
    assert grown > 0
    assert imports > 4
    assert keys(ours) == keys(theirs)
    for kind in ("runs", "packings"):
        for path in (theirs / kind).iterdir():
            assert arrays(ours / kind / path.name) == arrays(path)
    assert not list((ours / "work").iterdir())
