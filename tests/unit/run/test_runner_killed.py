"""`labbook run` killed, interrupted, doubled, and out of disk: nothing is lost, nothing is done twice."""

import errno
import os
import random
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from toy_lab import arrays, carry_out, labbook, start, study, study_file
from typer.testing import CliRunner

from labbook.backend import load
from labbook.cli import build
from labbook.lab import Catalogue, DiskFull, LabFolder, RunRecord
from labbook.lab import folder as lab_module

BACKEND = ("--backend", "toy")


def folders(lab: Path) -> dict[str, tuple[int, int]]:
    """Finished runs and packings, with inode and time of last change."""
    found = [path for kind in ("runs", "packings") for path in (lab / kind).glob("*")]
    return {path.name: (path.stat().st_ino, path.stat().st_mtime_ns) for path in found}


def same(one: Path, other: Path) -> None:
    """Two labs hold the same runs and packings, bit for bit."""
    for kind in ("runs", "packings"):
        keys = sorted(path.name for path in (one / kind).iterdir())
        assert keys == sorted(path.name for path in (other / kind).iterdir())
        for key in keys:
            assert arrays(one / kind / key) == arrays(other / kind / key), key


def kill_within(process: subprocess.Popen, seconds: float) -> bool:
    """Let a process go on for a while, then kill it; whether it was still going."""
    try:
        process.wait(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
        process.wait()
        return True
    return False


def begun(lab: Path) -> Iterator[str]:
    """Keys of unfinished runs and packings that were saved."""
    return (path.parent.name for path in (lab / "work").glob("*/progress.json"))


def saved(lab: Path) -> dict[str, int]:
    """Unfinished work, with the time of its last save."""
    return {path.parent.name: path.stat().st_mtime_ns for path in (lab / "work").glob("*/progress.json")}


@pytest.mark.parametrize(
    ("backend", "count", "replicates", "delay"),
    [
        pytest.param("toy", 300, 2, 0.004, marks=pytest.mark.slow),
        pytest.param("numba", 200, 1, 0.0, marks=[pytest.mark.ring, pytest.mark.compiles]),
    ],
)
def test_killed_again_and_again_it_goes_on_and_gives_the_same_bits(tmp_path, backend, count, replicates, delay):
    more, sizes = ("record: {every: 0.7 ms, replicates: 1}",), {"count": count, "replicates": replicates}
    path, lab, whole = study_file(tmp_path, *more, **sizes), tmp_path / "lab", tmp_path / "whole"
    carry_out(study(tmp_path, *more, **sizes), whole, backend=load(backend))
    words = ("run", path, "--lab", lab, "--backend", backend, "--checkpoint-every", 0.05)
    chance = random.Random(7)
    kills, cut = 0, set()
    runs = {path.name for path in (whole / "runs").iterdir()}
    while kills < 3 or not cut & runs:
        before, saves = folders(lab), saved(lab)
        process = start(*words, delay=delay)
        while saved(lab) == saves and folders(lab) == before and process.poll() is None:
            time.sleep(0.01)  # not before it has done something
        assert kill_within(process, chance.uniform(0.02, 0.4)), "it was killed in the middle"
        kills += 1
        cut |= set(begun(lab)) - folders(lab).keys()
        after = folders(lab)
        assert {key: after[key] for key in before} == before, "what was finished is not touched again"
    before = folders(lab)
    labbook(*words)
    after = folders(lab)
    assert {key: after[key] for key in before} == before
    same(lab, whole)
    resumed = [RunRecord.read(run) for run in (lab / "runs").iterdir() if run.name in cut]
    assert resumed, "some run was cut short"
    for record in resumed:
        assert len(record.sessions) > 1
        for earlier, later in zip(record.sessions, record.sessions[1:], strict=False):
            assert later.from_step == earlier.to_step > 0, "it went on from its checkpoint"
    assert len(Catalogue(lab).runs()) == 2 * replicates
    assert not list((lab / "work").iterdir()), "nothing unfinished is left"


def test_a_kill_between_the_renames_of_a_replaced_run_is_mended(tmp_path, monkeypatch):
    lab = tmp_path / "lab"
    carry_out(study(tmp_path, "stop: {max_time: 20 ms}", replicates=1), lab)
    before = folders(lab)

    class Killed(BaseException):
        pass

    def rename(old, new, _rename=os.rename):
        _rename(old, new)
        if Path(new).name == "replaced":
            raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(lab_module.os, "rename", rename)
        with pytest.raises(Killed):
            carry_out(study(tmp_path, replicates=1), lab)
    assert len(folders(lab)) < len(before)
    carry_out(study(tmp_path, replicates=1), lab)
    assert folders(lab).keys() == before.keys()
    carry_out(study(tmp_path, replicates=1), tmp_path / "whole")
    same(lab, tmp_path / "whole")


def test_what_a_kill_left_of_finished_work_is_removed(tmp_path):
    lab = tmp_path / "lab"
    carry_out(study(tmp_path, replicates=1), lab)
    before, work = folders(lab), lab / "work"
    for number, key in enumerate(before):  # killed before its work folder was cleared, or just before its lock was
        (work / (f"{key}.look" if number == 2 else f"{key}.lock")).touch()
        if number % 2:
            (work / key).mkdir()
    (work / "of-another-study.lock").touch()
    carry_out(study(tmp_path, replicates=1), lab)
    assert [path.name for path in work.iterdir()] == ["of-another-study.lock"]
    assert folders(lab) == before


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_asked_to_stop_it_saves_and_says_how_to_go_on(tmp_path, number):
    path = study_file(tmp_path, count=100)
    lab = tmp_path / "lab"
    process = start("run", path, "--lab", lab, *BACKEND, delay=0.02)
    deadline = time.monotonic() + 60
    while not list((lab / "packings").glob("*")) and time.monotonic() < deadline:
        time.sleep(0.02)
    time.sleep(0.2)
    process.send_signal(number)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 130, out + err
    assert "the same command goes on from here" in out
    left = set(begun(lab))
    assert left, "what was going on is saved, though no checkpoint was due"
    shown = labbook("plan", path, "--lab", lab, *BACKEND).stdout
    assert "goes on from its checkpoint" in shown
    labbook("run", path, "--lab", lab, *BACKEND, check=False)  # so few grains give no flow rate, which is told by 1
    carry_out(study(tmp_path, count=100), tmp_path / "whole")
    same(lab, tmp_path / "whole")


@pytest.mark.slow
def test_two_at_once_neither_repeat_nor_corrupt(tmp_path):
    path = study_file(tmp_path, orifices="[18, 20, 22, 24]", count=300)
    lab = tmp_path / "lab"
    both = [start("run", path, "--lab", lab, *BACKEND, delay=0.002) for _ in range(2)]
    ended = [process.communicate(timeout=60) for process in both]
    assert [process.returncode for process in both] == [0, 0], ended
    assert len(Catalogue(lab).runs()) == 8
    mine = [
        int(out.split("now: ")[1].split(" finished")[0]) if "now: " in out and " finished" in out else 0
        for out, _ in ended
    ]
    assert sum(mine) == 8, "every run was done by one of them"
    for record in (RunRecord.read(run) for run in (lab / "runs").iterdir()):
        assert len(record.sessions) == 1
    carry_out(study(tmp_path, orifices="[18, 20, 22, 24]", count=300), tmp_path / "whole")
    same(lab, tmp_path / "whole")


@pytest.mark.slow
def test_a_claim_is_free_as_soon_as_its_process_is_killed(tmp_path):
    path = study_file(tmp_path, replicates=1)
    lab = tmp_path / "lab"
    process = start("run", path, "--lab", lab, *BACKEND, delay=0.05)
    deadline = time.monotonic() + 60
    held: list[str] = []
    while not held and time.monotonic() < deadline:
        time.sleep(0.02)  # a lock file is made a moment before it is locked
        held = [lock.stem for lock in (lab / "work").glob("*.lock") if LabFolder(lab).is_claimed(lock.stem)]
    (key,) = held
    assert LabFolder(lab).claim(key) is None
    process.kill()
    process.wait()
    assert not LabFolder(lab).is_claimed(key)
    claim = LabFolder(lab).claim(key)
    assert claim is not None
    claim.release()


@pytest.mark.parametrize(("room", "every"), [(0, 0.0), (25, 0.0), (2, 1e9), (6, 1e9), (11, 1e9), (15, 1e9)])
def test_a_full_disk_loses_no_finished_run(tmp_path, monkeypatch, room, every):
    lab, asked = tmp_path / "lab", study(tmp_path)
    carry_out(study(tmp_path, orifices="[24, 30]", replicates=1), lab)
    before = folders(lab)
    written = 0

    def full(handle, _sync=os.fsync):
        nonlocal written
        written += 1
        if written > room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        _sync(handle)

    with monkeypatch.context() as patch:
        patch.setattr(lab_module.os, "fsync", full)
        with pytest.raises(DiskFull, match="free some space and give the same command again"):
            carry_out(asked, lab, checkpoint_every=every)
    assert {key: folders(lab)[key] for key in before} == before
    carry_out(asked, lab)
    carry_out(asked, tmp_path / "whole")
    carry_out(study(tmp_path, orifices="[24, 30]", replicates=1), tmp_path / "whole")
    same(lab, tmp_path / "whole")


def test_a_full_disk_ends_the_command_with_a_clear_message(tmp_path, monkeypatch):
    path = study_file(tmp_path, replicates=1)

    def full(handle):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(lab_module.os, "fsync", full)
    done = CliRunner().invoke(build(), ["run", str(path), "--lab", str(tmp_path / "lab"), *BACKEND])
    assert done.exit_code == 1
    assert "no room is left on the disk" in done.output
