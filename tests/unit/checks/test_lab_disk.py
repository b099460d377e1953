"""`labbook doctor --lab`: what a file system does for a lab is tried out, and what it does not do is found."""

import errno
import json
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from toy_lab import labbook

from labbook.checks import disk
from labbook.checks.disk import Check, Unfit
from labbook.lab import LabError


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(disk, "SPELL", 0.2)
    monkeypatch.setattr(disk, "STARTS", 20.0)


class Free:
    """A claim of a lock that holds nothing."""

    def release(self) -> None:
        return


def by_name(checks: list[Check]) -> dict[str, Check]:
    return {check.name: check for check in checks}


@pytest.mark.slow
def test_a_local_folder_passes_and_nothing_stays_there(tmp_path):
    said: list[str] = []
    checks = disk.examine(tmp_path, said.append)
    assert [check for check in checks if not check.works] == []
    assert said == [check.name for check in checks] == list(disk.CHECKS)
    assert "journal mode wal" in by_name(checks)["index"].note
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_lock_that_two_processes_get_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr(disk, "lock", lambda *_: Free())
    with pytest.raises(Unfit, match="two processes held one lock at once"):
        disk.locks(tmp_path)


@pytest.mark.slow
def test_a_lock_that_is_not_seen_or_never_freed_is_found(tmp_path, monkeypatch):
    def is_locked(seen: bool) -> bool:
        monkeypatch.setattr(disk, "STARTS", 0.2)  # the other process has started; what follows need not wait long
        return seen

    for seen, said in ((False, "is not seen"), (True, "never released")):
        monkeypatch.setattr(disk, "is_locked", lambda _, seen=seen: is_locked(seen))
        monkeypatch.setattr(disk, "STARTS", 20.0)
        (tmp_path / said).mkdir()
        with pytest.raises(Unfit, match=said):
            disk.locks(tmp_path / said)


def looks(number: int):
    """True so many times."""
    return iter([True] * number + [False]).__next__


@pytest.mark.parametrize(("content", "said"), [
    (None, "missing for a moment"),
    (b"short", "half old, half new"),
    (b"\0" * 100 + b"\1" * (2**16 - 100), "half old, half new"),
    (bytes(2**16), "looked unchanged, in 5 looks"),
])  # fmt: skip
def test_a_rename_that_is_not_atomic_is_found(tmp_path, content, said):
    if content is not None:
        (tmp_path / "file").write_bytes(content)
    with pytest.raises(Unfit, match=said):
        disk.read_while(tmp_path / "file", looks(5))


def test_a_clock_that_is_wrong_is_found(tmp_path, monkeypatch):
    real = disk.time.time
    assert abs(disk.clock_skew(tmp_path / "a")) < 1
    monkeypatch.setattr(disk.time, "time", lambda: real() + 100)
    with pytest.raises(Unfit, match=r"100 s behind.*NTP"):
        disk.clock(tmp_path)


def test_what_cannot_be_done_is_a_check_that_fails(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.EIO, os.strerror(errno.EIO), "file")

    monkeypatch.setattr(disk, "write_bytes", full)
    found = disk.perform("fsync", lambda: disk.syncs(tmp_path), lambda _: None)
    assert (found.works, "Input/output error" in found.note) == (False, True)
    monkeypatch.setattr(disk.shutil, "disk_usage", lambda _: type("Usage", (), {"free": 10**6}))
    with pytest.raises(Unfit, match=r"0.001 GB are free on .*make room"):
        disk.free_space(tmp_path)


def test_the_index_of_a_network_file_system_has_no_log(tmp_path, monkeypatch):
    monkeypatch.setattr("labbook.lab.database.file_system", lambda _: "lustre")
    assert "journal mode delete" in disk.index(tmp_path)


def two(folder: Path, monkeypatch) -> list[list[Check]]:
    """What two find that meet in a folder; each thread has the name of a host."""
    monkeypatch.setattr(disk, "node", lambda: threading.current_thread().name)
    with ThreadPoolExecutor(2, thread_name_prefix="host") as pool:
        return [one.result() for one in [pool.submit(disk.meet, folder, patience=30.0) for _ in range(2)]]


def test_two_hosts_meet_and_leave_nothing(tmp_path, monkeypatch):
    (tmp_path / disk.PEERS).mkdir()
    (tmp_path / disk.PEERS / "long-gone-1-aa.here").write_text("7")  # of one that was killed
    for checks in two(tmp_path, monkeypatch):
        assert [check for check in checks if not check.works] == []
        assert {"host_0", "host_1"} <= set(by_name(checks)["hosts"].note.split())
        assert "100 rows" in by_name(checks)["index of two hosts"].note
    assert [path.name for path in (tmp_path / disk.PEERS).iterdir()] == ["long-gone-1-aa.here"]


@pytest.mark.parametrize("broken", ["lock", "is_locked"])
def test_locks_that_do_not_reach_another_host_are_found_by_both(tmp_path, monkeypatch, broken):
    monkeypatch.setattr(disk, broken, (lambda *_: Free()) if broken == "lock" else (lambda *_: False))
    for checks in two(tmp_path, monkeypatch):
        found = by_name(checks)
        assert not found["locks of two hosts"].works
        assert "on one host only" in found["locks of two hosts"].note
        assert found["index of two hosts"].works, "what comes after is tried all the same"


def test_clocks_of_hosts_that_differ_are_found(tmp_path, monkeypatch):
    ahead = disk.clock_skew
    shift = {"host_0": 0.0, "host_1": 60.0}
    monkeypatch.setattr(disk, "clock_skew", lambda path: ahead(path) + shift[threading.current_thread().name])
    for checks in two(tmp_path, monkeypatch):
        assert "differ by 60 s" in by_name(checks)["clocks of two hosts"].note
        assert not by_name(checks)["clocks of two hosts"].works


def test_where_no_other_host_comes_that_is_said(tmp_path):
    with pytest.raises(LabError, match=r"no other labbook doctor --peer came within 0.3 s"):
        disk.meet(tmp_path, patience=0.3)


def test_the_command_names_what_fails(tmp_path, monkeypatch):
    checks = [Check("locks", True, "fine"), Check("fsync", False, "Input/output error")]
    monkeypatch.setattr(disk, "examine", lambda *_: checks)
    monkeypatch.setattr(disk, "meet", lambda *_: [Check("hosts", True, "a and b")])
    ended = labbook("doctor", "--lab", tmp_path, check=False)
    assert (ended.exit_code, "Input/output" in ended.stdout, "hosts" in ended.stdout) == (1, True, False)
    ended = labbook("doctor", "--lab", tmp_path, "--peer", "--json", check=False)
    assert [check["name"] for check in json.loads(ended.stdout)] == ["locks", "fsync", "hosts"]
    monkeypatch.setattr(disk, "examine", lambda *_: checks[:1])
    assert labbook("doctor", "--lab", tmp_path).exit_code == 0


def test_the_command_needs_a_folder(tmp_path):
    assert "no such folder" in labbook("doctor", "--lab", tmp_path / "typo", check=False).stderr
    assert "--lab PATH" in labbook("doctor", "--peer", check=False).stderr
