"""Labs on file systems that several hosts have at once: locks that may be missing, files that another host removes, and
an index without a write-ahead log."""

import errno
import fcntl
import os
import sqlite3
import threading
from pathlib import Path

import pytest
from sqlalchemy import text
from toy_lab import carry_out, labbook, leftovers, study, study_file

from labbook.lab import Catalogue, LabFolder
from labbook.lab.database import connect
from labbook.lab.folder import NoLocks, file_system, is_locked, is_network, lock

SMALL = {"count": 60, "orifices": "[24]", "replicates": 1}
MOUNTS = """\
22 1 254:0 / / rw,relatime shared:1 - ext4 /dev/vda rw
30 22 0:24 / /net rw - nfs4 server:/net rw
31 30 0:25 / /net/me/my\\040data rw - lustre mgs@tcp:/data rw
32 30 0:26 / /net/me/disk rw - xfs /dev/sdb rw
33 30 0:27 / /net/me/disk rw shared:2 - fuse.sshfs other: rw
nonsense
"""


@pytest.mark.parametrize(("place", "kind", "shared"), [
    ("/srv", "ext4", False),
    ("/net", "nfs4", True),
    ("/net/me/other", "nfs4", True),
    ("/nets", "ext4", False),
    ("/net/me/my data/lab", "lustre", True),
    ("/net/me/disk/lab", "fuse.sshfs", True),
])  # fmt: skip
def test_the_file_system_of_a_folder_is_the_one_mounted_nearest_above(tmp_path, place, kind, shared):
    (tmp_path / "mountinfo").write_text(MOUNTS)
    assert file_system(Path(place), tmp_path / "mountinfo") == kind
    assert is_network(kind) == shared


def test_where_nobody_tells_the_file_system_is_taken_as_local(tmp_path):
    assert file_system(tmp_path, tmp_path / "missing") == ""
    assert not is_network("")


def refuse(monkeypatch, number: int, times: int = 10**9) -> list[int]:
    """`flock` fails with an error, so many times."""
    flock, failed = fcntl.flock, []

    def refused(handle, how):
        if len(failed) < times:
            failed.append(how)
            raise OSError(number, os.strerror(number))
        return flock(handle, how)

    monkeypatch.setattr(fcntl, "flock", refused)
    return failed


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ESTALE])
@pytest.mark.parametrize("verb", ["run", "import"])
def test_locks_that_are_not_supported_end_a_verb_in_one_line(tmp_path, monkeypatch, verb, number):
    path, lab = study_file(tmp_path, **SMALL), tmp_path / "lab"
    carry_out(study(tmp_path, **SMALL), tmp_path / "other")
    refuse(monkeypatch, number)
    words = [path, "--backend", "toy"] if verb == "run" else [tmp_path / "other"]
    ended = labbook(verb, *words, "--lab", lab, check=False)
    assert ended.exit_code == 1
    *warnings, line = ended.stderr.strip().splitlines()
    assert all(one.startswith(("Warning: ", "    remedy: ")) for one in warnings), "of the plan, which comes first"
    for part in (str(lab / "work"), "cannot be locked", os.strerror(number), "local disk"):
        assert part in line
    assert not list(lab.glob("runs/*"))


def test_without_locks_a_lab_can_be_read(tmp_path, monkeypatch):
    lab, asked = tmp_path / "lab", study_file(tmp_path, **SMALL)
    carry_out(study(tmp_path, **SMALL), lab)
    (lab / "work/0123456789abcdef").mkdir(parents=True)
    (lab / "work/0123456789abcdef.lock").touch()
    refuse(monkeypatch, errno.ENOLCK)
    for words in (("status",), ("runs",), ("fit", asked, "--backend", "toy"), ("plan", asked, "--backend", "toy")):
        assert labbook(*words, "--lab", lab).exit_code == 0


def test_a_lock_file_that_another_host_removed_is_made_again(tmp_path, monkeypatch):
    failed = refuse(monkeypatch, errno.ESTALE, times=2)
    claim = LabFolder(tmp_path / "lab").claim("a")
    assert claim is not None
    assert len(failed) == 2
    claim.release()


def test_an_error_that_says_nothing_of_locks_stays_what_it_is(tmp_path, monkeypatch):
    refuse(monkeypatch, errno.EIO)
    with pytest.raises(OSError, match="Input/output") as raised:
        LabFolder(tmp_path / "lab").claim("a")
    assert not isinstance(raised.value, NoLocks)


def test_a_claim_that_is_released_twice_closes_no_other_file(tmp_path):
    """The number of its handle belongs to the next file that is opened."""
    claim = lock(tmp_path / "key", fcntl.LOCK_EX)
    assert claim is not None
    claim.release()
    with open(tmp_path / "other", "w") as other:
        claim.release()
        other.write("still open")
    assert (tmp_path / "other").read_text() == "still open"


def test_who_looks_never_makes_a_claim_fail(tmp_path):
    """Looking takes a shared lock for a moment."""
    lab, over, looked = LabFolder(tmp_path / "lab"), threading.Event(), [0]
    lab.works.mkdir(parents=True)

    def look() -> None:
        while not over.is_set():
            lab.is_claimed("a")
            looked[0] += 1

    lookers = [threading.Thread(target=look) for _ in range(3)]
    for looker in lookers:
        looker.start()
    try:
        for _ in range(300):
            claim = lab.claim("a")
            assert claim is not None, "nobody else claims it"
            claim.release()
    finally:
        over.set()
        for looker in lookers:
            looker.join()
    assert looked[0] > 0


def test_a_shared_lock_that_stays_for_a_while_is_waited_for(tmp_path):
    lab = LabFolder(tmp_path / "lab")
    lab.works.mkdir(parents=True)
    handle = os.open(lab.works / "a.lock", os.O_RDONLY | os.O_CREAT)
    fcntl.flock(handle, fcntl.LOCK_SH)
    timer = threading.Timer(0.05, os.close, [handle])
    timer.start()
    claim = lab.claim("a")
    timer.join()
    assert claim is not None
    assert is_locked(lab.works / "a.lock")
    assert lab.claim("a") is None, "who claims it holds it alone"
    claim.release()


def journal(lab: Path) -> tuple[str, int]:
    """Journal mode of the index, and how it is synced (1: NORMAL, 2: FULL)."""
    engine = connect(lab / "catalogue.db", read_only=False)
    with engine.connect() as connection:
        found = connection.scalar(text("PRAGMA journal_mode")), connection.scalar(text("PRAGMA synchronous"))
    engine.dispose()
    return found  # pyright: ignore[reportReturnType]


def test_on_a_local_disk_the_index_has_a_write_ahead_log(tmp_path):
    carry_out(study(tmp_path, **SMALL), tmp_path / "lab")
    assert journal(tmp_path / "lab") == ("wal", 1)


@pytest.mark.parametrize("before", [False, True])
def test_on_a_network_file_system_the_index_has_none(tmp_path, monkeypatch, before):
    """Also one that has one already, of an older version or of a copy of the lab."""
    lab = tmp_path / "lab"
    if before:
        carry_out(study(tmp_path, **SMALL), lab)
    monkeypatch.setattr("labbook.lab.database.file_system", lambda path: "nfs4")
    carry_out(study(tmp_path, **{**SMALL, "replicates": 2}), lab)
    assert journal(lab) == ("delete", 2)
    assert sorted(path.name for path in lab.glob("catalogue*")) == ["catalogue.db"]
    assert Catalogue(lab).counts() == {"finished": 2}
    assert leftovers(lab) == []


def test_where_sqlite_can_have_no_log_its_answer_is_heeded(tmp_path, monkeypatch):
    """As on a file system that maps no shared memory; what SQLite calls `dotfile` has none either."""
    opened = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda name, **more: opened(f"{name}&vfs=unix-dotfile", **more))
    carry_out(study(tmp_path, **SMALL), tmp_path / "lab")
    assert journal(tmp_path / "lab") == ("delete", 2)
    assert Catalogue(tmp_path / "lab").counts() == {"finished": 1}
