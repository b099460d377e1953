"""Progress that runners publish for other processes: what is in it, when it is gone, and that it stops nothing."""

import errno
import json
import os
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import pytest
from labbook_toy import Backend
from toy_lab import carry_out, labbook, start, study, study_file

from labbook.lab import LabFolder
from labbook.run import live
from labbook.run.live import Publisher, Running, running
from labbook.run.progress import remaining
from labbook.run.runner import Runner
from labbook.run.watch import ActiveJob, NullWatcher, View

VIEW = View(
    runs_done=3,
    runs_asked=12,
    fillings_left=1,
    going=(ActiveJob("run of orifice 18 mm, seed 1", "discharging", ("62 % discharged", "0.20 s")),),
    elsewhere=2,
    work_done=2e9,
    work_left=6.4e9,
    rate=1e8,
    open_ended=True,
)


@pytest.fixture
def lab(tmp_path) -> LabFolder:
    (tmp_path / "lab").mkdir()
    return LabFolder(tmp_path / "lab")


class Seen(NullWatcher):
    """What another watcher is told, and what other processes could read at that moment."""

    def __init__(self, lab: LabFolder | None = None):
        self.views, self.lines, self.running, self._lab = [], [], [], lab

    def show(self, view: View) -> None:
        self.views.append(view)
        self.running += running(self._lab) if self._lab else []

    def tell(self, line: str) -> None:
        self.lines.append(line)


def publisher(lab: LabFolder, to: NullWatcher | None = None) -> Publisher:
    return Publisher(lab, "toy-study", "toy", "cpu", to or NullWatcher())


def files(lab: LabFolder) -> list[str]:
    return sorted(os.listdir(lab.live)) if lab.live.exists() else []


def until(holds: Callable[[], object], seconds: float = 60.0) -> None:
    """Waits until something holds."""
    deadline = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < deadline, "it never came to that"
        time.sleep(0.01)


# one process


def test_what_is_published_is_read_again_and_is_gone_at_the_end(lab):
    with publisher(lab) as published:
        assert running(lab) == []
        published.show(VIEW)
        (one,) = running(lab)
        assert {name: getattr(one, name) for name in vars(VIEW)} == vars(VIEW)
        assert (one.study, one.backend, one.device, one.pid, one.jobs) == ("toy-study", "toy", "cpu", os.getpid(), 1)
        assert one.seconds_left == 64.0
        assert remaining(one) == remaining(VIEW) == "at least 64 s left"
        for moment in (one.started, one.updated):
            offset = datetime.fromisoformat(moment).utcoffset()
            assert offset is not None
            assert not offset, "UTC"
        assert json.loads((lab.live / f"{one.id}.json").read_bytes())["seconds_left"] == 64.0
    assert running(lab) == []
    assert files(lab) == []


def test_the_time_left_is_not_told_while_no_rate_is_known(lab):
    with publisher(lab) as published:
        published.show(replace(VIEW, rate=0.0))
        (one,) = running(lab)
        assert one.seconds_left is None
        assert json.loads((lab.live / f"{one.id}.json").read_bytes())["seconds_left"] is None


def test_it_is_published_once_a_second_and_passed_on_always(lab, monkeypatch):
    now, seen = 100.0, Seen()
    monkeypatch.setattr(live.time, "monotonic", lambda: now)
    told = []
    with publisher(lab, seen) as published:
        for step in range(23):
            now = 100 + step / 10
            published.show(replace(VIEW, runs_done=step))
            told.append(running(lab)[0].runs_done)
        published.tell("a line")
    assert told == [0] * 10 + [10] * 10 + [20] * 3
    assert [view.runs_done for view in seen.views] == list(range(23))
    assert seen.lines == ["a line"]


def test_of_thousands_of_jobs_some_are_published(lab):
    with publisher(lab) as published:
        published.show(replace(VIEW, going=VIEW.going * 3000))
        (one,) = running(lab)
        assert (len(one.going), one.jobs) == (live.MAX_JOBS, 3000)


def test_two_in_one_process_are_told_apart(lab):
    with publisher(lab) as one, publisher(lab) as other:
        one.show(VIEW)
        other.show(replace(VIEW, runs_done=4))
        assert sorted(found.runs_done for found in running(lab)) == [3, 4]
    assert files(lab) == []


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS, errno.EACCES])
def test_what_cannot_be_written_stops_nothing(lab, monkeypatch, number):
    def fail(*_, **__):
        raise OSError(number, os.strerror(number))

    seen = Seen()
    with publisher(lab, seen) as published, monkeypatch.context() as patched:
        patched.setattr(live, "write_bytes", fail)
        published.show(VIEW)
        assert running(lab) == []
        published._next_time = float("-inf")
        patched.undo()
        published.show(VIEW)
        assert len(running(lab)) == 1, "it is tried again"
    assert len(seen.views) == 2
    assert files(lab) == []


def test_a_file_in_place_of_the_folder_stops_no_run(tmp_path):
    lab = LabFolder(tmp_path / "lab")
    lab.folder.mkdir()
    lab.live.write_text("no folder")
    assert carry_out(study(tmp_path, orifices="[24]", replicates=1), lab.folder, backend=Backend(delay=0.002)).complete
    assert running(lab) == []
    assert lab.live.read_text() == "no folder"


def test_an_error_ends_publishing_as_well(lab):
    def interrupted() -> None:
        with publisher(lab) as published:
            published.show(VIEW)
            (lab.live / f"{running(lab)[0].id}.json.part").write_text("cut short")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert files(lab) == []


def harmed(lab: LabFolder, harm: Callable[[Path], object]) -> list[Running]:
    """Who is running once the file of one of two has been harmed, whose lock is held as before."""
    with publisher(lab) as one, publisher(lab) as other:
        one.show(VIEW)
        victim = lab.live / f"{running(lab)[0].id}.json"
        other.show(replace(VIEW, runs_done=4))
        harm(victim)
        return running(lab)


def says(**changes: object) -> Callable[[Path], object]:
    """The file with other values."""
    return lambda path: path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def replaced(make: Callable[[Path], object]) -> Callable[[Path], object]:
    def harm(path: Path) -> None:
        path.unlink()
        make(path)

    return harm


@pytest.mark.parametrize("harm", [
    lambda path: path.unlink(),
    lambda path: path.write_bytes(b""),
    lambda path: path.write_bytes(path.read_bytes()[:-20]),
    lambda path: path.write_bytes(b"\xff\xfe"),
    lambda path: path.write_bytes(b"[" * 100_000),
    lambda path: path.write_bytes(path.read_bytes() + b" " * 1_000_000),
    lambda path: path.write_bytes(path.read_bytes().replace(b"100000000.0", b"NaN")),
    says(format=2),
    says(runs_done="3"),
    says(pid=None),
    says(id="of-another"),
    says(going=[{"label": "a"}]),
    says(going=[{"label": "a", "phase": "resting", "says": []}]),
    replaced(os.mkfifo),
    replaced(os.mkdir),
    replaced(lambda path: path.symlink_to(path)),
])  # fmt: skip
def test_an_odd_file_is_left_out(lab, harm):
    assert [one.runs_done for one in harmed(lab, harm)] == [4]


def test_keys_that_a_later_version_adds_are_passed_over(lab):
    assert len(harmed(lab, says(colour="red"))) == 2


def test_what_else_lies_there_is_passed_over_and_looking_changes_nothing(lab):
    assert running(lab) == []
    assert not lab.live.exists(), "looking makes nothing"
    lab.live.mkdir()
    (lab.live / "notes.txt").write_text("mine")
    (lab.live / "a.json").write_text("{}")
    os.mkfifo(lab.live / "b.lock")
    (lab.live / "c.lock").mkdir()
    (lab.live / "d.lock").symlink_to("nowhere")
    before = files(lab)
    assert running(lab) == []
    with publisher(lab):
        assert files(lab) == before, "nor does sweeping what killed processes left"
    (lab.live / "toy-study-vm-1-0a1b.lock").touch()
    (lab.live / "toy-study-vm-1-0a1b.json.part").touch()
    with publisher(lab):
        assert files(lab) == before, "which goes"


def test_a_run_publishes_for_whoever_watches_and_keeps_nothing(tmp_path):
    lab = LabFolder(tmp_path / "lab")
    seen = Seen(lab)
    backend = Backend(delay=0.01)
    assert Runner(study(tmp_path, orifices="[24]", replicates=1), lab, backend, watcher=seen, workers=1).run().complete
    assert {one.study for one in seen.running} == {"toy-study"}
    assert {going.phase for one in seen.running for going in one.going} <= {"preparing", "settling", "discharging"}
    assert files(lab) == []


def test_nothing_is_published_where_nothing_is_to_be_done(tmp_path):
    asked, lab = study(tmp_path, orifices="[24]", replicates=1), LabFolder(tmp_path / "lab")
    carry_out(asked, lab.folder)
    if lab.live.exists():
        lab.live.rmdir()
    assert carry_out(asked, lab.folder).work_done == 0
    assert not lab.live.exists()


def test_status_tells_of_those_who_run(lab):
    carry_out(study(lab.folder.parent, orifices="[24]", replicates=1), lab.folder)
    assert json.loads(labbook("status", "--lab", lab.folder, "--json").stdout)["running"] == []
    with publisher(lab) as published:
        published.show(VIEW)
        (one,) = json.loads(labbook("status", "--lab", lab.folder, "--json").stdout)["running"]
        assert (one["study"], one["runs_done"], one["runs_asked"], one["seconds_left"]) == ("toy-study", 3, 12, 64.0)
        shown = labbook("status", "--lab", lab.folder).output
    assert "  toy-study: 3/12 runs, 1 packing first; at least 64 s left; toy on cpu, process " in shown
    assert "toy-study" not in labbook("status", "--lab", lab.folder).output


# several processes


@pytest.mark.slow
def test_another_process_sees_runs_done_grow_until_it_ends(tmp_path):
    path, lab = study_file(tmp_path, replicates=2), LabFolder(tmp_path / "lab")
    process = start("run", path, "--lab", lab.folder, "--backend", "toy", delay=0.02)
    until(lambda: running(lab))
    seen: list[Running] = []
    while process.poll() is None:
        seen += running(lab)
        time.sleep(0.02)
    assert process.returncode == 0, process.communicate()
    assert {one.pid for one in seen} == {process.pid}
    done = [one.runs_done for one in seen]
    assert done == sorted(done)
    assert len(set(done)) > 1, "it grew"
    assert {one.runs_asked for one in seen} == {4}
    assert max(one.updated for one in seen) > min(one.updated for one in seen)
    assert running(lab) == []
    assert files(lab) == []


@pytest.mark.slow
def test_a_killed_process_is_gone_at_once_and_the_next_run_sweeps_its_files(tmp_path):
    path, lab = study_file(tmp_path, replicates=1), LabFolder(tmp_path / "lab")
    process = start("run", path, "--lab", lab.folder, "--backend", "toy", delay=0.1)
    until(lambda: running(lab))
    with publisher(lab) as other:
        other.show(replace(VIEW, runs_done=7))
        process.send_signal(signal.SIGKILL)
        process.wait()
        assert [one.pid for one in running(lab)] == [os.getpid()], "the killed one is not among them"
        left = [name for name in files(lab) if f"-{process.pid}-" in name]
        assert {Path(name).suffix for name in left} == {".json", ".lock"}
        labbook("run", path, "--lab", lab.folder, "--backend", "toy")
        assert [one.runs_done for one in running(lab)] == [7], "what is alive is not swept"
        assert not set(left) & set(files(lab))
    assert files(lab) == []


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_process_that_is_asked_to_stop_leaves_no_file(tmp_path, number):
    path, lab = study_file(tmp_path, replicates=1), LabFolder(tmp_path / "lab")
    process = start("run", path, "--lab", lab.folder, "--backend", "toy", delay=0.02)
    until(lambda: running(lab))
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, out + err
    assert files(lab) == []


@pytest.mark.slow
def test_a_process_that_compiles_is_seen(tmp_path):
    path, lab = study_file(tmp_path, replicates=1), LabFolder(tmp_path / "lab")
    process = start("run", path, "--lab", lab.folder, "--backend", "toy", LABBOOK_TOY_COMPILES="3")
    until(lambda: any(going.phase == "compiling" for one in running(lab) for going in one.going))
    (one,) = running(lab)
    assert one.seconds_left is None
    process.kill()
    process.wait()
