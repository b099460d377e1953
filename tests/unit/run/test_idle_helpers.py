"""Helper processes are kept when a run ends, and taken over by later runs of the same process."""

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module

import pytest
from toy_lab import carry_out, study

from labbook import plugins
from labbook.filling import place
from labbook.lab.folder import DiskFull, LabFolder
from labbook.run import finalizing, helper, runner
from labbook.run.helper import HelperLost, HelperProcess, idle_helpers
from labbook.run.job import JobOutput, LabEntry
from labbook.scene import attached

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def ended_threads():
    """Threads of earlier tests give no helper back during these."""
    yield
    for thread in threading.enumerate():
        if thread.name == "labbook-closing":
            thread.join(60)
            assert not thread.is_alive()


@pytest.fixture
def idle():
    """The process id of an idle helper, which is taken over next."""
    kept = idle_helpers.take()
    pid = kept.call(os.getpid)
    idle_helpers.put_back(kept)
    return pid


def is_running(pid: int) -> bool:
    """Whether there is a process that has not ended, waited for or not."""
    try:
        with open(f"/proc/{pid}/stat") as stat:
            return stat.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def assert_ends(pid: int) -> None:
    """Wait for the end of a process."""
    until = time.monotonic() + 30
    while is_running(pid):
        assert time.monotonic() < until
        time.sleep(0.01)


def test_later_runs_take_over_the_helpers_of_earlier_ones(tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "slots", lambda *_: 100)
    monkeypatch.setattr(runner.Runner, "_make_finalizers", lambda _: [finalizing.Finalizer(alone=False)] * 2)
    pids, put = [], HelperProcess.put
    monkeypatch.setattr(
        HelperProcess, "put", lambda self, output: pids.append(self.call(os.getpid)) or put(self, output)
    )
    for name in ("first", "second"):
        assert carry_out(study(tmp_path), tmp_path / name, workers=1).complete
        for thread in threading.enumerate():
            if thread.name == "labbook-closing":
                thread.join(60)
    assert len(pids) > 4
    assert len({*pids}) == 1


def test_the_environment_and_places_of_files_are_those_of_the_run(idle, tmp_path, monkeypatch):
    (tmp_path / "grains.csv").write_text("x, y, z\n")
    key = attached.StudyFolder(tmp_path).attach("grains.csv")
    monkeypatch.setenv("LABBOOK_CACHE", "elsewhere")
    monkeypatch.delenv("PATH")
    taken = idle_helpers.take()
    try:
        assert taken.call(os.getpid) == idle
        assert taken.call(os.getenv, "LABBOOK_CACHE") == "elsewhere"
        assert taken.call(os.getenv, "PATH") is None
        assert taken.call(attached.content, key) == b"x, y, z\n"
    finally:
        idle_helpers.put_back(taken)


class Stub(HelperProcess):
    """An idle helper without a process, since starting takes long."""

    is_idle = property(lambda _: True)

    def __init__(self):
        self.origin, self.killed = helper.origin(), False

    def kill(self):
        self.killed = True

    end = kill


def test_it_serves_only_where_a_new_one_would_start_alike(tmp_path, monkeypatch):
    kept, new = Stub(), Stub()
    monkeypatch.setattr(helper, "HelperProcess", lambda: new)
    idle_helpers.put_back(kept)
    monkeypatch.chdir(tmp_path)
    assert idle_helpers.take() is new
    assert kept.killed


def test_start_conditions_include_all_that_a_new_one_inherits(tmp_path, monkeypatch):
    source = tmp_path / "own_measure.py"
    source.write_text("factor = 1")
    monkeypatch.syspath_prepend(tmp_path)
    conditions = [helper.origin()]
    monkeypatch.setattr(plugins, "_loaded", {"own_measure": []})
    import_module("own_measure")
    conditions.append(helper.origin())
    os.utime(source, ns=(0, 0))
    conditions.append(helper.origin())
    monkeypatch.syspath_prepend(tmp_path / "more")
    conditions.append(helper.origin())
    monkeypatch.chdir(tmp_path)
    conditions.append(helper.origin())
    assert helper.origin() == conditions[-1]
    stream = os.dup(2)
    try:
        with (tmp_path / "log").open("wb") as log:
            os.dup2(log.fileno(), 2)
            conditions.append(helper.origin())
    finally:
        os.dup2(stream, 2)
        os.close(stream)
    assert len({*conditions}) == 6
    folder = tmp_path / "gone"
    folder.mkdir()
    monkeypatch.chdir(folder)
    folder.rmdir()
    with pytest.raises(HelperLost, match="working folder"):
        idle_helpers.take()


def test_of_those_that_were_killed_none_is_taken_over(idle, monkeypatch):
    os.kill(idle, signal.SIGKILL)
    new = Stub()
    monkeypatch.setattr(helper, "HelperProcess", lambda: new)
    assert idle_helpers.take() is new


def test_after_an_error_it_is_kept_and_after_an_unread_answer_it_is_not(idle, tmp_path):
    lab = LabFolder(tmp_path / "lab")
    taken = idle_helpers.take()
    with pytest.raises(DiskFull):
        taken.put(Unwritten(lab, "key", lab.run("key"), "run", fails=True))
    idle_helpers.put_back(taken)
    assert is_running(idle)
    taken = idle_helpers.take()
    assert taken.call(os.getpid) == idle
    taken.put(Unwritten(lab, "key", lab.run("key"), "run", fails=False))
    idle_helpers.put_back(taken)  # its entry was not read: the next answer would be taken for another
    assert not is_running(idle)


@dataclass(frozen=True)
class Unwritten(JobOutput):
    """An output without files."""

    fails: bool

    def fill_folder(self, folder):
        if self.fails:
            raise DiskFull(folder)

    def entry(self):
        return LabEntry(({}, []))

    reread = entry


def test_there_are_no_more_idle_ones_than_a_run_uses(monkeypatch):
    idle_helpers.end()
    monkeypatch.setattr(helper, "MAX_HELPERS", 2)
    stubs = [Stub() for _ in range(3)]
    for stub in stubs:
        idle_helpers.put_back(stub)
    assert [stub.killed for stub in stubs] == [False, False, True]
    idle_helpers.end()
    assert all(stub.killed for stub in stubs)


def test_a_fork_leaves_them_to_its_parent(idle):
    busy = idle_helpers.take()
    child = os.fork()
    if child == 0:
        try:
            stream = busy._process.stdin
            assert stream is not None
            stream.write(b"nothing that reaches the helper")
            stream.close()
            os._exit(0 if idle_helpers._pop() is None else 1)
        finally:
            os._exit(2)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert busy.call(os.getpid) == idle
    idle_helpers.put_back(busy)
    child = os.fork()
    if child == 0:
        os._exit(0 if idle_helpers._pop() is None else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert is_running(idle)


PARENT = """
import os, time
from labbook.run.helper import idle_helpers
idle, busy = idle_helpers.take(), idle_helpers.take()
print(idle.call(os.getpid), busy.call(os.getpid), flush=True)
idle_helpers.put_back(idle)
child = os.fork()
if child == 0:
    os.close(1)
    time.sleep(60)
    os._exit(0)
print(child, flush=True)
time.sleep(60)
"""
"""A process with an idle helper, one in use, and a child that goes on without it."""


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGINT])
def test_none_outlives_its_parent(end):
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert parent.stdout is not None
    idle, busy, child = map(int, (parent.stdout.readline() + parent.stdout.readline()).split())
    try:
        assert is_running(idle)
        assert is_running(busy)
        if end == signal.SIGINT:
            os.killpg(parent.pid, end)  # as a terminal does
        else:
            parent.kill()
        assert parent.wait(30) == -end
        if end == signal.SIGINT:
            assert not is_running(idle), "the parent has waited for it"
        else:
            assert is_running(child)
        assert_ends(idle)
        assert_ends(busy)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(parent.pid, signal.SIGKILL)
        parent.communicate()


def test_a_helper_that_dies_while_it_loads_is_replaced(monkeypatch, tmp_path):
    closed = study(tmp_path).points[0].scene.close()
    monkeypatch.setattr(finalizing, "load_packages", os.abort)
    finalizer = finalizing.Finalizer(alone=False)
    finalizer.begin()
    packing = finalizer.place(closed, "rain", 1).result(60)
    finalizer.end()
    assert packing.x.tobytes() == place(closed, "rain", 1).x.tobytes()
